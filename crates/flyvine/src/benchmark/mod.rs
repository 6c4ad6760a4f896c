//! The neutral problem format that solvers are compared on (`bench/FORMAT.md`): JSON in, JSON out.

mod dense;
mod json;
mod mpc;
mod problem_file;
mod report;

pub use dense::Dense;
pub use json::BenchmarkError;
pub use mpc::{MpcReport, MpcSequence, mpc_report, read_mpc_sequence};
pub use problem_file::{BenchmarkProblem, parse_problem, read_problem};
pub use report::{SolveReport, solve_report};

#[cfg(test)]
mod perturbed_tests;
#[cfg(test)]
mod tests;
