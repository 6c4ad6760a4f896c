//! `flyvine fly`: a plan on a vehicle.

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use flyvine::control::supervisor::Limits;
use flyvine::control::{End, FlightOutcome, OpenLoop, Tracking, Trajectory, fly};
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
    let bar = progress(plan.knots() as u64, "flying");
    let outcome = fly_plan(
        &plan,
        arguments.controller,
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
    let mut outcome = match controller {
        ControllerChoice::OpenLoop => fly(
            &trajectory,
            &mut OpenLoop::new(&trajectory),
            limits,
            vehicle,
            seed,
            progress,
        )
        .or_input(),
        ControllerChoice::Tracking => {
            let model = plan.bank.scheduled(&plan.configurations).or_input()?;
            let mut tracking = Tracking::new(&trajectory, &model).or_input()?;
            fly(&trajectory, &mut tracking, limits, vehicle, seed, progress).or_input()
        }
    }?;
    outcome.flight.name.clone_from(&plan.task.name);
    Ok(outcome)
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
