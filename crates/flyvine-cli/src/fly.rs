//! `flyvine fly`: a plan on a vehicle.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::control::mpc::{ModelPredictive, MpcOptions, QpStatus};
use flyvine::control::supervisor::Limits;
use flyvine::control::{Controller, End, FlightOutcome, OpenLoop, StepRecord, Tracking, Trajectory, fly};
use flyvine::flight::write_flight;
use flyvine::link::Vehicle;
use flyvine::link::exec::{ExecOptions, ExecVehicle};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, read_plan};

use crate::console::{progress, say};
use crate::convert::extension;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Fly a plan on a vehicle and record the flight.
///
/// VEHICLE is `sim` or `sim:vehicle.toml` (built in), or `exec:PROGRAM ARGS`: your own simulator or rig as a child
/// process that speaks one JSON object per line on stdin/stdout (examples/vehicle.py is one). A supervisor owns every
/// command: it refuses NaN, stale, frozen and jumping poses, and keeps quadrotor and tip inside the room. An aborted
/// flight exits with code 3; its recording is kept.
///
///   flyvine fly plan.json --vehicle sim --out flight.mcap
///   flyvine fly plan.json --vehicle "exec:python3 examples/vehicle.py" --out flight.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct FlyArguments {
    /// The plan.
    #[arg(value_name = "PLAN.json")]
    plan: PathBuf,
    /// What to fly it on.
    #[arg(long, value_name = "VEHICLE")]
    vehicle: String,
    /// The control law.
    #[arg(long, value_enum, default_value_t = ControllerChoice::OpenLoop)]
    controller: ControllerChoice,
    /// Settings of `--controller mpc` (TOML); what is left out takes its default.
    #[arg(long, value_name = "OPTIONS.toml")]
    mpc_options: Option<PathBuf>,
    /// Where to write the recording: .mcap (opens in Foxglove, Rerun and PlotJuggler) or .csv.
    #[arg(long, value_name = "FLIGHT")]
    out: PathBuf,
    /// Seed of the vehicle's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The control laws that can be flown.
#[derive(Clone, Copy, ValueEnum)]
pub enum ControllerChoice {
    /// The plan's commands as they are.
    OpenLoop,
    /// The plan's commands, corrected by its time-varying feedback gains.
    Tracking,
    /// Model-predictive control along the plan, behind an estimator of disturbances and delay.
    Mpc,
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
    let OpenVehicle { mut vehicle, limits } = open_vehicle(&arguments.vehicle)?;
    let options = match &arguments.mpc_options {
        Some(path) => read_mpc_options(path)?,
        None => MpcOptions::default(),
    };
    let bar = progress(plan.knots() as u64, "flying");
    let outcome = fly_plan(
        &plan,
        arguments.controller,
        &options,
        limits,
        vehicle.as_mut(),
        arguments.seed,
        &mut |knot, _| {
            bar.set_position(knot as u64);
            ControlFlow::Continue(())
        },
    );
    bar.finish_and_clear();
    let outcome = outcome?;
    write_flight(&arguments.out, &outcome.flight).or_internal()?;
    say(&format!(
        "wrote {} ({} rows)",
        arguments.out.display(),
        outcome.flight.samples.len()
    ));
    for event in &outcome.events {
        say(&event.to_string());
    }
    if let Some(summary) = describe_steps(&outcome.steps) {
        say(&summary);
    }
    let closed = vehicle.close();
    if let End::Aborted { t_s, cause } = &outcome.end {
        say(&format!("flight aborted at {t_s:.2} s: {cause}"));
        return Ok(Outcome::Untrusted);
    }
    if let Err(error) = closed {
        say(&format!(
            "warning: the vehicle did not end in good order: {error}"
        ));
    }
    Ok(Outcome::Done)
}

/// Flies a plan with its task's command bounds.
pub fn fly_plan(
    plan: &Plan,
    controller: ControllerChoice,
    options: &MpcOptions,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<FlightOutcome, Failure> {
    let bounds = plan.task.command_bounds();
    let trajectory = Trajectory::new(
        plan.commands.clone(),
        plan.states.clone(),
        plan.gains.clone(),
        plan.configurations.clone(),
        bounds.lower,
        bounds.upper,
    )
    .or_input()?;
    let model = plan.bank.scheduled(&plan.configurations).or_input()?;
    let mut controller: Box<dyn Controller> = match controller {
        ControllerChoice::OpenLoop => Box::new(OpenLoop::new(&trajectory)),
        ControllerChoice::Tracking => Box::new(Tracking::new(&trajectory, &model).or_input()?),
        ControllerChoice::Mpc => Box::new(
            ModelPredictive::new(&trajectory, &model, &plan.reference, &limits.room, options).or_input()?,
        ),
    };
    let mut outcome = fly(&trajectory, controller.as_mut(), limits, vehicle, seed, progress).or_input()?;
    outcome.flight.name.clone_from(&plan.task.name);
    Ok(outcome)
}

/// Times and outcomes of a controller that optimizes; nothing for others.
fn describe_steps(steps: &[StepRecord]) -> Option<String> {
    let reports: Vec<_> = steps.iter().filter_map(|step| step.report).collect();
    let last = reports.last()?;
    let mut times: Vec<f64> = steps.iter().map(|step| step.step_ms).collect();
    times.sort_by(f64::total_cmp);
    let unsolved = reports
        .iter()
        .filter(|report| report.status != QpStatus::Optimal)
        .count();
    let residual = reports.iter().map(|report| report.residual).fold(0.0, f64::max);
    Some(format!(
        "{} steps: median {:.3} ms, slowest {:.3} ms; {unsolved} not solved to the end, largest residual {residual:.1e}; \
         commands arrive {:.2} ± {:.2} knots later than the model knows",
        reports.len(),
        times[times.len() / 2],
        times[times.len() - 1],
        last.delay_knots,
        last.delay_deviation_knots
    ))
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
struct OpenVehicle {
    vehicle: Box<dyn Vehicle>,
    limits: Limits,
}

/// Opens `sim`, `sim:FILE` or `exec:PROGRAM ARGS`.
fn open_vehicle(name: &str) -> Result<OpenVehicle, Failure> {
    let (vehicle, limits): (Box<dyn Vehicle>, Limits) = match name.split_once(':') {
        None if name == "sim" => (
            Box::new(SimulatedVehicle::new(VehicleParameters::default()).or_internal()?),
            Limits::default(),
        ),
        Some(("sim", path)) => {
            let (parameters, limits) = read_vehicle_file(path)
                .map_err(|error| error.context(path.to_owned()))
                .or_input()?;
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
        _ => {
            return bad_input(format!(
                "--vehicle {name}: expected `sim`, `sim:vehicle.toml` or `exec:PROGRAM ARGS`"
            ));
        }
    };
    Ok(OpenVehicle { vehicle, limits })
}

/// A vehicle's TOML: the simulated vehicle's parameters, and a table `[supervisor]` with its limits.
fn read_vehicle_file(path: &str) -> anyhow::Result<(VehicleParameters, Limits)> {
    let mut table: toml::Table = std::fs::read_to_string(path)?.parse()?;
    let limits = match table.remove("supervisor") {
        Some(limits) => limits
            .try_into()
            .map_err(|error: toml::de::Error| anyhow::anyhow!("supervisor: {error}"))?,
        None => Limits::default(),
    };
    Ok((VehicleParameters::from_toml(&toml::to_string(&table)?)?, limits))
}
