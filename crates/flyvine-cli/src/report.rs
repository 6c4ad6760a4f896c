//! `flyvine report`: a run folder's results as one page.

use std::path::PathBuf;

use clap::Args;
use flyvine::run::{read_results, write_report};

use crate::console::{print, say};
use crate::flights::say_findings;
use crate::outcome::{Blame, CommandResult, Outcome};

/// Make report.html (and figures/*.svg) from a run folder.
///
/// The folder holds experiments/NAME/{plan.json,flight.csv} and, where they are there, check.json, bank.json,
/// hygiene.json, training/*.csv and run.json. The page is self-contained: tables, figures and a 3-D replay.
#[derive(Args)]
pub struct ReportArguments {
    /// The run folder.
    #[arg(value_name = "RUN_DIR")]
    folder: PathBuf,
}

/// Runs `flyvine report`.
pub fn run(arguments: &ReportArguments) -> CommandResult {
    say(&format!("reading {} …", arguments.folder.display()));
    let results = read_results(&arguments.folder, &mut say_findings).or_input()?;
    let page = write_report(&arguments.folder, &results).or_internal()?;
    print(&page.display().to_string())?;
    Ok(Outcome::Done)
}
