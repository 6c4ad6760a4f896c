//! Flying a plan: control laws, the supervisor that owns every command, and the flight loop.
//!
//! ```text
//! vehicle ──observation──▶ supervisor ──credible poses──▶ controller
//!    ▲                         │  ▲                           │
//!    └──────────command────────┘  └─────────proposal──────────┘
//! ```
//!
//! A [`Controller`] only proposes; what reaches the vehicle is what the [`supervisor`] lets through.

pub mod estimator;
mod fly;
mod flying;
mod learning;
pub mod mpc;
mod open_loop;
mod replanning;
pub mod supervisor;
mod tracking;
mod trajectory;

pub use fly::{AbortCause, End, FlightOutcome, FlownRow, fly, fly_watched};
pub use flying::{ControlLaw, Flying, FlyingError, controller, fly_plan, fly_plan_watched};
pub use learning::{Lap, LapLearning};
pub use open_loop::OpenLoop;
pub use replanning::{Replanning, ReplanningError};
pub use tracking::Tracking;
pub use trajectory::{Trajectory, TrajectoryError};

use crate::flight::StepReport;
use crate::link::Observation;

/// What a controller is told before it proposes a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// Knot k of the plan, from 0.
    pub knot: usize,
    /// The poses at t_k; those that the supervisor does not believe are `None`.
    pub observation: Observation,
    /// The command that was held from t_{k−1} to t_k as it left the supervisor, m; at knot 0 the start
    /// position.
    pub held_command: [f64; 3],
}

/// What a controller answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Proposal {
    /// The quadrotor position to command at t_k, m.
    Command([f64; 3]),
    /// No answer within the tick; the last command stays. Twice running is an abort.
    Late,
    /// No answer and no hope of one: an abort.
    Failed,
}

/// A control law on a plan: the slot for your own. [`fly()`] calls it in flight as in simulation, and the supervisor
/// stands between it and the vehicle.
pub trait Controller {
    /// Takes in where the vehicle hovers, once, before the first tick: here a controller may take its time.
    fn prepare(&mut self, hovering: &Observation) {
        let _ = hovering;
    }

    /// Proposes the command u_k; called once for each knot that has one, in order from 0.
    fn propose(&mut self, tick: &Tick) -> Proposal;

    /// What there is to say about the last proposal, for the record.
    fn report(&self) -> Option<StepReport> {
        None
    }
}
