//! `flyvine fly --vehicle mavlink:…`: a plan on a vehicle behind an autopilot, in real time.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::control::supervisor::Limits;
use flyvine::control::{Controller, FlightOutcome, Flying, Trajectory, fly_watched};
use flyvine::link::{Vehicle, VehicleError};
use flyvine::task::Plan;
use flyvine_link::arm::connect;
use flyvine_link::autopilot::{
    ArmLink, AutopilotVehicle, Clock, DryRunError, Flags, LinkOptions, MocapPoses, MonotonicClock, NoArm,
    Profile, SigningKey, Station, TickReport, WiredArm, dry_run, open, with_deadline,
};
use flyvine_link::mocap::{Address, Bodies, HygieneLimits, MocapSource};
use flyvine_link::recording::{FlightLog, FlightRecorder, PlannedPaths};

use crate::console::{print, say};
use crate::fly::{say_end, with_controller};
use crate::outcome::{Blame, Failure, Outcome, bad_input};
use crate::page::{LiveArguments, LiveRow, LiveSession};

/// What a flight on an autopilot needs beside the plan.
#[derive(Args, Clone)]
#[command(next_help_heading = "Flying on an autopilot (--vehicle mavlink:…)")]
pub struct AutopilotArguments {
    /// The motion-capture server: vrpn:HOST[:PORT], vrpn:tcp://HOST[:PORT] or natnet:HOST[:PORT].
    #[arg(long, value_name = "SERVER", requires = "bodies")]
    mocap: Option<String>,
    /// Which of its bodies is which, axes and marker frames, as for `flyvine mocap`.
    #[arg(long, value_name = "BODIES.toml")]
    bodies: Option<PathBuf>,
    /// The arm: serial:PATH[,BAUD], udp:HOST:PORT (behind `flyvine onboard`) or legacy:PATH[,BAUD]; left out, nobody
    /// commands it.
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
    /// Fly a plan whose solve did not converge: it may break what its task demands. Without this such a plan is refused.
    #[arg(long)]
    unconverged: bool,
    /// Time for one step of the controller, ms; a tick that it misses is flown without it, two running end the flight.
    #[arg(long, value_name = "MS", default_value_t = 30.0)]
    tick_budget_ms: f64,
    /// Where to write how well the ticks of 20 Hz were kept (JSON).
    #[arg(long, value_name = "TICKS.json")]
    ticks: Option<PathBuf>,
}

/// The autopilots that there are profiles for.
#[derive(Clone, Copy, ValueEnum)]
enum ProfileChoice {
    /// PX4, in OFFBOARD.
    Px4,
    /// ArduPilot Copter, in GUIDED.
    Ardupilot,
}

impl AutopilotArguments {
    /// Whether a plan whose solve did not converge may be streamed: not to a vehicle that is armed, unless that was asked for.
    pub fn accept_unconverged(&self) -> bool {
        self.unconverged || self.dry_run
    }
}

/// What became of it.
pub struct RealFlight {
    /// The flight; none of a dry run.
    pub outcome: Option<FlightOutcome>,
    /// How it ended.
    pub ended: Outcome,
}

/// Flies `plan` on the autopilot at `address`, or goes through everything but the flight. The flight is put down in the MCAP
/// file `recording` while it is flown.
pub fn fly_on_autopilot(
    plan: &Plan,
    flying: &Flying,
    address: &str,
    arguments: &AutopilotArguments,
    live: &LiveArguments,
    recording: &Path,
) -> Result<RealFlight, Failure> {
    let limits = read_limits(arguments)?;
    let session = live.start(plan)?;
    let clock = MonotonicClock::start();
    let station = open_station(address, arguments, clock)?;
    let flags = Flags::default();
    for signal in [
        signal_hook::consts::SIGINT,
        signal_hook::consts::SIGTERM,
        signal_hook::consts::SIGHUP,
    ] {
        signal_hook::flag::register(signal, Arc::clone(&flags.interrupted)).or_internal()?;
    }
    // A file that may not grow is a write that fails, not the end of the process.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).or_internal()?;
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
        if !ready {
            say_notes(&vehicle.take_notes());
            say("not ready to fly: nothing was armed");
            session
                .into_iter()
                .for_each(|session| session.finish("not ready to fly", false));
            return Ok(RealFlight {
                outcome: None,
                ended: Outcome::Untrusted,
            });
        }
        let flight = match arguments.dry_run {
            true => {
                let run = dry(&mut vehicle, trajectory, limits, &flags)?;
                session
                    .into_iter()
                    .for_each(|session| session.finish("dry run: nothing was armed", true));
                run
            }
            false => {
                let flight = Recorded {
                    plan,
                    trajectory,
                    limits,
                    budget: Duration::from_secs_f64(1e-3 * arguments.tick_budget_ms),
                    recording,
                    clock,
                };
                RealFlight {
                    outcome: Some(flight.fly(&mut vehicle, controller, session, &flags)?),
                    ended: Outcome::Done,
                }
            }
        };
        if let Some(report) = vehicle.tick_report() {
            say(&describe(&report));
            if let Some(path) = &arguments.ticks {
                let json = serde_json::to_vec_pretty(&report).or_internal()?;
                if let Err(error) = flyvine::file::write_whole(path, &json) {
                    say(&format!("warning: {}: {error}", path.display()));
                }
            }
        }
        Ok(flight)
    })?
}

/// A flight that is put down while it is flown, and shown if somebody wants to watch.
struct Recorded<'a> {
    plan: &'a Plan,
    trajectory: &'a Trajectory,
    limits: Limits,
    budget: Duration,
    recording: &'a Path,
    clock: MonotonicClock,
}

impl Recorded<'_> {
    fn fly(
        &self,
        vehicle: &mut AutopilotVehicle,
        controller: &mut (dyn Controller + Send),
        session: Option<LiveSession>,
        flags: &Flags,
    ) -> Result<FlightOutcome, Failure> {
        let session = RefCell::new(session);
        let log = self.start_log(vehicle, flags)?;
        let outcome = with_deadline(controller, self.budget, |controller| {
            fly_watched(
                self.trajectory,
                controller,
                self.limits,
                vehicle,
                0,
                &mut |_, _| match &*session.borrow() {
                    Some(session) if session.abort_requested() => ControlFlow::Break(()),
                    _ => interrupted(flags),
                },
                &mut |flown| {
                    log.borrow_mut().row(flown);
                    if let Some(session) = &mut *session.borrow_mut() {
                        session.publish(LiveRow::new(flown, None));
                    }
                },
            )
        })
        .or_input()?;
        vehicle.close().or_internal()?;
        let notes = vehicle.take_notes();
        say_notes(&notes);
        let mut log = log.borrow_mut();
        notes.iter().for_each(|note| log.note(note));
        // The flight has ended for it, if it failed before.
        if let Err(error) = log.finish() {
            say(&format!("warning: {error}"));
        }
        if let Some(session) = session.into_inner() {
            say_end(session, &outcome.end);
        }
        Ok(outcome)
    }

    /// Begins to put down what the wires say.
    fn start_log(
        &self,
        vehicle: &mut AutopilotVehicle,
        flags: &Flags,
    ) -> Result<Rc<RefCell<FlightLog>>, Failure> {
        let recorder = FlightRecorder::create(
            self.recording,
            self.clock.unix_ns(self.clock.now_s()),
            &PlannedPaths::from(self.plan),
            Arc::clone(&flags.recording_failed),
        )
        .or_input()?;
        let mut log = FlightLog::new(recorder, self.clock);
        let notes = vehicle.take_notes();
        say_notes(&notes);
        notes.iter().for_each(|note| log.note(note));
        let log = Rc::new(RefCell::new(log));
        let hears = Rc::clone(&log);
        vehicle.listen(Box::new(move |heard| hears.borrow_mut().hear(heard)));
        Ok(log)
    }
}

fn interrupted(flags: &Flags) -> ControlFlow<()> {
    match flags.interrupted.load(Ordering::Relaxed) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    }
}

fn dry(
    vehicle: &mut AutopilotVehicle,
    trajectory: &Trajectory,
    limits: Limits,
    flags: &Flags,
) -> Result<RealFlight, Failure> {
    say("dry run: streaming to the disarmed vehicle …");
    let run = match dry_run(vehicle, trajectory, limits, &mut |_, _| interrupted(flags)) {
        Ok(run) => run,
        Err(DryRunError::Supervisor(error)) => return Err(error).or_input(),
        Err(DryRunError::Vehicle(error)) => return Err(error).or_internal(),
    };
    vehicle.close().or_internal()?;
    say_notes(&vehicle.take_notes());
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

fn open_station(
    address: &str,
    arguments: &AutopilotArguments,
    clock: MonotonicClock,
) -> Result<Station, Failure> {
    let (Some(server), Some(bodies)) = (&arguments.mocap, &arguments.bodies) else {
        return bad_input(
            "--vehicle mavlink:… needs --mocap and --bodies: nothing flies without knowing where it is"
                .to_owned(),
        );
    };
    let server: Address = server
        .parse()
        .with_context(|| format!("--mocap {server}"))
        .or_input()?;
    let bodies = Bodies::read(bodies).or_input()?;
    let source = MocapSource::start(&server, Some(bodies), HygieneLimits::default(), None).or_input()?;
    let arm: Box<dyn ArmLink> = match &arguments.arm {
        None => Box::new(NoArm),
        Some(line) => {
            let arm = connect(line, clock.now_s())
                .with_context(|| format!("--arm {line}"))
                .or_input()?;
            Box::new(WiredArm::new(arm))
        }
    };
    Ok(Station {
        clock: Box::new(clock),
        wire: open(address).context("--vehicle mavlink").or_input()?,
        poses: Box::new(MocapPoses::new(source, clock)),
        arm,
    })
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

fn say_notes(notes: &[String]) {
    notes.iter().for_each(|note| say(note));
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
