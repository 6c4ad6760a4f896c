//! `flyvine fly`: a plan on a vehicle.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::control::mpc::MpcOptions;
use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, End, FlightOutcome, Flying, LapLearning, fly_plan};
use flyvine::flight::{ControlStep, StepStatus, read_control_steps, read_flight, write_controlled_flight};
use flyvine::link::exec::{ExecOptions, ExecVehicle};
use flyvine::link::{RecordedVehicle, Vehicle};
use flyvine::run::read_vehicle_file;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::read_plan;

use crate::console::{progress, say};
use crate::convert::extension;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Fly a plan on a vehicle and record the flight.
///
/// VEHICLE is `sim` or `sim:vehicle.toml` (built in), `exec:PROGRAM ARGS`: your own simulator or rig as a child
/// process that speaks one JSON object per line on stdin/stdout (examples/vehicle.py is one), or `replay:FLIGHT`: a
/// recording, on which a controller repeats its commands to the last bit. A supervisor owns every
/// command: it refuses NaN, stale, frozen and jumping poses, and keeps quadrotor and tip inside the room. An aborted
/// flight exits with code 3; its recording is kept.
///
///   flyvine fly plan.json --vehicle sim --out flight.mcap
///   flyvine fly plan.json --vehicle "exec:python3 examples/vehicle.py" --controller mpc --out flight.csv
///   flyvine fly plan.json --vehicle replay:flight.csv --controller mpc --out again.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct FlyArguments {
    /// The plan.
    #[arg(value_name = "PLAN.json")]
    plan: PathBuf,
    /// What to fly it on.
    #[arg(long, value_name = "VEHICLE")]
    vehicle: String,
    /// The control law; `mpc` wants a plan on physical models.
    #[arg(long, value_enum, default_value_t = ControllerChoice::OpenLoop)]
    controller: ControllerChoice,
    /// Settings of `--controller mpc` (TOML); what is left out takes its default.
    #[arg(long, value_name = "OPTIONS.toml")]
    mpc_options: Option<PathBuf>,
    /// Time for one step of a controller that optimizes, ms; it then answers with the best it has. Without it, every
    /// step is solved to the end.
    #[arg(long, value_name = "MS", value_parser = parse_positive)]
    step_limit_ms: Option<f64>,
    /// Fly this often, learning from lap to lap, each lap with the next seed; every lap is kept beside --out
    /// (`flight_lap_1.mcap`, …), which becomes the best of those that were flown to the end.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    laps: u32,
    /// Where to write the recording: .mcap (opens in Foxglove, Rerun and PlotJuggler) or .csv.
    #[arg(long, value_name = "FLIGHT")]
    out: PathBuf,
    /// Seed of the vehicle's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The control laws that can be flown.
#[derive(Clone, Copy, Default, ValueEnum)]
pub enum ControllerChoice {
    /// The plan's commands as they are.
    #[default]
    OpenLoop,
    /// The plan's commands, corrected by a time-varying regulator behind an estimator.
    Tracking,
    /// Model-predictive control along the plan, behind an estimator of disturbances and delay.
    Mpc,
    /// The rest of the task planned again at every knot, for swings.
    Replan,
}

impl From<ControllerChoice> for ControlLaw {
    fn from(choice: ControllerChoice) -> Self {
        match choice {
            ControllerChoice::OpenLoop => Self::OpenLoop,
            ControllerChoice::Tracking => Self::Tracking,
            ControllerChoice::Mpc => Self::Mpc,
            ControllerChoice::Replan => Self::Replan,
        }
    }
}

/// Runs `flyvine fly`.
pub fn run(arguments: &FlyArguments) -> CommandResult {
    let plan = read_plan(&arguments.plan).or_input()?;
    if !matches!(extension(&arguments.out), "csv" | "mcap") {
        return bad_input(format!(
            "--out {}: expected a .csv or .mcap file",
            arguments.out.display()
        ));
    }
    if arguments.laps > 1 && !matches!(arguments.controller, ControllerChoice::Mpc) {
        return bad_input("--laps: only `--controller mpc` learns from lap to lap".to_owned());
    }
    let mut flying = Flying {
        law: arguments.controller.into(),
        mpc: match &arguments.mpc_options {
            Some(path) => read_mpc_options(path)?,
            None => MpcOptions::default(),
        },
        step_limit: arguments
            .step_limit_ms
            .map(|ms| Duration::from_secs_f64(1e-3 * ms)),
        recorded: match arguments.vehicle.split_once(':') {
            Some(("replay", path)) => read_control_steps(Path::new(path)).or_input()?,
            _ => Vec::new(),
        },
        reference: None,
    };
    let mut learning = LapLearning::new(plan.reference.clone());
    let mut best: Option<(f64, FlightOutcome)> = None;
    let mut ended = Outcome::Done;
    for lap in 0..u64::from(arguments.laps) {
        flying.reference = Some(learning.reference().to_vec());
        let OpenVehicle { mut vehicle, limits } = open_vehicle(&arguments.vehicle)?;
        let bar = progress(plan.knots() as u64, "flying");
        let seed = arguments.seed.wrapping_add(lap);
        let outcome = fly_plan(&plan, &flying, limits, vehicle.as_mut(), seed, &mut |knot, _| {
            bar.set_position(knot as u64);
            ControlFlow::Continue(())
        });
        bar.finish_and_clear();
        let outcome = outcome.or_input()?;
        if let Err(error) = vehicle.close() {
            say(&format!(
                "warning: the vehicle did not end in good order: {error}"
            ));
        }
        for event in &outcome.events {
            say(&event.to_string());
        }
        say_steps(&outcome.steps);
        let error_m = learning.learn(&outcome.flight);
        if let (true, Some(error_m)) = (arguments.laps > 1, error_m) {
            say(&format!("lap {}: {} cm", lap + 1, centimetres_fine(error_m)));
        }
        if arguments.laps > 1 {
            write_recording(&lap_path(&arguments.out, lap + 1), &outcome)?;
        }
        if let End::Aborted { t_s, cause } = &outcome.end {
            say(&format!("flight aborted at {t_s:.2} s: {cause}"));
            ended = Outcome::Untrusted;
        }
        let error_m = match ended {
            Outcome::Done => error_m.unwrap_or(f64::INFINITY),
            Outcome::Untrusted => f64::INFINITY,
        };
        if best.as_ref().is_none_or(|(best_m, _)| error_m < *best_m) {
            best = Some((error_m, outcome));
        }
        if ended == Outcome::Untrusted {
            break;
        }
    }
    let (_, outcome) = best.expect("at least one lap");
    write_recording(&arguments.out, &outcome)?;
    Ok(ended)
}

fn write_recording(path: &Path, outcome: &FlightOutcome) -> Result<(), Failure> {
    write_controlled_flight(path, &outcome.flight, &outcome.steps).or_internal()?;
    say(&format!(
        "wrote {} ({} rows)",
        path.display(),
        outcome.flight.samples.len()
    ));
    Ok(())
}

/// `flight_lap_2.mcap` beside `flight.mcap`.
fn lap_path(out: &Path, lap: u64) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    out.with_file_name(format!("{stem}_lap_{lap}.{}", extension(out)))
}

/// Says times and outcomes of a controller that optimizes; nothing for others.
fn say_steps(steps: &[ControlStep]) {
    let reports: Vec<_> = steps.iter().map(|step| step.report).collect();
    let Some(last) = reports.last() else {
        return;
    };
    let mut times: Vec<f64> = steps.iter().map(|step| step.step_ms).collect();
    times.sort_by(f64::total_cmp);
    let unsolved = reports
        .iter()
        .filter(|report| report.status != StepStatus::Optimal)
        .count();
    let residual = reports.iter().map(|report| report.residual).fold(0.0, f64::max);
    say(&format!(
        "{} steps: median {:.3} ms, slowest {:.3} ms; {unsolved} not solved to the end, largest residual {residual:.1e}; \
         commands arrive {:.2} ± {:.2} knots later than the model knows",
        reports.len(),
        times[times.len() / 2],
        times[times.len() - 1],
        last.delay_knots,
        last.delay_deviation_knots
    ));
}

/// A length in metres as centimetres, to a tenth of a millimetre.
fn centimetres_fine(metres: f64) -> String {
    format!("{:.2}", 100.0 * metres)
}

fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("found `{text}`, expected a positive number")),
    }
}

fn read_mpc_options(path: &Path) -> Result<MpcOptions, Failure> {
    let text = std::fs::read_to_string(path)
        .with_context(|| path.display().to_string())
        .or_input()?;
    toml::from_str(&text)
        .with_context(|| path.display().to_string())
        .or_input()
}

/// A vehicle, and the limits within which it may be flown.
pub struct OpenVehicle {
    /// The vehicle.
    pub vehicle: Box<dyn Vehicle>,
    /// Its supervisor's limits.
    pub limits: Limits,
}

/// Opens `sim`, `sim:FILE` or `exec:PROGRAM ARGS`.
pub fn open_vehicle(name: &str) -> Result<OpenVehicle, Failure> {
    let (vehicle, limits): (Box<dyn Vehicle>, Limits) = match name.split_once(':') {
        None if name == "sim" => (
            Box::new(SimulatedVehicle::new(VehicleParameters::default()).or_internal()?),
            Limits::default(),
        ),
        Some(("sim", path)) => {
            let (parameters, limits) = read_vehicle_file(Path::new(path)).or_input()?;
            (Box::new(SimulatedVehicle::new(parameters).or_input()?), limits)
        }
        Some(("exec", command_line)) => {
            let options = ExecOptions {
                stderr_sink: Some(Box::new(std::io::stderr())),
                ..ExecOptions::default()
            };
            (
                Box::new(ExecVehicle::spawn(command_line, options).or_input()?),
                Limits::default(),
            )
        }
        Some(("replay", path)) => (
            Box::new(RecordedVehicle::new(read_flight(Path::new(path)).or_input()?)),
            Limits::default(),
        ),
        _ => {
            return bad_input(format!(
                "--vehicle {name}: expected `sim`, `sim:vehicle.toml`, `exec:PROGRAM ARGS` or `replay:FLIGHT`"
            ));
        }
    };
    Ok(OpenVehicle { vehicle, limits })
}
