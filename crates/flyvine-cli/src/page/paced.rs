//! A vehicle that knows no clock, at the pace of one.

use std::time::{Duration, Instant};

use flyvine::DT;
use flyvine::flight::Configuration;
use flyvine::link::{Observation, Setpoint, Vehicle, VehicleError};

/// A vehicle whose step k is not answered before k [`DT`] have passed since the reset: what flies faster than real time
/// flies in real time, what is slower stays slower.
pub struct PacedVehicle {
    vehicle: Box<dyn Vehicle>,
    started: Instant,
    steps: u32,
}

impl PacedVehicle {
    /// Paces `vehicle`.
    pub fn new(vehicle: Box<dyn Vehicle>) -> Self {
        Self {
            vehicle,
            started: Instant::now(),
            steps: 0,
        }
    }
}

impl Vehicle for PacedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.reset(configuration, seed)?;
        self.started = Instant::now();
        self.steps = 0;
        Ok(observation)
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.step(setpoint, configuration);
        self.steps += 1;
        let due = self.started + self.steps * Duration::from_secs_f64(DT);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        observation
    }

    fn close(&mut self) -> Result<(), VehicleError> {
        self.vehicle.close()
    }
}
