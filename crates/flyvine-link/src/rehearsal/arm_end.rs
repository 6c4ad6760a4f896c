//! The arm at the vehicle's end of its line: the firmware's own device on a simulated spool and tube, or a board with that
//! firmware, which is listened to.

use flyvine::flight::Configuration;
use vine_arm::plant::{Plant, PlantParameters};
use vine_arm::{Decoder, Device, Limits, Message, Sensors};

/// Where the arm is.
pub(super) enum ArmEnd {
    /// Here.
    Software {
        /// Controller and protocol.
        device: Box<Device>,
        /// Spool and tube.
        plant: Plant,
    },
    /// On a line of its own, behind this one.
    Board {
        /// Listens to what it says.
        decoder: Decoder,
        /// Bytes for it.
        to_board: Vec<u8>,
    },
}

impl ArmEnd {
    /// The software arm at rest in `configuration`, with the prototype's limits.
    pub fn software(configuration: Configuration) -> Self {
        let device = Device::new(Limits::default()).expect("the prototype's limits are possible");
        let mut plant = Plant::at(PlantParameters::default(), configuration.length_m as f32);
        plant.pressure_kpa = configuration.pressure_kpa as f32;
        Self::Software {
            device: Box::new(device),
            plant,
        }
    }

    /// A board that is to be carried to and fro.
    pub fn board() -> Self {
        Self::Board {
            decoder: Decoder::new(),
            to_board: Vec::new(),
        }
    }

    /// Takes bytes from the base station, and appends what is answered at once.
    pub fn receive(&mut self, bytes: &[u8], answers: &mut Vec<u8>) {
        match self {
            Self::Software { device, .. } => device.receive(bytes, |frame| answers.extend_from_slice(frame)),
            Self::Board { to_board, .. } => to_board.extend_from_slice(bytes),
        }
    }

    /// Lets `step_s` go by, appends what is said, and gives length and pressure then; `None` of a board. A broken pressure
    /// sensor reads NaN.
    pub fn step(&mut self, step_s: f64, is_broken: bool, said: &mut Vec<u8>) -> Option<Configuration> {
        let Self::Software { device, plant } = self else {
            return None;
        };
        let sensors = match is_broken {
            true => Sensors {
                pressure_kpa: Some(f32::NAN),
                ..plant.sensors()
            },
            false => plant.sensors(),
        };
        let step_us = (1e6 * step_s).round() as u32;
        let actuators = device.step(step_us, sensors, |frame| said.extend_from_slice(frame));
        plant.step(step_s as f32, actuators);
        Some(Configuration {
            length_m: f64::from(plant.length_m),
            pressure_kpa: f64::from(plant.pressure_kpa),
        })
    }

    /// Bytes for the board, since the last call; none of the software arm.
    pub fn take_for_board(&mut self) -> Vec<u8> {
        match self {
            Self::Software { .. } => Vec::new(),
            Self::Board { to_board, .. } => std::mem::take(to_board),
        }
    }

    /// Listens to what a board says, and gives the newest length and pressure in it.
    pub fn hear_board(&mut self, bytes: &[u8]) -> Option<Configuration> {
        let Self::Board { decoder, .. } = self else {
            return None;
        };
        let mut newest = None;
        decoder.extend(bytes, |frame| {
            if let Ok(frame) = frame
                && let Message::Telemetry(telemetry) = frame.message
                && let (Some(length_m), Some(pressure_kpa)) = (telemetry.length_m, telemetry.pressure_kpa)
            {
                newest = Some(Configuration {
                    length_m: f64::from(length_m),
                    pressure_kpa: f64::from(pressure_kpa),
                });
            }
        });
        newest
    }
}
