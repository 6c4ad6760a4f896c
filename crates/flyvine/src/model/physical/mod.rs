//! The physical family: a reduced-order model of quadrotor, autopilot and arm, fitted by simulation error.
//!
//! # The model
//!
//! Masses are counted in quadrotor masses, since poses tell only their ratios. With the commanded position u
//! arriving after a delay, position p, velocity v, up-axis b and collective thrust T per total mass:
//!
//! - **autopilot** (`autopilot.rs`): `v_sp = K_p (u − p)`, `a = P (v_sp − v) + I − D v̇`, each with a feed-forward of the
//!   command's own rates where the vehicle is sent those, thrust along
//!   `(a_x, a_y, g)` with limited tilt and the excess fed back to the integrator I; quaternion attitude loop
//!   `ω_sp = 2 K vec(q* ⊗ q_sp)`, rate loop and motors as lags; the structure of PX4's cascade, whose default
//!   gains are the means of the priors. Limits have rounded corners (`limits.rs`);
//! - **arm** (`arm.rs`, `joints.rs`, `hanging.rs`): [`LINKS`](state::LINKS) rigid links with point masses, hung below the quadrotor, with
//!   elastic damped joints (the first one towards the body's down-axis) and quadratic air drag; constraint
//!   forces act on both bodies. Its length may change;
//! - **what is left over** (`correction.rs`): if it helps, a small linear [`Correction`] of both velocities;
//! - **time** (`step.rs`): semi-implicit Euler steps of 10 ms, the joints' damping implicit.
//!
//! The flat state is the nine outputs `x ∈ R⁹` followed by the hidden rest ([`STATE_LEN`] entries), so costs and
//! constraints on outputs are costs and constraints on its first nine entries.
//!
//! # Use
//!
//! - [`PARAMETERS`] is the table of parameters: names, units, bounds, priors. [`Parameters::mean`] interpolates
//!   between configurations: of beams the compliance, of other positive parameters the logarithm, lengths by the arm's own.
//! - [`fit_physical`]: flights of one configuration → [`PhysicalModel`] (serializable, with its provenance and
//!   the posterior covariance); [`fit_configurations`]: of several configurations of one vehicle.
//!   [`PhysicalModel::estimates`]: every parameter with its standard error, and whether it was determined.
//! - [`PhysicalModel`] is [`crate::trajopt::Dynamics`]; all derivatives are exact, by forward-mode differentiation
//!   of the same code (`scalar.rs`). Along a schedule it is a [`super::ScheduledModel`], which knows the growth.
//! - [`design_flight`]: commands for the next training flight, from which most would be learnt.
//! - [`Surroundings`]: wind and a load at the tip, which an estimator finds in flight.
//! - [`stream_timing`]: are the recordings' clocks right?
//! - [`observe`] estimates the hidden states from a flight's poses by an extended Kalman filter: rollouts
//!   start from its estimates.

mod arm;
mod autopilot;
mod correction;
mod dynamics;
mod error;
mod estimates;
mod excitation;
mod fit;
mod flight_data;
mod hanging;
mod joints;
mod limits;
mod model;
mod observer;
mod parameters;
mod scalar;
mod state;
mod step;
mod surroundings;
#[cfg(test)]
pub(super) mod synthetic;
mod vector;

pub use arm::ArmLength;
pub use correction::Correction;
pub use error::PhysicalError;
pub use estimates::ParameterEstimate;
pub use excitation::{Room, design_flight, information_gain};
pub(super) use fit::CorrectionEquations;
pub use fit::{
    Estimate, FitProgress, FitStage, FlightTiming, PhysicalFitOptions, StreamTiming, fit_configurations,
    fit_physical, stream_timing,
};
pub use flight_data::{FlightData, Observed, arm_lengths};
pub use model::{FitSummary, PhysicalModel};
pub use observer::{Observer, observe};
pub use parameters::{PARAMETER_COUNT, PARAMETERS, ParameterInfo, Parameters, Part, Scale};
pub(crate) use state::offset;
pub use state::{OUTPUT_LEN, STATE_LEN};
pub use surroundings::{SURROUNDINGS_LEN, Surroundings};
