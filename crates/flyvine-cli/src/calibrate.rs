//! `flyvine calibrate`: the simulated vehicle's physical parameters from recorded flights.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::flight::Configuration;
use flyvine::sim::calibrate::{Calibration, CalibrationOptions, FreeParameter, calibrate};
use flyvine::sim::hover::modes;
use flyvine::sim::replay::{Recording, ReplayRow, replay_table};
use flyvine::sim::{SimulatedVehicle, VehicleParameters, free, paper};

use crate::calibrate_report::{Distances, FlightLine, HoverLine, ParameterLine, Report, Role};
use crate::console::{print, print_json, say};
use crate::flights::{configuration_label, load_flights};
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Fit the simulated vehicle's physical parameters to recorded flights, so that `--vehicle sim:vehicle.toml` flies
/// like yours.
///
/// The recorded commands are flown on the simulated vehicle, from hover; Levenberg–Marquardt changes gains, delays,
/// masses, drag, stiffness and damping, each within a factor of its start, until the replay comes as near to the
/// recording as it can. Every parameter gets a 95 % confidence interval; what the flights cannot tell is marked, and
/// keeps little meaning. Judge the result by flights that were not fitted: `--hold-out` or `--leave-one-out`. The last table
/// is the least damped oscillation of vehicle and autopilot about hover, per configuration: near zero, the vehicle swings on
/// its own in slow flight.
///
///   flyvine calibrate flights/*.csv --out vehicle.toml --hold-out flights/swing_7.csv
///   flyvine calibrate flights/*.csv --vehicle examples/vehicles/crazyflie_slung.toml --out vehicle.toml
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct CalibrateArguments {
    /// Recordings in flyvine's CSV format that begin in hover (see `flyvine convert` for others).
    #[arg(value_name = "FLIGHT", required_unless_present = "paper_commands")]
    flights: Vec<PathBuf>,
    /// Vehicle to start from; without it, the built-in one.
    #[arg(long, value_name = "START.toml")]
    vehicle: Option<PathBuf>,
    /// Where to write the calibrated vehicle.
    #[arg(long, value_name = "VEHICLE.toml")]
    out: PathBuf,
    /// Recordings that are compared, but not fitted.
    #[arg(long, value_name = "FLIGHT", num_args = 1..)]
    hold_out: Vec<PathBuf>,
    /// Also calibrate once per configuration without its flights, and compare these. What only that configuration's
    /// flights identify (its beam) keeps its value of the start vehicle; with --prior or --tied it follows the other beams.
    #[arg(long)]
    leave_one_out: bool,
    /// Hold what the flights do not tell by what is believed beforehand: each parameter near the start vehicle's, and the
    /// tube the same at either length. The weight against 1 for a flight's curve; 0.1 is a good one. A start vehicle that
    /// was fitted to the same flights would be counted twice.
    #[arg(long, value_name = "WEIGHT", default_value_t = 0.0)]
    prior: f64,
    /// Fit one beam per pressure, which the long arm shares with the short one, instead of one per configuration: fewer
    /// parameters, which say what an arm of another length is like. With --leave-one-out a configuration then follows the
    /// other length's flights.
    #[arg(long)]
    tied: bool,
    /// Parameters to fit, by their path in the vehicle's TOML or the beginning of it (`arm`, `autopilot.position`);
    /// without it, all that replays can say something about.
    #[arg(long, value_name = "PATH", value_delimiter = ',')]
    parameters: Vec<String>,
    /// How far a parameter may move from its start: by this factor up or down.
    #[arg(long, default_value_t = 4.0)]
    factor: f64,
    /// Starts of the search: the given vehicle, and others drawn around it.
    #[arg(long, default_value_t = 1)]
    starts: usize,
    /// Most iterations per start.
    #[arg(long, default_value_t = 20)]
    iterations: usize,
    /// Seed of the drawn starts.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Fit the paper's 4 swings and 8 lemniscates too: folder of the authors' public command files.
    #[arg(long, value_name = "DIR")]
    paper_commands: Option<PathBuf>,
    /// Folder of the paper's measured curves.
    #[arg(long, value_name = "DIR", default_value = "data/paper_figures")]
    paper_figures: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine calibrate`.
pub fn run(arguments: &CalibrateArguments) -> CommandResult {
    if !(arguments.factor.is_finite() && arguments.factor > 1.0) {
        return bad_input(format!(
            "--factor: found {}, expected a number greater than 1",
            arguments.factor
        ));
    }
    if !(arguments.prior.is_finite() && arguments.prior >= 0.0) {
        return bad_input(format!(
            "--prior: found {}, expected a weight of at least 0",
            arguments.prior
        ));
    }
    let (start, others) = match &arguments.vehicle {
        Some(path) => read_vehicle(path)?,
        None => (VehicleParameters::default(), toml::Table::new()),
    };
    let fitted = recordings(arguments)?;
    let held_out = as_recordings(&arguments.hold_out)?;
    let free = free_parameters(arguments, &start)?;

    say(&format!(
        "fitting {} parameters to {} recordings …",
        free.len(),
        fitted.len()
    ));
    let calibration = calibrated(arguments, &start, &free, &fitted)?;
    let mut lines = compare(&start, &calibration.parameters, &fitted, Role::Fitted)?;
    lines.extend(compare(
        &start,
        &calibration.parameters,
        &held_out,
        Role::HeldOut,
    )?);
    if arguments.leave_one_out {
        for (left_out, kept) in by_configuration(&fitted) {
            if kept.is_empty() {
                continue; // the only configuration
            }
            say(&format!("without {} …", label(&left_out[0])));
            let parameters = calibrated(arguments, &start, &free, &kept)?.parameters;
            lines.extend(compare(
                &start,
                &parameters,
                &left_out,
                Role::ConfigurationLeftOut,
            )?);
        }
    }
    write_vehicle(&arguments.out, &calibration.parameters, others)?;
    let report = Report {
        parameters: free
            .iter()
            .zip(&calibration.estimates)
            .map(|(free, estimate)| ParameterLine::new((free.get)(&start), estimate))
            .collect(),
        flights: lines,
        hover: hover(&calibration.parameters, &fitted)?,
        cost: calibration.cost,
        iterations: calibration.iterations,
    };
    if arguments.json {
        print_json(&report)?;
    } else {
        print(&report.parameter_table())?;
        print(&report.flight_table())?;
        print(&report.hover_table())?;
    }
    say(&format!("wrote {}", arguments.out.display()));
    Ok(Outcome::Done)
}

/// The recordings to fit.
fn recordings(arguments: &CalibrateArguments) -> Result<Vec<Recording>, Failure> {
    let mut recordings = as_recordings(&arguments.flights)?;
    if let Some(commands) = &arguments.paper_commands {
        recordings.extend(paper::recordings(commands, &arguments.paper_figures).or_input()?);
    }
    Ok(recordings)
}

fn as_recordings(paths: &[PathBuf]) -> Result<Vec<Recording>, Failure> {
    load_flights(paths)?
        .iter()
        .map(|flight| Recording::from_flight(flight).or_input())
        .collect()
}

/// The parameters to fit, each bounded around its start.
fn free_parameters(
    arguments: &CalibrateArguments,
    start: &VehicleParameters,
) -> Result<Vec<FreeParameter>, Failure> {
    let all = if arguments.tied {
        free::all_tied()
    } else {
        free::all()
    };
    for wanted in &arguments.parameters {
        if !all.iter().any(|free| free.name.starts_with(wanted.as_str())) {
            let names: Vec<&str> = all.iter().map(|free| free.name).collect();
            return bad_input(format!(
                "--parameters: found `{wanted}`, expected one of, or the beginning of:\n  {}",
                names.join("\n  ")
            ));
        }
    }
    let wanted = |free: &&FreeParameter| {
        let named = |wanted: &String| free.name.starts_with(wanted.as_str());
        arguments.parameters.is_empty() || arguments.parameters.iter().any(named)
    };
    Ok(all
        .iter()
        .filter(wanted)
        .filter_map(|free| free.around(start, arguments.factor))
        .collect())
}

fn calibrated(
    arguments: &CalibrateArguments,
    start: &VehicleParameters,
    free: &[FreeParameter],
    recordings: &[Recording],
) -> Result<Calibration, Failure> {
    let options = CalibrationOptions {
        max_iterations: arguments.iterations,
        starts: arguments.starts,
        seed: arguments.seed,
        prior_weight: arguments.prior,
        ..CalibrationOptions::default()
    };
    let progress = |start: usize, iteration: usize, cost: f64, _: &VehicleParameters| {
        say(&format!(
            "start {}, iteration {iteration}: cost {cost:.3}",
            start + 1
        ));
    };
    match calibrate(start, free, recordings, &options, &progress) {
        Some(calibration) => Ok(calibration),
        None => bad_input(
            "the start vehicle cannot fly the recorded commands: it diverges or its parameters contradict each other; \
             expected a vehicle that at least stays in the air (--vehicle)"
                .to_owned(),
        ),
    }
}

/// Replays on both vehicles.
fn compare(
    start: &VehicleParameters,
    calibrated: &VehicleParameters,
    recordings: &[Recording],
    role: Role,
) -> Result<Vec<FlightLine>, Failure> {
    let replay = |parameters: &VehicleParameters| -> Result<Vec<ReplayRow>, Failure> {
        let vehicle = SimulatedVehicle::new(parameters.clone()).or_input()?;
        replay_table(&vehicle, recordings).or_input()
    };
    let distances = |row: &ReplayRow| Distances {
        quadrotor_m: row.quadrotor_m,
        end_effector_m: row.end_effector_m,
        height_m: row.height_m,
    };
    let rows = replay(start)?.into_iter().zip(replay(calibrated)?);
    Ok(rows
        .zip(recordings)
        .map(|((before, after), recording)| FlightLine {
            configuration: label(recording),
            role,
            start: distances(&before),
            calibrated: distances(&after),
            name: after.name,
        })
        .collect())
}

/// The least damped oscillation about hover in every configuration in which a recording begins.
fn hover(parameters: &VehicleParameters, recordings: &[Recording]) -> Result<Vec<HoverLine>, Failure> {
    let mut lines = vec![];
    for (group, _) in by_configuration(recordings) {
        let first = &group[0];
        let found = modes(parameters, first.configurations[0]).or_internal()?;
        lines.extend(found.first().map(|mode| HoverLine {
            configuration: configuration_label(first.configurations[0], None),
            frequency_hz: mode.frequency_hz,
            damping_ratio: mode.damping_ratio,
        }));
    }
    Ok(lines)
}

/// For every configuration: its recordings, and the others.
fn by_configuration(recordings: &[Recording]) -> Vec<(Vec<Recording>, Vec<Recording>)> {
    let first = |recording: &Recording| recording.configurations[0];
    let mut configurations: Vec<Configuration> = Vec::new();
    for configuration in recordings.iter().map(first) {
        if !configurations.contains(&configuration) {
            configurations.push(configuration);
        }
    }
    let split = |configuration| -> (Vec<Recording>, Vec<Recording>) {
        recordings
            .iter()
            .cloned()
            .partition(|recording| first(recording) == configuration)
    };
    configurations.into_iter().map(split).collect()
}

fn label(recording: &Recording) -> String {
    let first = recording.configurations[0];
    let last = recording.configurations[recording.configurations.len() - 1];
    configuration_label(first, (first != last).then_some(last))
}

/// A vehicle's TOML, and the tables in it that are not the simulated vehicle's (`[supervisor]`).
fn read_vehicle(path: &Path) -> Result<(VehicleParameters, toml::Table), Failure> {
    let read = || -> anyhow::Result<(VehicleParameters, toml::Table)> {
        let mut table: toml::Table = std::fs::read_to_string(path)?.parse()?;
        let supervisor = table.remove("supervisor");
        let parameters = VehicleParameters::from_toml(&toml::to_string(&table)?)?;
        let others = supervisor.map(|limits| ("supervisor".to_owned(), limits));
        Ok((parameters, others.into_iter().collect()))
    };
    read()
        .map_err(|error| error.context(path.display().to_string()))
        .or_input()
}

fn write_vehicle(path: &Path, parameters: &VehicleParameters, others: toml::Table) -> Result<(), Failure> {
    let mut table = toml::Table::try_from(parameters).or_internal()?;
    table.extend(others);
    let text = toml::to_string(&table).or_internal()?;
    flyvine::file::write_whole(path, text.as_bytes()).or_internal()
}
