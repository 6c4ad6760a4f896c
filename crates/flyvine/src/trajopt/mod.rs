//! Optimal control: the [`Problem`] (data only), the [`Dynamics`] it is subject to, and its solvers.
//!
//! ```text
//! min  Σ_{k=0}^{N-1} ‖z_k − z̄_k‖²_Q + Σ_{k=0}^{N-2} ‖u_k − ū_k‖²_R
//! s.t. z_{k+1} = f_k(z_k, u_k),  z_0 given,  u_min ≤ u_k ≤ u_max,
//!      l ≤ z_k[i] ≤ h on chosen knots,  z_k[i] = v on chosen knots
//! ```
//!
//! where a constraint may also be soft: then its violation costs a price. An [`Ensemble`] plans for several models at
//! once; [`WithCommandChange`] makes changes of the command cost or bounds them, [`WithOutputs`] bounds functions of the
//! motion: distances, speeds, [`WithParameters`] chooses parameters of the dynamics, too.
//!
//! Nothing here knows of files, flights, or where a model came from.

mod augmented_lagrangian;
mod batch;
mod command_change;
#[cfg(test)]
pub(crate) mod derivatives;
mod dynamics;
mod ensemble;
mod ilqr;
mod joined;
mod loosening;
mod options;
mod outputs;
mod parameters;
mod problem;
mod report;
mod solution;
mod solver;
mod start;
mod validation;

pub use batch::{BestOfMany, MultiStart, multi_start, solve_batch};
pub use command_change::WithCommandChange;
pub use dynamics::Dynamics;
pub(crate) use dynamics::linearize_and_spread;
pub use ensemble::{Ensemble, EnsembleError};
pub use loosening::{Bounds, Loosening};
pub use options::Options;
pub use outputs::{Output, WithOutputs};
pub use parameters::{Parametric, Steered, WithParameters};
pub use problem::{Equality, Problem, StateBound};
pub use solution::{ConstraintMultiplier, ConstraintSource, Solution, Status, Violation};
pub use solver::Solver;
pub use start::Start;
pub use validation::ProblemError;
