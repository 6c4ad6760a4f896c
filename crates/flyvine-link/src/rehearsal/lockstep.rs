//! A simulated vehicle in lockstep with the phase of one in real time.

use flyvine::flight::Configuration;
use flyvine::link::{Observation, Setpoint, Vehicle, VehicleError};
use flyvine::sim::SimulatedVehicle;

/// A vehicle in lockstep whose position loop runs as long before the set-points as it did in a flight in real time.
///
/// In lockstep the first set-point comes as the loop runs, and so do all, as their period is a multiple of the loop's. In real
/// time they wait for it, by up to its period of 10 ms, and the end effector moves by a centimetre in that time: two flights can
/// be compared only if they wait alike.
pub struct PhasedVehicle {
    vehicle: SimulatedVehicle,
    loop_phase_s: f64,
}

impl PhasedVehicle {
    /// `vehicle`, with set-points that come `loop_phase_s` after a run of its position loop ([`super::Rig::loop_phase_s`]).
    pub fn new(vehicle: SimulatedVehicle, loop_phase_s: f64) -> Self {
        Self {
            vehicle,
            loop_phase_s,
        }
    }
}

impl Vehicle for PhasedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        self.vehicle.reset(configuration, seed)?;
        let start = self.vehicle.truth().quadrotor.position;
        let hovering = self.vehicle.advance(start, configuration, self.loop_phase_s)?;
        Ok(Observation { t_s: 0.0, ..hovering })
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let seen = self.vehicle.step(setpoint, configuration)?;
        Ok(Observation {
            t_s: seen.t_s - self.loop_phase_s,
            ..seen
        })
    }
}
