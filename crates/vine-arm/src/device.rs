//! Controller and protocol together: the whole firmware but its drivers, and the software arm.

use crate::controller::{Actuators, Controller, Sensors};
use crate::frame::Decoder;
use crate::limits::{Limits, LimitsError};
use crate::message::{Frame, Message, Telemetry};
use crate::state::State;

/// Telemetry period, µs.
const TELEMETRY_PERIOD_US: u32 = 50_000;

/// One arm as its line sees it: bytes in, bytes out.
///
/// A board calls [`receive`](Device::receive) with the bytes that came, [`step`](Device::step) at a steady rate, and sends
/// what both hand to `send`, one whole frame at a time.
#[derive(Debug, Clone)]
pub struct Device {
    controller: Controller,
    decoder: Decoder,
    time_us: u64,
    since_telemetry_us: u32,
    reported: State,
    sequence: u16,
    frames_received: u32,
    frames_rejected: u32,
}

impl Device {
    /// A device at power-up.
    pub fn new(limits: Limits) -> Result<Device, LimitsError> {
        let controller = Controller::new(limits)?;
        Ok(Device {
            reported: controller.state(),
            controller,
            decoder: Decoder::new(),
            time_us: 0,
            since_telemetry_us: 0,
            sequence: 0,
            frames_received: 0,
            frames_rejected: 0,
        })
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Takes bytes from the line and answers every request that they complete.
    pub fn receive(&mut self, bytes: &[u8], mut send: impl FnMut(&[u8])) {
        for &byte in bytes {
            match self.decoder.push(byte) {
                None => {}
                Some(Ok(Frame {
                    sequence,
                    message: Message::Request(request),
                })) => {
                    self.frames_received = self.frames_received.wrapping_add(1);
                    let answer = self.controller.request(sequence, &request);
                    send(
                        &Frame {
                            sequence,
                            message: Message::Acknowledgement(answer),
                        }
                        .encode(),
                    );
                }
                // An arm's own kinds are not for an arm: an echo, or a wrong wire.
                Some(Ok(_) | Err(_)) => self.frames_rejected = self.frames_rejected.wrapping_add(1),
            }
        }
    }

    /// Advances by `dt_us` with the newest readings; sends telemetry when it is due or the state has changed.
    pub fn step(&mut self, dt_us: u32, sensors: Sensors, mut send: impl FnMut(&[u8])) -> Actuators {
        self.time_us += u64::from(dt_us);
        let actuators = self.controller.step(dt_us as f32 * 1e-6, sensors);
        self.since_telemetry_us = self.since_telemetry_us.saturating_add(dt_us);
        if self.since_telemetry_us >= TELEMETRY_PERIOD_US || self.controller.state() != self.reported {
            self.since_telemetry_us %= TELEMETRY_PERIOD_US;
            self.reported = self.controller.state();
            let message = Message::Telemetry(self.telemetry(sensors, actuators));
            send(
                &Frame {
                    sequence: self.sequence,
                    message,
                }
                .encode(),
            );
            self.sequence = self.sequence.wrapping_add(1);
        }
        actuators
    }

    fn telemetry(&self, sensors: Sensors, actuators: Actuators) -> Telemetry {
        Telemetry {
            time_ms: (self.time_us / 1000) as u32,
            setpoint_age_ms: self.controller.setpoint_age_s().map(|age_s| (age_s * 1e3) as u32),
            length_m: self.controller.length_m(),
            // A reading that is no number is a fault, told as such.
            pressure_kpa: sensors.pressure_kpa.filter(|pressure| pressure.is_finite()),
            growth_rate_m_s: self.controller.growth_rate_m_s(),
            growth_duty: actuators.growth_duty,
            air: actuators.air,
            state: self.controller.state(),
            frames_received: self.frames_received,
            frames_rejected: self.frames_rejected,
        }
    }
}
