//! Solves problem files of the neutral benchmark format and prints a line each:
//! `cargo run --release -p flyvine --example solve_problem -- bench/problems/lem5_ES.json`
#![allow(clippy::print_stdout)] // an example is a program

use flyvine::benchmark::{BenchmarkError, read_problem, solve_report};
use flyvine::trajopt::Options;
use rustix::time::{ClockId, clock_gettime};

fn cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}

fn main() -> Result<(), BenchmarkError> {
    println!("problem          J              violation  steps  factorizations  CPU ms  status");
    for path in std::env::args().skip(1) {
        let benchmark = read_problem(path.as_ref())?;
        let report = solve_report(&benchmark, Options::default(), 100, &cpu_ms)?;
        println!(
            "{:14} {:14.7}  {:9.1e}  {:5}  {:14}  {:6.3}  {}",
            report.problem,
            report.cost,
            report.max_violation,
            report.iterations,
            report.factorizations,
            report.solve_ms,
            report.status
        );
    }
    Ok(())
}
