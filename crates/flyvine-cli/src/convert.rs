//! `flyvine convert`: anyone's recording to flyvine's format; a plan to a table of commands.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::flight::{HygieneOptions, Mapping, clean, read_flight, write_flight};
use flyvine::task::{read_plan, write_plan_csv};

use crate::console::say;
use crate::outcome::{Blame, CommandResult, Outcome, bad_input};

/// Convert a recording to flyvine's CSV or MCAP, or a plan to a CSV of its commands.
///
/// A recording in another CSV format needs a mapping (TOML): which columns hold what, in which units, which rows are
/// valid; it is resampled to 20 Hz. See examples/mappings.
///
///   flyvine convert --mapping examples/mappings/crazyflie_slung.toml log201.csv flight.csv
///   flyvine convert plan.json commands.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct ConvertArguments {
    /// What to read: a recording (.csv, .mcap) or a plan (.json).
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// What to write: a recording (.csv, .mcap), or a plan's commands (.csv).
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Column mapping of a recording in another format.
    #[arg(long, value_name = "MAPPING.toml")]
    mapping: Option<PathBuf>,
}

/// Runs `flyvine convert`.
pub fn run(arguments: &ConvertArguments) -> CommandResult {
    let (input, output) = (&arguments.input, &arguments.output);
    match (extension(input), extension(output)) {
        ("json", "csv") => {
            let plan = read_plan(input).or_input()?;
            write_plan_csv(output, &plan).or_internal()?;
        }
        ("csv" | "txt" | "tsv" | "mcap", "csv" | "mcap") => {
            let mut flight = match &arguments.mapping {
                Some(mapping) => Mapping::read(mapping).or_input()?.read_flight(input).or_input()?,
                None => read_flight(input).or_input()?,
            };
            let report = clean(&mut flight, &HygieneOptions::default());
            if !report.findings.is_empty() {
                say(&format!("{}:\n{report}", input.display()));
            }
            write_flight(output, &flight).or_internal()?;
        }
        (from, to) => {
            return bad_input(format!(
                "cannot convert .{from} to .{to}: expected a recording (.csv, .mcap) to .csv or .mcap, or a plan (.json) to .csv"
            ));
        }
    }
    say(&format!("wrote {}", output.display()));
    Ok(Outcome::Done)
}

/// A path's extension, empty where it has none.
pub fn extension(path: &Path) -> &str {
    path.extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or("")
}
