//! What must hold for every sequence of requests, readings and bytes.

use proptest::prelude::*;
use vine_arm::plant::{Plant, PlantParameters};
use vine_arm::{Air, Controller, Decoder, Device, Frame, Limits, Message, Request, Sensors, Setpoint, State};

const DT: f32 = 0.005;

fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -0.05f32..0.05,
        4 => -1.0f32..3.0,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => any::<f32>(),
    ]
}

fn any_request() -> impl Strategy<Value = Request> {
    prop_oneof![
        8 => (any_number(), any_number())
            .prop_map(|(growth_rate_m_s, pressure_kpa)| Request::Setpoint(Setpoint { growth_rate_m_s, pressure_kpa })),
        8 => (-0.02f32..0.02, 0.0f32..2.0)
            .prop_map(|(growth_rate_m_s, pressure_kpa)| Request::Setpoint(Setpoint { growth_rate_m_s, pressure_kpa })),
        1 => Just(Request::Stop),
        2 => Just(Request::Resume),
        1 => any_number().prop_map(Request::SetLength),
    ]
}

fn any_sensors() -> impl Strategy<Value = Sensors> {
    let length = prop_oneof![6 => 0.5f32..1.3, 1 => any_number()];
    let pressure = prop_oneof![6 => 0.0f32..2.7, 1 => any_number()];
    (
        proptest::option::weighted(0.9, length),
        proptest::option::weighted(0.9, pressure),
    )
        .prop_map(|(length_m, pressure_kpa)| Sensors {
            length_m,
            pressure_kpa,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Whatever is asked and read: finite duties within one, nothing runs unless active, motor and pumps rest after the
    /// watchdog's time, growth never goes on past an end stop, pumps and vent never follow each other at once.
    #[test]
    fn nothing_unsafe_leaves_the_controller(
        script in prop::collection::vec(
            (proptest::option::of((any::<u16>(), any_request())), any_sensors(), 1u32..30), 1..60),
        has_vent in any::<bool>(),
    ) {
        let limits = Limits { has_vent, ..Limits::default() };
        let mut controller = Controller::new(limits).unwrap();
        let (mut air, mut last, mut since_air) = (Air::Off, Air::Off, f32::MAX);
        for (request, sensors, steps) in script {
            if let Some((sequence, request)) = request {
                let _ = controller.request(sequence, &request);
            }
            for _ in 0..steps {
                let actuators = controller.step(DT, sensors);
                since_air += DT;

                prop_assert!(actuators.growth_duty.abs() <= 1.0);
                if controller.state() != State::Active {
                    prop_assert_eq!(actuators.growth_duty, 0.0);
                    prop_assert_ne!(actuators.air, Air::Inflate);
                }
                if actuators.growth_duty != 0.0 || actuators.air == Air::Inflate {
                    prop_assert!(controller.setpoint_age_s().unwrap() + DT < 0.3);
                    prop_assert!(sensors.pressure_kpa.is_none_or(|p| p <= limits.over_pressure_kpa));
                }
                if let Some(length) = sensors.length_m {
                    prop_assert!(!(length >= limits.max_length_m && actuators.growth_duty > 0.0));
                    prop_assert!(!(length <= limits.min_length_m && actuators.growth_duty < 0.0));
                }
                if actuators.air != air {
                    if air == Air::Off {
                        let rest_s = if actuators.air == last { limits.min_off_s } else { limits.changeover_s };
                        prop_assert!(since_air >= rest_s - DT);
                        last = actuators.air;
                    } else {
                        prop_assert_eq!(actuators.air, Air::Off);
                    }
                    (air, since_air) = (actuators.air, 0.0);
                }
            }
        }
    }

    /// On the simulated spool and tube, whatever valid set-points come: the length stays between the end stops, the
    /// pressure below over-pressure, and no fault is raised.
    #[test]
    fn valid_set_points_keep_the_plant_within_its_limits(
        length_m in 0.6f32..1.1,
        script in prop::collection::vec((-0.02f32..0.02, 0.0f32..2.0, 1u32..200), 1..20),
    ) {
        let limits = Limits::default();
        let mut controller = Controller::new(limits).unwrap();
        let mut plant = Plant::at(PlantParameters::default(), length_m);
        controller.step(DT, plant.sensors());
        let mut sequence = 0;
        for (growth_rate_m_s, pressure_kpa, ticks) in script {
            for _ in 0..ticks {
                sequence += 1;
                let setpoint = Setpoint { growth_rate_m_s, pressure_kpa };
                prop_assert_eq!(controller.request(sequence, &Request::Setpoint(setpoint)), Ok(()));
                for _ in 0..10 {
                    let actuators = controller.step(DT, plant.sensors());
                    plant.step(DT, actuators);
                    prop_assert_eq!(controller.state(), State::Active);
                }
                prop_assert!(plant.length_m >= limits.min_length_m - 1e-3);
                prop_assert!(plant.length_m <= limits.max_length_m + 1e-3);
                prop_assert!(plant.pressure_kpa < limits.over_pressure_kpa);
            }
        }
    }

    /// Any bytes at all: no panic, and afterwards a good frame is read.
    #[test]
    fn the_decoder_resynchronises_after_anything(noise in prop::collection::vec(any::<u8>(), 0..300), sequence: u16) {
        let frame = Frame { sequence, message: Message::Request(Request::Resume) };
        let mut decoder = Decoder::new();
        decoder.extend(&noise, |_| {});
        let mut found = Vec::new();
        decoder.extend(&frame.encode(), |frame| found.extend(frame.ok()));
        prop_assert_eq!(found, vec![frame]);
    }

    /// Every request comes back as it was sent, however the bytes are cut up.
    #[test]
    fn requests_come_back(sequence: u16, request in any_request(), cut in 0usize..16) {
        let frame = Frame { sequence, message: Message::Request(request) };
        let bytes = frame.encode();
        let (head, tail) = bytes.split_at(cut.min(bytes.len()));
        let (mut decoder, mut found) = (Decoder::new(), Vec::new());
        decoder.extend(head, |frame| found.push(frame));
        decoder.extend(tail, |frame| found.push(frame));
        prop_assert_eq!(found.len(), 1);
        // NaN is not equal to itself; its bytes are.
        prop_assert_eq!(&found[0].unwrap().encode()[..], &bytes[..]);
    }

    /// Good frames between damaged ones are all answered, and a damaged one never is.
    #[test]
    fn a_device_answers_exactly_the_good_frames(
        script in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>(), 1u8..=255), 1..60),
    ) {
        let mut device = Device::new(Limits::default()).unwrap();
        let (mut good, mut answered) = (Vec::new(), Vec::new());
        for (sequence, (spoil, index, mask)) in (0u16..).zip(script) {
            let request = Request::Setpoint(Setpoint { growth_rate_m_s: 0.0, pressure_kpa: 0.1 });
            let mut bytes = Frame { sequence, message: Message::Request(request) }.encode().to_vec();
            if spoil {
                let inside = 1 + index.index(bytes.len() - 2);
                bytes[inside] ^= mask;
            } else {
                good.push(sequence);
            }
            let mut decoder = Decoder::new();
            device.receive(&bytes, |answer| decoder.extend(answer, |frame| answered.push(frame.unwrap().sequence)));
        }
        prop_assert_eq!(good, answered);
    }
}
