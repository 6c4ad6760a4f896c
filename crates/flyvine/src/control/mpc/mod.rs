//! Model-predictive control: at every knot the commands that are best over a receding horizon, of which the first is
//! flown.
//!
//! From the estimated state z_0 the nonlinear model is rolled out under the last solution, shifted by one knot, and
//! corrected by one quadratic program in the change v of the commands, with the model linearized along the plan:
//!
//! ```text
//! min Σ_{j=1..N} ‖z_j − z̄_j‖²_Q + ‖z_N − z̄_N‖²_P + Σ_{j<N} ‖u_j − ū_j‖²_R + ‖Δ(u_j − ū_j)‖²_S
//! ```
//!
//! subject to bounds on u and on its change, and soft bounds on states. The gradient is that of the rollout (an adjoint
//! sweep); the Hessian, condensed onto the commands, and its inverse are known before take-off ([`Condensed`]).
//! What is left for the tick is a rollout, an adjoint, and the [`ActiveSet`] method.
//!
//! [`ModelPredictive`] puts it behind the estimator, which also says what the world adds to the model at each step and
//! how late commands arrive: the horizon begins where the next command begins to act.

mod active_set;
mod condensed;
mod controller;
mod horizon;
mod options;
mod plan;
mod regulator;

pub use active_set::{ActiveSet, Budget, QpReport, QuadraticProgram, Rows};
pub use condensed::{Condensed, CondensedError, Hessian, Stage, TrackingWeights};
pub use controller::ModelPredictive;
pub use horizon::{Horizon, HorizonLimits, SoftBound, Start, Window};
pub use options::{MpcError, MpcOptions};
pub use plan::{LinearizedPlan, jacobians_along};
pub use regulator::{Regulator, regulate};

#[cfg(test)]
mod tests;
