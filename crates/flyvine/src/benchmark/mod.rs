//! The neutral problem format that solvers are compared on (`bench/FORMAT.md`): JSON in, JSON out.

mod json;
mod problem_file;
mod report;

pub use json::BenchmarkError;
pub use problem_file::{BenchmarkProblem, parse_problem, read_problem};
pub use report::{SolveReport, solve_report};

#[cfg(test)]
mod perturbed_tests;
#[cfg(test)]
mod tests;
