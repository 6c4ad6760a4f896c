//! Settings of the solver.

use std::time::Duration;

/// Settings of [`super::Solver`]. The defaults solve every problem shipped with the project.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Stationarity to reach: largest `|∂L/∂u|` over the knots, projected on the active command bounds, divided
    /// by `1 + |J|`. Default 1e-6.
    pub stationarity_tolerance: f64,
    /// Constraint violation to reach, in the constraint's own unit. Default 1e-8.
    pub violation_tolerance: f64,
    /// Steps (of any kind) at most. Default 1000.
    pub max_iterations: usize,
    /// Wall-clock budget of one solve; the best answer so far is returned when it runs out. Default none.
    pub time_limit: Option<Duration>,
    /// Penalty ρ that constraints start with. Default 100.
    pub penalty_initial: f64,
    /// Factor by which ρ grows when a multiplier update did not help enough. Default 10.
    pub penalty_growth: f64,
    /// Largest ρ. Default 1e8.
    pub penalty_max: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            stationarity_tolerance: 1e-6,
            violation_tolerance: 1e-8,
            max_iterations: 1000,
            time_limit: None,
            penalty_initial: 100.0,
            penalty_growth: 10.0,
            penalty_max: 1e8,
        }
    }
}
