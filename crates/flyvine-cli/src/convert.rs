//! `flyvine convert`: anyone's recording to flyvine's format; a plan to a table of commands.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::flight::{
    Flight, FlightError, HygieneOptions, Mapping, Problem, clean, read_flight, recover_flight, write_flight,
};
use flyvine::task::{read_plan, write_plan_csv};

use crate::console::say;
use crate::convert_parquet::{read_parquet, write_parquet};
use crate::convert_ros::read_ros2_bag;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};
use crate::ulog::read_ulog;

/// Convert a recording between flyvine's CSV, MCAP and Parquet, or a plan to a CSV of its commands.
///
/// An MCAP file that was cut off, by `kill -9` or an empty battery, is mended: what is whole of it is written, and the exit
/// code is 3. A recording in another CSV format needs a mapping (TOML): which columns hold what, in which units, which rows are
/// valid; it is resampled to 20 Hz. See examples/mappings. A log of PX4 (.ulg) needs what PX4 does not know: the arm's length and
/// pressure, and a recording of its tip.
///
///   flyvine convert --mapping examples/mappings/crazyflie_slung.toml log201.csv flight.csv
///   flyvine convert flight.mcap flight.parquet
///   flyvine convert --topics examples/mappings/ros2.toml bag/bag_0.mcap flight.csv
///   flyvine convert --ulog examples/mappings/px4_ulog.toml 12_30_45.ulg flight.csv
///   flyvine convert plan.json commands.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct ConvertArguments {
    /// What to read: a recording (.csv, .mcap, .parquet, .ulg) or a plan (.json).
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// What to write: a recording (.csv, .mcap, .parquet), or a plan's commands (.csv).
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Column mapping of a recording in another format.
    #[arg(long, value_name = "MAPPING.toml")]
    mapping: Option<PathBuf>,
    /// Which topics of a ROS 2 bag (.mcap) hold the flight: examples/mappings/ros2.toml.
    #[arg(long, value_name = "TOPICS.toml", conflicts_with = "mapping")]
    topics: Option<PathBuf>,
    /// What of a PX4 log (.ulg) is the flight, and what PX4 does not know: examples/mappings/px4_ulog.toml.
    #[arg(long, value_name = "LOG.toml", conflicts_with_all = ["mapping", "topics"])]
    ulog: Option<PathBuf>,
}

/// Runs `flyvine convert`.
pub fn run(arguments: &ConvertArguments) -> CommandResult {
    let (input, output) = (&arguments.input, &arguments.output);
    let mut ended = Outcome::Done;
    match (extension(input), extension(output)) {
        ("json", "csv") => {
            let plan = read_plan(input).or_input()?;
            write_plan_csv(output, &plan).or_internal()?;
        }
        ("csv" | "txt" | "tsv" | "mcap" | "parquet" | "ulg", "csv" | "mcap" | "parquet") => {
            let (mut flight, is_cut) = read(arguments)?;
            let report = clean(&mut flight, &HygieneOptions::default());
            if !report.findings.is_empty() {
                say(&format!("{}:\n{report}", input.display()));
            }
            match extension(output) {
                "parquet" => write_parquet(output, &flight).or_internal()?,
                _ => write_flight(output, &flight).or_internal()?,
            }
            if is_cut {
                ended = Outcome::Untrusted;
            }
        }
        (from, to) => {
            return bad_input(format!(
                "cannot convert .{from} to .{to}: expected a recording (.csv, .mcap, .parquet, .ulg) to .csv, .mcap or .parquet, \
                 or a plan (.json) to .csv"
            ));
        }
    }
    say(&format!("wrote {}", output.display()));
    Ok(ended)
}

/// Reads a recording of any kind; whether it was cut off.
fn read(arguments: &ConvertArguments) -> Result<(Flight, bool), Failure> {
    let input = &arguments.input;
    let kind = extension(input);
    if (kind == "ulg") != arguments.ulog.is_some() {
        return bad_input(format!(
            "{}: a log of PX4 (.ulg) goes with --ulog LOG.toml, which says what PX4 does not know \
             (examples/mappings/px4_ulog.toml); nothing else does",
            input.display()
        ));
    }
    if let Some(options) = &arguments.ulog {
        let logged = read_ulog(input, options).or_input()?;
        for note in &logged.notes {
            say(note);
        }
        if logged.is_cut {
            let rows = logged.flight.samples.len();
            say(&format!("{} was cut off: {rows} rows are whole", input.display()));
        }
        return Ok((logged.flight, logged.is_cut));
    }
    match (&arguments.mapping, &arguments.topics) {
        (_, Some(topics)) => Ok((read_ros2_bag(input, topics).or_input()?, false)),
        (Some(mapping), None) => {
            let mapping = Mapping::read(mapping).or_input()?;
            Ok((mapping.read_flight(input).or_input()?, false))
        }
        (None, None) if kind == "parquet" => Ok((read_parquet(input).or_input()?, false)),
        (None, None) => read_or_recover(input).or_input(),
    }
}

/// Reads a flight; of an MCAP file that was cut off, by `kill -9` or an empty battery, what is whole. Whether something was
/// lost is said, and given back.
pub fn read_or_recover(path: &Path) -> Result<(Flight, bool), FlightError> {
    match read_flight(path) {
        Err(error) if matches!(*error.problem, Problem::CutOff { .. }) => {
            let flight = recover_flight(path)?;
            let rows = flight.samples.len();
            say(&format!("{} was cut off: {rows} rows are whole", path.display()));
            Ok((flight, true))
        }
        result => result.map(|flight| (flight, false)),
    }
}

/// A path's extension, empty where it has none.
pub fn extension(path: &Path) -> &str {
    path.extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or("")
}
