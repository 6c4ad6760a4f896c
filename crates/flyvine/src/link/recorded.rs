//! A recorded flight as a vehicle: the same poses again, whatever is commanded.

use super::{Observation, Setpoint, Vehicle, VehicleError};
use crate::flight::{Configuration, Flight};

/// Plays a recording back. A controller that is deterministic repeats its commands on it to the last bit.
#[derive(Debug, Clone)]
pub struct RecordedVehicle {
    flight: Flight,
    row: usize,
}

impl RecordedVehicle {
    /// Plays `flight` from its first row on.
    pub fn new(flight: Flight) -> Self {
        Self { flight, row: 0 }
    }

    fn observe(&self) -> Result<Observation, VehicleError> {
        let rows = self.flight.samples.len();
        let sample = self
            .flight
            .samples
            .get(self.row)
            .ok_or(VehicleError::RecordingEnded { rows })?;
        Ok(Observation {
            t_s: sample.t_s,
            quadrotor: sample.quadrotor,
            end_effector: sample.end_effector,
        })
    }
}

impl Vehicle for RecordedVehicle {
    fn reset(&mut self, _configuration: Configuration, _seed: u64) -> Result<Observation, VehicleError> {
        self.row = 0;
        self.observe()
    }

    fn step(
        &mut self,
        _setpoint: Setpoint,
        _configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        self.row += 1;
        self.observe()
    }
}
