//! `flyvine query`: SQL over the tables of sweeps.

use std::path::PathBuf;
use std::process::Command;

use clap::Args;

use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Ask the tables of any number of sweeps, in SQL.
///
/// RUNS are sweep folders, Parquet files or patterns of them; together they are the table `rows`, whose column
/// `filename` says where a row is from. The engine is DuckDB, as the Python package's `flyvine.query` has it: this command
/// runs it, and says how to install it where it is missing.
///
///   flyvine query run-wind 'SELECT controller, avg(ee_vs_reference_mean_m) FROM rows GROUP BY controller'
///   flyvine query 'run-*' 'SELECT * FROM rows WHERE NOT success' --csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct QueryArguments {
    /// Sweep folders, Parquet files or patterns, and last the query.
    #[arg(value_name = "RUNS… SQL", required = true, num_args = 2..)]
    runs_and_query: Vec<String>,
    /// Print CSV.
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    /// Print JSON, one object per row.
    #[arg(long)]
    json: bool,
    /// The Python that has the package flyvine[query]; otherwise the one that FLYVINE_PYTHON names, or python3.
    #[arg(long, value_name = "PROGRAM")]
    python: Option<PathBuf>,
}

/// Runs `flyvine query`.
pub fn run(arguments: &QueryArguments) -> CommandResult {
    let named = || std::env::var_os("FLYVINE_PYTHON").map(PathBuf::from);
    let python = &(arguments.python.clone())
        .or_else(named)
        .unwrap_or_else(|| PathBuf::from("python3"));
    let has_package = Command::new(python)
        .args(["-c", "import flyvine.query"])
        .output()
        .map_err(|error| Failure::Input(anyhow::anyhow!("{}: {error}; {INSTALL}", python.display())))?;
    if !has_package.status.success() {
        let said = String::from_utf8_lossy(&has_package.stderr);
        let last = said.lines().last().unwrap_or_default();
        return bad_input(format!("{}: {last}; {INSTALL}", python.display()));
    }
    let mut command = Command::new(python);
    command.args(["-m", "flyvine.query"]);
    for (wanted, option) in [(arguments.csv, "--csv"), (arguments.json, "--json")] {
        if wanted {
            command.arg(option);
        }
    }
    let status = command
        .arg("--")
        .args(&arguments.runs_and_query)
        .status()
        .or_internal()?;
    match status.code() {
        Some(0) => Ok(Outcome::Done),
        Some(2) => bad_input("the query was refused".to_owned()),
        _ => Err(Failure::Internal(anyhow::anyhow!("flyvine.query: {status}"))),
    }
}

const INSTALL: &str = "`flyvine query` runs the Python package: pip install './crates/flyvine-py[query]', and name its \
                       Python by --python or FLYVINE_PYTHON";
