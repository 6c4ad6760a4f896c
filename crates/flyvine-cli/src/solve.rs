//! `flyvine solve`: one optimal-control problem in the neutral benchmark format.

use std::path::PathBuf;

use clap::Args;
use flyvine::benchmark::{read_problem, solve_report};
use flyvine::trajopt::Options;

use crate::console::{print, print_json, process_cpu_ms};
use crate::outcome::{Blame, CommandResult, Outcome};

/// Solve one optimal-control problem in the neutral benchmark format (bench/FORMAT.md).
///
/// Exit code 3 if the solver did not converge; the best answer is printed all the same.
#[derive(Args)]
pub struct SolveArguments {
    /// The problem.
    #[arg(value_name = "PROBLEM.json")]
    problem: PathBuf,
    /// Solve this often from the same start, for timing.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine solve`.
pub fn run(arguments: &SolveArguments) -> CommandResult {
    let problem = read_problem(&arguments.problem).or_input()?;
    let mut report = solve_report(
        &problem,
        Options::default(),
        arguments.repeat as usize,
        &process_cpu_ms,
    )
    .or_input()?;
    report.peak_memory_mb = peak_memory_mb();
    if arguments.json {
        print_json(&report)?;
    } else {
        print(&format!(
            "{}: {} after {} iterations, cost {:.6}, violation {:.1e}, {:.2} ms",
            problem.name,
            report.status,
            report.iterations,
            report.cost,
            report.max_violation,
            report.solve_ms
        ))?;
    }
    Ok(if report.converged {
        Outcome::Done
    } else {
        Outcome::Untrusted
    })
}

/// Peak resident memory of this process, MB, where the system tells it (`VmHWM` on Linux).
fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = peak.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes / 1024.0)
}
