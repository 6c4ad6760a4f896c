//! `flyvine fly`: a plan on a vehicle.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::control::mpc::MpcOptions;
use flyvine::control::supervisor::Limits;
use flyvine::control::{
    ControlLaw, Controller, End, FlightOutcome, Flying, LapLearning, Trajectory, controller, fly_plan_watched,
};
use flyvine::flight::{
    ControlStep, StepStatus, SurroundingsReport, read_control_steps, read_flight, write_controlled_flight,
};
use flyvine::link::exec::{ExecOptions, ExecVehicle};
use flyvine::link::{RecordedVehicle, Vehicle};
use flyvine::run::read_vehicle_file;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, read_plan};

use crate::arm_shape::{ArmNodes, ShownVehicle};
use crate::console::{progress, say};
use crate::convert::extension;
use crate::fly_autopilot::{AutopilotArguments, fly_on_autopilot};
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};
use crate::page::{LiveArguments, LiveRow, LiveSession, PacedVehicle};

/// Fly a plan on a vehicle and record the flight.
///
/// VEHICLE is `sim` or `sim:vehicle.toml` (built in), `exec:PROGRAM ARGS`: your own simulator or rig as a child
/// process that speaks one JSON object per line on stdin/stdout (examples/vehicle.py is one), `replay:FLIGHT`: a
/// recording, on which a controller repeats its commands to the last bit, or `mavlink:ADDRESS`: a real vehicle behind an
/// autopilot, in real time; ADDRESS is udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE:BAUD. A supervisor owns every
/// command: it refuses NaN, stale, frozen and jumping poses, and keeps quadrotor and tip inside the room. An aborted
/// flight exits with code 3; its recording is kept.
///
///   flyvine fly plan.json --vehicle sim --out flight.mcap
///   flyvine fly plan.json --vehicle "exec:python3 examples/vehicle.py" --controller mpc --out flight.csv
///   flyvine fly plan.json --vehicle replay:flight.csv --controller mpc --out again.csv
///   flyvine fly plan.json --vehicle sim --out flight.mcap --live
///   flyvine fly plan.json --vehicle mavlink:udpin:127.0.0.1:14540 --mocap vrpn:192.168.1.10 --bodies bodies.toml \
///     --arm udp:192.168.1.20:14700 --out flight.mcap
///
/// On an autopilot, a checklist comes first and says what is missing and why it matters. The flight is recorded while it is
/// flown: whatever happens to this process, the file is readable to its last quarter of a second (`flyvine convert` mends
/// it). Ctrl-C is an abort: hold, then the autopilot's Hold, then Land. Beside other programs that compute, run it with real-time scheduling: chrt --rr 10.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct FlyArguments {
    /// The plan.
    #[arg(value_name = "PLAN.json")]
    plan: PathBuf,
    /// What to fly it on.
    #[arg(long, value_name = "VEHICLE")]
    vehicle: String,
    /// The control law; `mpc` wants a plan on models that were fitted to lively flights, best with steps in them.
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
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    autopilot: AutopilotArguments,
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
    if let Some(shortfall) = shortfall(&plan) {
        let is_real = arguments.vehicle.starts_with("mavlink:");
        if is_real && !arguments.autopilot.accept_unconverged() {
            return bad_input(format!(
                "{}: found a plan that {shortfall}, expected one that did; --unconverged flies it on a vehicle nonetheless",
                arguments.plan.display()
            ));
        }
        say(&format!("warning: the plan {shortfall}"));
    }
    if !matches!(extension(&arguments.out), "csv" | "mcap") {
        return bad_input(format!(
            "--out {}: expected a .csv or .mcap file",
            arguments.out.display()
        ));
    }
    if arguments.laps > 1 && !matches!(arguments.controller, ControllerChoice::Mpc) {
        return bad_input("--laps: only `--controller mpc` learns from lap to lap".to_owned());
    }
    if arguments.laps > 1 && arguments.live.is_watched() {
        return bad_input("--live, --foxglove: expected a single lap".to_owned());
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
        inconsistency: None,
        reference: None,
    };
    if let Some(address) = arguments.vehicle.strip_prefix("mavlink:") {
        return fly_real(&plan, &flying, address, arguments);
    }
    let mut learning = LapLearning::new(plan.reference.clone());
    let mut best: Option<(f64, FlightOutcome)> = None;
    let mut ended = Outcome::Done;
    for lap in 0..u64::from(arguments.laps) {
        flying.reference = Some(learning.reference().to_vec());
        let OpenVehicle {
            mut vehicle,
            limits,
            arm,
        } = open_vehicle(&arguments.vehicle)?;
        let session = arguments.live.start(&plan)?;
        if session.is_some() {
            vehicle = Box::new(PacedVehicle::new(vehicle));
        }
        let seed = arguments.seed.wrapping_add(lap);
        let outcome = fly_and_show(&plan, &flying, limits, vehicle.as_mut(), seed, session, &arm)?;
        if let Err(error) = vehicle.close() {
            say(&format!(
                "warning: the vehicle did not end in good order: {error}"
            ));
        }
        ended = say_outcome(&outcome);
        flying.inconsistency = outcome.steps.last().map(|step| step.report.inconsistency);
        let error_m = learning.learn(&outcome.flight);
        if let (true, Some(error_m)) = (arguments.laps > 1, error_m) {
            say(&format!("lap {}: {} cm", lap + 1, centimetres_fine(error_m)));
        }
        if arguments.laps > 1 {
            write_recording(&lap_path(&arguments.out, lap + 1), &outcome)?;
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

/// What there is to say of a plan whose solve did not converge.
pub fn shortfall(plan: &Plan) -> Option<String> {
    let solve = &plan.solve;
    let worst = solve.violated.first().map(|worst| format!("; violated: {worst}"));
    (!solve.converged).then(|| format!("did not converge ({}{})", solve.status, worst.unwrap_or_default()))
}

/// Flies a plan on an autopilot. What is flown is recorded as MCAP while it is flown; a CSV is written beside it.
fn fly_real(plan: &Plan, flying: &Flying, address: &str, arguments: &FlyArguments) -> CommandResult {
    let recording = arguments.out.with_extension("mcap");
    let (autopilot, live) = (&arguments.autopilot, &arguments.live);
    let flight = fly_on_autopilot(plan, flying, address, autopilot, live, &recording)?;
    let Some(mut outcome) = flight.outcome else {
        return Ok(flight.ended);
    };
    say(&format!("wrote {}", recording.display()));
    if arguments.out != recording {
        // The same rows; with a full disk, what the flight loop has of them.
        if let Ok(flight) = read_flight(&recording) {
            outcome.flight = flight;
        }
        write_recording(&arguments.out, &outcome)?;
    }
    Ok(say_outcome(&outcome))
}

/// Flies a plan with a progress bar, and on the live page if there is one.
fn fly_and_show(
    plan: &Plan,
    flying: &Flying,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    session: Option<LiveSession>,
    arm: &ArmNodes,
) -> Result<FlightOutcome, Failure> {
    let bar = progress(plan.knots() as u64, "flying");
    let session = RefCell::new(session);
    let outcome = fly_plan_watched(
        plan,
        flying,
        limits,
        vehicle,
        seed,
        &mut |knot, _| {
            bar.set_position(knot as u64);
            match &*session.borrow() {
                Some(session) if session.abort_requested() => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            }
        },
        &mut |flown| {
            if let Some(session) = &mut *session.borrow_mut() {
                session.publish(LiveRow::new(flown, arm.newest()));
            }
        },
    );
    bar.finish_and_clear();
    let outcome = outcome.or_input()?;
    if let Some(session) = session.into_inner() {
        say_end(session, &outcome.end);
    }
    Ok(outcome)
}

/// Tells the watchers how the flight ended.
pub fn say_end(session: LiveSession, end: &End) {
    match end {
        End::Completed => session.finish("flown to the end", true),
        End::Aborted { t_s, cause } => session.finish(&format!("aborted at {t_s:.2} s: {cause}"), false),
    }
}

/// Says what happened in a flight, and whether it was flown to its end.
fn say_outcome(outcome: &FlightOutcome) -> Outcome {
    for event in &outcome.events {
        say(&event.to_string());
    }
    say_steps(&outcome.steps);
    match &outcome.end {
        End::Completed => Outcome::Done,
        End::Aborted { t_s, cause } => {
            say(&format!("flight aborted at {t_s:.2} s: {cause}"));
            Outcome::Untrusted
        }
    }
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

/// Calls `flight` with a plan's trajectory, in its task's command bounds, and the controller that was chosen for it.
pub fn with_controller<R>(
    plan: &Plan,
    flying: &Flying,
    limits: &Limits,
    flight: impl FnOnce(&Trajectory, &mut (dyn Controller + Send)) -> R,
) -> Result<R, Failure> {
    let trajectory = Trajectory::of_plan(plan).or_input()?;
    let model = plan.model().or_input()?;
    let mut controller = controller(plan, &trajectory, &model, flying, limits).or_input()?;
    Ok(flight(&trajectory, controller.as_mut()))
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
    say_surroundings(&last.surroundings);
}

/// Says what was found of wind and load at the end; nothing where neither was estimated.
fn say_surroundings(found: &SurroundingsReport) {
    let SurroundingsReport {
        wind_m_s: [x, y],
        wind_deviation_m_s: [x_deviation, y_deviation],
        tip_load,
        tip_load_deviation,
        ..
    } = found;
    if *x_deviation + *y_deviation + *tip_load_deviation > 0.0 {
        say(&format!(
            "estimated: steady wind ({x:.1} ± {x_deviation:.1}, {y:.1} ± {y_deviation:.1}) m/s, tip heavier by {:.0} ± {:.0} %",
            100.0 * tip_load,
            100.0 * tip_load_deviation
        ));
    }
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
    /// The arm's newest nodes, where the vehicle knows them.
    pub arm: ArmNodes,
}

/// Opens `sim`, `sim:FILE`, `exec:PROGRAM ARGS` or `replay:FLIGHT`.
pub fn open_vehicle(name: &str) -> Result<OpenVehicle, Failure> {
    let arm = ArmNodes::default();
    let simulated = |parameters| -> Result<Box<dyn Vehicle>, Failure> {
        let vehicle = SimulatedVehicle::new(parameters).or_input()?;
        Ok(Box::new(ShownVehicle::new(vehicle, arm.clone())))
    };
    let (vehicle, limits): (Box<dyn Vehicle>, Limits) = match name.split_once(':') {
        None if name == "sim" => (simulated(VehicleParameters::default())?, Limits::default()),
        Some(("sim", path)) => {
            let (parameters, limits) = read_vehicle_file(Path::new(path)).or_input()?;
            (simulated(parameters)?, limits)
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
                "--vehicle {name}: expected `sim`, `sim:vehicle.toml`, `exec:PROGRAM ARGS`, `replay:FLIGHT` or \
                 `mavlink:ADDRESS`"
            ));
        }
    };
    Ok(OpenVehicle { vehicle, limits, arm })
}
