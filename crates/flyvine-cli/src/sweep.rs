//! `flyvine sweep`: a plan on many vehicles.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::file::write_whole;
use flyvine::run::write_experiment;
use flyvine_sweep::{
    Group, RowResult, Shard, SlurmOptions, Summary, Sweep, WorstRow, merge, run as run_shard, slurm_script,
    summarize,
};

use crate::arm_shape::WatchedVehicle;
use crate::console::{centimetres, print, print_json, progress, say, table};
use crate::fit::write_json;
use crate::outcome::{Blame, CommandResult, Failure, Outcome};

/// Fly plans on many simulated vehicles: a grid of parameters, spreads drawn by every seed, several control laws.
///
/// The rows go on all cores into DIR/journal as they are done, and then into DIR/results.parquet. A row is computed once:
/// interrupt the command, or kill it, and the same command goes on where it was; add seeds or values, and only they are
/// computed. The table's bytes depend neither on interruptions nor on threads, shards or machines of one kind.
///
///   name = "wind and payload"
///   bank = "bank.json"                       # tasks are planned on it …
///   tasks = ["examples/tasks/swing_ES.toml"]
///   plans = []                               # … finished plans need none
///   controllers = ["open-loop", "mpc"]
///   seeds = 20
///   [grid]                                   # vehicle parameters: every combination is flown
///   "payload.tip_mass_kg" = [0.0, 0.02, 0.04]
///   "wind.mean_m_s.0" = [0.0, 1.0, 2.0]
///   [spread]                                 # drawn by every seed
///   "arm.tip_mass_kg" = { relative = 0.1 }
///   "autopilot.command_delay_s" = { uniform = [0.0, 0.05] }
///   [success]
///   mean_error_m = 0.1
///
///   flyvine sweep SWEEP.toml --out run-wind
///   flyvine sweep SWEEP.toml --out run-wind --shard 3/8     (then, when all are done: flyvine merge)
///   flyvine sweep SWEEP.toml --out run-wind --slurm job.sh --shards 50
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct SweepArguments {
    /// The sweep.
    #[arg(value_name = "SWEEP.toml")]
    sweep: PathBuf,
    /// Its folder.
    #[arg(long, value_name = "DIR", default_value = "run-sweep")]
    out: PathBuf,
    /// Compute only every n-th row, from the i-th on; `flyvine merge` makes the table when all shards are done.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Fly one row again, by the beginning of its key, and keep it as a run: DIR/replays/KEY.
    #[arg(long, value_name = "KEY", conflicts_with_all = ["shard", "slurm"])]
    replay: Option<String>,
    /// Compute nothing; write a script for SLURM's `sbatch`, one job of an array per shard.
    #[arg(long, value_name = "SCRIPT", conflicts_with = "shard")]
    slurm: Option<PathBuf>,
    /// Jobs of the script.
    #[arg(long, value_name = "N", default_value_t = 16, requires = "slurm", value_parser = parse_count)]
    shards: usize,
    /// Cores of each.
    #[arg(long, value_name = "N", default_value_t = 4, requires = "slurm", value_parser = parse_count)]
    cores: usize,
    /// Time limit of each, as SLURM writes it.
    #[arg(long, value_name = "HH:MM:SS", default_value = "04:00:00", requires = "slurm", value_parser = parse_time)]
    time: String,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine sweep`.
pub fn run(arguments: &SweepArguments) -> CommandResult {
    let sweep = read_sweep(&arguments.sweep, &arguments.out)?;
    if let Some(script) = &arguments.slurm {
        return write_script(arguments, &sweep, script);
    }
    if let Some(key) = &arguments.replay {
        return replay(arguments, &sweep, key);
    }
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let bar = progress(0, "flights");
    bar.set_style(crate::console::eta_style());
    let report = run_shard(&sweep, &arguments.out, shard, &|at| {
        bar.set_length(at.to_compute as u64);
        bar.set_position(bar.position().max(at.computed as u64));
    });
    bar.finish_and_clear();
    let report = report.or_input()?;
    say(&format!(
        "{} rows: {} computed now, {} before",
        report.rows, report.computed, report.kept
    ));
    if shard != Shard::WHOLE {
        say(&format!(
            "shard {}/{} is done; when all are: flyvine merge {} --out {}",
            shard.number,
            shard.of,
            arguments.sweep.display(),
            arguments.out.display()
        ));
        return Ok(Outcome::Done);
    }
    let folders = [arguments.out.clone()];
    let (path, rows) = merge(&sweep, &folders, &arguments.out).or_input()?;
    say(&format!("wrote {}", path.display()));
    tell(&sweep, &rows, &arguments.sweep, &arguments.out, arguments.json)
}

/// Reads a sweep, telling what is planned.
pub fn read_sweep(path: &Path, folder: &Path) -> Result<Sweep, Failure> {
    Sweep::read(path, &folder.join("plans"), &mut |task| {
        say(&format!("planning {task} …"));
    })
    .or_input()
}

/// Writes and prints what a sweep says.
pub fn tell(
    sweep: &Sweep,
    rows: &[(String, RowResult)],
    file: &Path,
    folder: &Path,
    json: bool,
) -> CommandResult {
    let summary = summarize(sweep, rows);
    write_json(&folder.join("summary.json"), &summary)?;
    for figure in &summary.figures {
        let path = folder.join("figures").join(format!("{}.svg", figure.name));
        write_whole(&path, figure.svg.as_bytes()).or_internal()?;
    }
    if json {
        print_json(&summary)?;
    } else {
        print(&group_table(&summary.groups))?;
        print("\nThe flights to look at first:")?;
        print(&worst_table(&summary))?;
        if let Some(first) = summary.worst.first() {
            print(&format!(
                "replay: flyvine sweep {} --out {} --replay {}",
                file.display(),
                folder.display(),
                short(&first.key)
            ))?;
        }
        print(&format!("figures: {}", folder.join("figures").display()))?;
    }
    Ok(Outcome::Done)
}

fn replay(arguments: &SweepArguments, sweep: &Sweep, key: &str) -> CommandResult {
    let index = sweep.find(key).or_input()?;
    let refused = |cause: String| Failure::Input(anyhow::anyhow!("row {index}: nothing was flown: {cause}"));
    let mut vehicle = WatchedVehicle::new(sweep.vehicle(index).map_err(refused)?);
    let outcome = sweep.fly(index, &mut vehicle).map_err(refused)?;
    let arm = vehicle.into_shapes(outcome.flight.samples.len());
    let run = arguments.out.join("replays").join(short(&sweep.key(index)));
    write_experiment(&run, sweep.row(index).plan, &outcome.flight, &arm).or_internal()?;
    for event in &outcome.events {
        say(&event.to_string());
    }
    print(&format!(
        "wrote {}; see it: flyvine report {}",
        run.display(),
        run.display()
    ))?;
    Ok(Outcome::Done)
}

fn write_script(arguments: &SweepArguments, sweep: &Sweep, script: &Path) -> CommandResult {
    let absolute = |path: &Path| -> Result<String, Failure> {
        Ok(std::path::absolute(path)
            .or_internal()?
            .to_string_lossy()
            .into_owned())
    };
    let options = SlurmOptions {
        sweep: absolute(&arguments.sweep)?,
        folder: absolute(&arguments.out)?,
        shards: arguments.shards.min(sweep.rows()),
        cores: arguments.cores,
        time: arguments.time.clone(),
    };
    write_whole(script, slurm_script(sweep.name(), &options).as_bytes()).or_internal()?;
    say(&format!(
        "wrote {}: {} rows in {} jobs",
        script.display(),
        sweep.rows(),
        options.shards
    ));
    Ok(Outcome::Done)
}

fn group_table(groups: &[Group]) -> String {
    let error = |error: Option<f64>| error.map_or("–".to_owned(), centimetres);
    let rows = groups.iter().map(|group| {
        vec![
            format!("{}, {}", group.task, group.controller),
            group.flights.to_string(),
            format!("{:.1} %", 100.0 * group.successes as f64 / group.flights as f64),
            group.aborted.to_string(),
            group.refused.to_string(),
            error(group.median_error_m),
            error(group.p95_error_m),
        ]
    });
    let header = [
        "EE error (swings: target miss), cm",
        "flights",
        "successes",
        "aborted",
        "refused",
        "median",
        "95 %",
    ];
    table(&header, rows)
}

fn worst_table(summary: &Summary) -> String {
    let rows = summary.worst.iter().map(|row: &WorstRow| {
        let parameters: Vec<String> = row
            .parameters
            .iter()
            .map(|(path, value)| format!("{path} = {value:.4}"))
            .collect();
        vec![
            short(&row.key).to_owned(),
            format!("{}, {}, seed {}", row.task, row.controller, row.seed),
            parameters.join("\n"),
            match row.error_m {
                Some(error_m) => format!("{} cm", centimetres(error_m)),
                None => row.cause.clone(),
            },
        ]
    });
    table(&["key", "flight", "vehicle", "error"], rows)
}

/// Enough of a key to find its row by.
fn short(key: &str) -> &str {
    &key[..12.min(key.len())]
}

fn parse_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count >= 1 => Ok(count),
        _ => Err(format!("found `{text}`, expected a whole number ≥ 1")),
    }
}

fn parse_time(text: &str) -> Result<String, String> {
    let plain = !text.is_empty() && text.chars().all(|c| c.is_ascii_digit() || c == ':' || c == '-');
    plain
        .then(|| text.to_owned())
        .ok_or_else(|| format!("found `{text}`, expected [D-]HH:MM:SS"))
}
