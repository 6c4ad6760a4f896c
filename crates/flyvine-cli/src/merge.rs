//! `flyvine merge`: the shards of a sweep as one table.

use std::path::PathBuf;

use clap::Args;
use flyvine_sweep::merge;

use crate::console::say;
use crate::outcome::{Blame, CommandResult};
use crate::sweep::{read_sweep, tell};

/// Make the table of a sweep whose shards were computed, here or elsewhere.
///
/// Every row is taken from the journals of DIR and of the folders given by --from (brought from other machines). The
/// result is DIR/results.parquet, the same bytes as if one machine had computed everything. Exit code 2 if rows are
/// missing.
///
///   flyvine merge SWEEP.toml --out run-wind
///   flyvine merge SWEEP.toml --out run-wind --from from-machine-a --from from-machine-b
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct MergeArguments {
    /// The sweep.
    #[arg(value_name = "SWEEP.toml")]
    sweep: PathBuf,
    /// Its folder.
    #[arg(long, value_name = "DIR", default_value = "run-sweep")]
    out: PathBuf,
    /// A folder of the same sweep from another machine.
    #[arg(long, value_name = "DIR")]
    from: Vec<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine merge`.
pub fn run(arguments: &MergeArguments) -> CommandResult {
    let sweep = read_sweep(&arguments.sweep, &arguments.out)?;
    let folders: Vec<PathBuf> = [&arguments.out]
        .into_iter()
        .chain(&arguments.from)
        .cloned()
        .collect();
    let (path, rows) = merge(&sweep, &folders, &arguments.out).or_input()?;
    say(&format!("wrote {} ({} rows)", path.display(), rows.len()));
    tell(&sweep, &rows, &arguments.sweep, &arguments.out, arguments.json)
}
