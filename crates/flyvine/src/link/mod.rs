//! What a plan is flown on: the [`Vehicle`] interface, and vehicles outside this process.

pub mod exec;
mod recorded;

pub use recorded::RecordedVehicle;

use crate::flight::{Configuration, Pose};

/// What the vehicle reports after a reset or a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Vehicle time since the reset, s.
    pub t_s: f64,
    /// Quadrotor pose; `None` if motion capture missed it.
    pub quadrotor: Option<Pose>,
    /// End-effector position, m; `None` if motion capture missed it.
    pub end_effector: Option<[f64; 3]>,
}

/// A vehicle that flies in lockstep: one command, then [`crate::DT`] seconds of its own time.
pub trait Vehicle {
    /// Starts over, hovering at (0, 0, 1.5) with the arm at rest.
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError>;

    /// Holds `command` (quadrotor position, m) for [`crate::DT`] seconds while the arm is told to go to
    /// `configuration`, and returns the newest poses.
    fn step(&mut self, command: [f64; 3], configuration: Configuration) -> Result<Observation, VehicleError>;

    /// Ends the session in good order. Vehicles that hold nothing outside this process have nothing to do.
    fn close(&mut self) -> Result<(), VehicleError> {
        Ok(())
    }
}

/// Why a vehicle can no longer be flown.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// A command or configuration that the vehicle cannot take.
    #[error("the vehicle refused {what}")]
    Refused {
        /// What was found, and what was expected.
        what: String,
    },
    /// A recording has no more rows.
    #[error("the recording ends after {rows} rows")]
    RecordingEnded {
        /// Its rows.
        rows: usize,
    },
    /// The simulation left the finite numbers.
    #[error("the simulated vehicle diverged at t = {t_s:.3} s: {what}")]
    Diverged {
        /// Vehicle time, s.
        t_s: f64,
        /// What was found.
        what: String,
    },
    /// A vehicle in a child process failed or broke the protocol.
    #[error(transparent)]
    Exec(#[from] exec::ExecError),
}
