//! Any bytes at any time, any readings: no panic, and motor and pumps run only when they may.

#![no_main]

use libfuzzer_sys::fuzz_target;
use vine_arm::{Air, Device, Frame, Limits, Message, Request, Sensors, Setpoint, State};

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits::default();
    let mut device = Device::new(limits).expect("the prototype's limits are possible");
    for (index, chunk) in bytes.chunks(16).enumerate() {
        // Half of the chunks are raw bytes for the line, half are set-points in a good frame and readings.
        let mut numbers = [0.0; 4];
        for (number, bytes) in numbers.iter_mut().zip(chunk.chunks_exact(4)) {
            *number = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        }
        let [growth_rate_m_s, pressure_kpa, length, pressure] = numbers;
        let setpoint = Setpoint {
            growth_rate_m_s,
            pressure_kpa,
        };
        let message = Message::Request(Request::Setpoint(setpoint));
        if index % 2 == 0 {
            device.receive(chunk, |_| {});
        } else {
            device.receive(
                &Frame {
                    sequence: index as u16,
                    message,
                }
                .encode(),
                |_| {},
            );
        }
        let sensors = Sensors {
            length_m: Some(length),
            pressure_kpa: Some(pressure),
        };
        let actuators = device.step(5_000, sensors, |_| {});
        let runs = actuators.growth_duty != 0.0 || actuators.air == Air::Inflate;
        assert!(actuators.growth_duty.abs() <= 1.0);
        assert!(!runs || device.controller().state() == State::Active);
        assert!(!runs || pressure <= limits.over_pressure_kpa);
        assert!(!(length >= limits.max_length_m && actuators.growth_duty > 0.0));
        assert!(!(length <= limits.min_length_m && actuators.growth_duty < 0.0));
    }
});
