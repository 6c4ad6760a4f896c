//! What a plan is flown on: the [`Vehicle`] interface, and vehicles outside this process.

pub mod exec;
mod health;
mod recorded;
mod setpoint;

pub use health::{Captured, Fault, Health, Mode};
pub use recorded::RecordedVehicle;
pub use setpoint::{Feedforward, Setpoint};

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

/// A vehicle that takes one command every [`crate::DT`] seconds of its own time: in lockstep, or in real time and then
/// with [`Health`].
pub trait Vehicle {
    /// Starts over, with the arm at rest: hovering at (0, 0, 1.5), or standing on the ground if [`Health::standing`].
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError>;

    /// Holds `setpoint` for [`crate::DT`] seconds while the arm is told to go to `configuration`, and returns the newest
    /// poses.
    fn step(&mut self, setpoint: Setpoint, configuration: Configuration)
    -> Result<Observation, VehicleError>;

    /// What the wires say beside the poses, as of the last reset or step. `None` of a vehicle in lockstep: it has neither
    /// a clock nor modes of its own.
    fn health(&self) -> Option<Health> {
        None
    }

    /// The mode that the autopilot shall be in from the next step on; the vehicle asks until it is. Only called where
    /// there is [`Health`].
    fn set_mode(&mut self, _mode: Mode) {}

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
    /// The checks before a flight found something missing; nothing was armed.
    #[error("not ready to fly:\n{what}")]
    NotReady {
        /// One line for each thing that is missing, and why it matters.
        what: String,
    },
    /// The operator stopped it before anything was armed.
    #[error("stopped by the operator before arming")]
    Interrupted,
    /// A vehicle in a child process failed or broke the protocol.
    #[error(transparent)]
    Exec(#[from] exec::ExecError),
}
