//! Solving a benchmark problem and reporting it in the neutral format.

use super::BenchmarkProblem;
use crate::trajopt::{Options, ProblemError, Solver, Status};
use serde::Serialize;

/// Violation and stationarity up to which the format calls a result converged.
const CONVERGED: f64 = 1e-6;

/// What `flyvine solve --json` prints.
#[derive(Debug, Clone, Serialize)]
pub struct SolveReport {
    /// The problem's name.
    pub problem: String,
    /// The solver's status, in words.
    pub status: String,
    /// Violation and stationarity both within 1e-6.
    pub converged: bool,
    /// Cost of rolling `u` through the true dynamics.
    pub cost: f64,
    /// Largest violation of a constraint in that rollout.
    pub max_violation: f64,
    /// Largest projected |∂L/∂u| / (1 + |J|).
    pub stationarity: f64,
    /// Steps.
    pub iterations: usize,
    /// Riccati factorizations among them.
    pub factorizations: usize,
    /// Process-CPU time of the solve, ms: the fastest, if repeated.
    pub solve_ms: f64,
    /// All of them, if repeated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solve_ms_all: Option<Vec<f64>>,
    /// Peak resident memory of the process, MB, where the caller could read it.
    pub peak_memory_mb: Option<f64>,
    /// Commands, (N−1) × m.
    pub u: Vec<Vec<f64>>,
}

/// Solves `repeat` times (at least once) from the same start; `cpu_ms` reads the process's CPU clock.
///
/// # Errors
/// If the problem does not validate.
pub fn solve_report(
    benchmark: &BenchmarkProblem,
    options: Options,
    repeat: usize,
    cpu_ms: &dyn Fn() -> f64,
) -> Result<SolveReport, ProblemError> {
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, options)?;
    let mut times = Vec::with_capacity(repeat.max(1));
    for _ in 0..repeat.max(1) {
        let started = cpu_ms();
        solver.solve();
        times.push(cpu_ms() - started);
    }
    let solution = solver.solution();
    Ok(SolveReport {
        problem: benchmark.name.clone(),
        status: solution.status.name().to_string(),
        converged: solution.max_violation <= CONVERGED
            && solution.stationarity <= CONVERGED
            && !matches!(solution.status, Status::GuessDiverges { .. }),
        cost: solution.cost,
        max_violation: solution.max_violation,
        stationarity: solution.stationarity,
        iterations: solution.iterations,
        factorizations: solution.factorizations,
        solve_ms: times.iter().copied().fold(f64::INFINITY, f64::min),
        solve_ms_all: (repeat > 1).then_some(times),
        peak_memory_mb: None,
        u: solution
            .commands
            .chunks(benchmark.problem.command_len())
            .map(<[f64]>::to_vec)
            .collect(),
    })
}
