//! `flyvine bench`: how fast and how exactly problems of the benchmark set are solved.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use flyvine::benchmark::{mpc_report, read_mpc_sequence};

use crate::console::{print, print_json, process_cpu_ms};
use crate::outcome::{Blame, CommandResult, Outcome};

/// Optimality residual above which an answer is not exact.
const EXACT: f64 = 1e-9;

/// Measure a solver on recorded problems (bench/README.md).
///
///   flyvine bench mpc bench/problems/mpc_20.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct BenchArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Solve a recorded sequence of MPC problems in order, warm-started: times of whole steps in process-CPU time,
    /// the largest difference from the recorded commands, and the largest optimality residual. Exit code 3 if that
    /// is above 1e-9.
    Mpc {
        /// The sequence.
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Runs `flyvine bench`.
pub fn run(arguments: &BenchArguments) -> CommandResult {
    let What::Mpc { file, json } = &arguments.what;
    let sequence = read_mpc_sequence(file).or_input()?;
    let report = mpc_report(&sequence, &process_cpu_ms).or_input()?;
    if *json {
        print_json(&report)?;
    } else {
        print(&format!(
            "{}: {} steps, median {:.4} ms, p99 {:.4} ms, min {:.4} ms; largest command error {:.1e} m, residual {:.1e}",
            report.problem,
            report.steps,
            report.median_ms,
            report.p99_ms,
            report.min_ms,
            report.max_u_error,
            report.max_residual
        ))?;
    }
    Ok(if report.max_residual <= EXACT {
        Outcome::Done
    } else {
        Outcome::Untrusted
    })
}
