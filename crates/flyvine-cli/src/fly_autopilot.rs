//! `flyvine fly --vehicle mavlink:…`: a plan on a vehicle behind an autopilot, in real time.

use std::net::SocketAddr;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::control::supervisor::Limits;
use flyvine::control::{FlightOutcome, Trajectory, fly};
use flyvine::link::{Vehicle, VehicleError};
use flyvine::task::Plan;
use flyvine_link::autopilot::{
    AutopilotVehicle, DryRunError, Flags, Journaled, LinkOptions, MonotonicClock, NoArm, Profile, SigningKey,
    Station, TickReport, dry_run, open, with_deadline,
};
use flyvine_link::rehearsal::{ArmClient, PoseListener};

use crate::console::{print, say};
use crate::fly::with_controller;
use crate::outcome::{Blame, Failure, Outcome, bad_input};
use flyvine::control::Flying;

/// What a flight on an autopilot needs beside the plan.
#[derive(Args, Clone)]
#[command(next_help_heading = "Flying on an autopilot (--vehicle mavlink:…)")]
pub struct AutopilotArguments {
    /// Where the poses come from: `loopback:HOST:PORT` listens for those of `flyvine rehearse`.
    #[arg(long, value_name = "SOURCE")]
    mocap: Option<String>,
    /// The arm: `loopback:HOST:PORT` calls that of `flyvine rehearse`; left out, nobody commands it.
    #[arg(long, value_name = "LINE")]
    arm: Option<String>,
    /// Which autopilot it is.
    #[arg(long, value_enum, default_value_t = ProfileChoice::Px4)]
    autopilot: ProfileChoice,
    /// A file with the 64 hexadecimal digits of the link's signing key; without it, frames are not signed.
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// The supervisor's limits (TOML, as the table [supervisor] of a vehicle's file); what is left out takes its default.
    #[arg(long, value_name = "LIMITS.toml")]
    limits: Option<PathBuf>,
    /// Go through the checklist and stream the plan to the vehicle while it stays disarmed; arm nothing.
    #[arg(long)]
    dry_run: bool,
    /// Time for one step of the controller, ms; a tick that it misses is flown without it, two running end the flight.
    #[arg(long, value_name = "MS", default_value_t = 30.0)]
    tick_budget_ms: f64,
    /// Where to write how well the ticks of 20 Hz were kept (JSON).
    #[arg(long, value_name = "TICKS.json")]
    ticks: Option<PathBuf>,
    /// Where to write every step as it is flown, from before arming until after landing (CSV, readable after a crash).
    #[arg(long, value_name = "JOURNAL.csv")]
    journal: Option<PathBuf>,
}

/// The autopilots that there are profiles for.
#[derive(Clone, Copy, ValueEnum)]
enum ProfileChoice {
    /// PX4, in OFFBOARD.
    Px4,
    /// ArduPilot Copter, in GUIDED.
    Ardupilot,
}

/// What became of it.
pub struct RealFlight {
    /// The flight; none of a dry run.
    pub outcome: Option<FlightOutcome>,
    /// How it ended.
    pub ended: Outcome,
}

/// Flies `plan` on the autopilot at `address`, or goes through everything but the flight.
pub fn fly_on_autopilot(
    plan: &Plan,
    flying: &Flying,
    address: &str,
    arguments: &AutopilotArguments,
) -> Result<RealFlight, Failure> {
    let limits = read_limits(arguments)?;
    let station = open_station(address, arguments)?;
    let flags = Flags::default();
    for signal in [
        signal_hook::consts::SIGINT,
        signal_hook::consts::SIGTERM,
        signal_hook::consts::SIGHUP,
    ] {
        signal_hook::flag::register(signal, Arc::clone(&flags.interrupted)).or_internal()?;
    }
    let options = LinkOptions {
        profile: match arguments.autopilot {
            ProfileChoice::Px4 => Profile::Px4,
            ProfileChoice::Ardupilot => Profile::ArduPilot,
        },
        key: arguments.signing_key.as_deref().map(read_key).transpose()?,
        ..LinkOptions::default()
    };
    with_controller(plan, flying, &limits, |trajectory, controller| {
        let mut vehicle = AutopilotVehicle::new(options, station, flags.clone(), trajectory.clone(), limits);
        say("waiting for the autopilot …");
        let ready = match vehicle.prepare() {
            Ok(checklist) => {
                print(&checklist.to_string())?;
                checklist.is_ready()
            }
            Err(VehicleError::Interrupted) => {
                say("stopped before anything was armed");
                false
            }
            Err(error) => return Err(error).or_internal(),
        };
        say_notes(&mut vehicle);
        if !ready {
            say("not ready to fly: nothing was armed");
            return Ok(RealFlight {
                outcome: None,
                ended: Outcome::Untrusted,
            });
        }
        let interrupted = || match flags.interrupted.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let flight = if arguments.dry_run {
            dry(&mut vehicle, trajectory, limits, &mut |_, _| interrupted())?
        } else {
            let budget = Duration::from_secs_f64(1e-3 * arguments.tick_budget_ms);
            let outcome = with_deadline(controller, budget, |controller| {
                let mut fly_it = |vehicle: &mut dyn Vehicle| {
                    fly(trajectory, controller, limits, vehicle, 0, &mut |_, _| {
                        interrupted()
                    })
                    .or_input()
                };
                match &arguments.journal {
                    None => fly_it(&mut vehicle),
                    Some(path) => {
                        let mut journaled = Journaled::create(path, &mut vehicle, &flags)
                            .with_context(|| path.display().to_string())
                            .or_input()?;
                        let outcome = fly_it(&mut journaled);
                        journaled.close().or_internal()?;
                        outcome
                    }
                }
            })?;
            RealFlight {
                outcome: Some(outcome),
                ended: Outcome::Done,
            }
        };
        vehicle.close().or_internal()?;
        say_notes(&mut vehicle);
        if let Some(report) = vehicle.tick_report() {
            say(&describe(&report));
            if let Some(path) = &arguments.ticks {
                let json = serde_json::to_vec_pretty(&report).or_internal()?;
                flyvine::file::write_whole(path, &json).or_internal()?;
            }
        }
        Ok(flight)
    })?
}

fn dry(
    vehicle: &mut AutopilotVehicle,
    trajectory: &Trajectory,
    limits: Limits,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<RealFlight, Failure> {
    say("dry run: streaming to the disarmed vehicle …");
    let run = match dry_run(vehicle, trajectory, limits, progress) {
        Ok(run) => run,
        Err(DryRunError::Supervisor(error)) => return Err(error).or_input(),
        Err(DryRunError::Vehicle(error)) => return Err(error).or_internal(),
    };
    for event in &run.events {
        say(&event.to_string());
    }
    let ended = match run.reason {
        Some(reason) => {
            say(&format!("the flight would have ended: {reason}"));
            Outcome::Untrusted
        }
        None => Outcome::Done,
    };
    print(&format!(
        "dry run: {} set-points sent, nothing armed",
        run.setpoints
    ))?;
    Ok(RealFlight { outcome: None, ended })
}

fn open_station(address: &str, arguments: &AutopilotArguments) -> Result<Station, Failure> {
    let clock = MonotonicClock::start();
    let Some(mocap) = &arguments.mocap else {
        return bad_input(
            "--vehicle mavlink:… needs --mocap: nothing flies without knowing where it is".to_owned(),
        );
    };
    let listen = loopback("--mocap", mocap)?;
    let poses = PoseListener::bind(listen, clock)
        .with_context(|| format!("--mocap {mocap}"))
        .or_input()?;
    let arm: Box<dyn flyvine_link::autopilot::ArmLink> = match &arguments.arm {
        None => Box::new(NoArm),
        Some(arm) => Box::new(
            ArmClient::to(loopback("--arm", arm)?)
                .with_context(|| format!("--arm {arm}"))
                .or_input()?,
        ),
    };
    Ok(Station {
        clock: Box::new(clock),
        wire: open(address).context("--vehicle mavlink").or_input()?,
        poses: Box::new(poses),
        arm,
    })
}

/// The address in `loopback:HOST:PORT`.
fn loopback(option: &str, found: &str) -> Result<SocketAddr, Failure> {
    let address = found.strip_prefix("loopback:").and_then(|rest| rest.parse().ok());
    match address {
        Some(address) => Ok(address),
        None => bad_input(format!("{option} {found}: expected loopback:HOST:PORT")),
    }
}

/// The limits of a flight over wires: the silence of autopilot and arm is watched.
fn read_limits(arguments: &AutopilotArguments) -> Result<Limits, Failure> {
    let mut limits = match &arguments.limits {
        None => Limits::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .with_context(|| path.display().to_string())
                .or_input()?;
            toml::from_str(&text)
                .with_context(|| path.display().to_string())
                .or_input()?
        }
    };
    let wired = flyvine_link::rehearsal::wired_limits();
    limits.autopilot_silence_s = limits.autopilot_silence_s.or(wired.autopilot_silence_s);
    if arguments.arm.is_some() {
        limits.arm_silence_s = limits.arm_silence_s.or(wired.arm_silence_s);
    }
    Ok(limits)
}

fn read_key(path: &Path) -> Result<SigningKey, Failure> {
    let text = std::fs::read_to_string(path)
        .with_context(|| path.display().to_string())
        .or_input()?;
    SigningKey::parse(&text)
        .with_context(|| path.display().to_string())
        .or_input()
}

fn say_notes(vehicle: &mut AutopilotVehicle) {
    for note in vehicle.take_notes() {
        say(&note);
    }
}

fn describe(report: &TickReport) -> String {
    let TickReport {
        setpoints,
        period_ms,
        jitter_median_ms,
        jitter_p999_ms,
        jitter_max_ms,
        late,
        missed,
    } = report;
    format!(
        "{setpoints} set-points every {period_ms:.2} ms; jitter: median {jitter_median_ms:.2} ms, 99.9 % within \
         {jitter_p999_ms:.2} ms, largest {jitter_max_ms:.2} ms; {late} ticks late, {missed} missed"
    )
}
