//! `flyvine rehearse`: a plan in real time over sockets, with the simulated vehicle at their other end.

use std::net::{SocketAddr, UdpSocket};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use clap::Args;
use flyvine::control::End;
use flyvine::control::{Flying, fly_plan};
use flyvine::flight::{Flight, Problem};
use flyvine::report::Score;
use flyvine::run::score_flight;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, PlanOptions, Task, make_plan, read_plan, write_plan};
use flyvine_link::autopilot::TickReport;
use flyvine_link::rehearsal::{FaultKind, PhasedVehicle, rig_bodies, wired_limits};
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;
use serde_json::Value;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::console::{centimetres, print, print_json, say, table};
use crate::convert::{extension, read_or_recover};
use crate::fit::write_json;
use crate::flights::read_bank;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};
use crate::page::LiveArguments;
use crate::rehearse_process::Process;
use crate::rehearse_vehicle::{RigArguments, Served, read_script};

/// EE error over sockets may differ from that in lockstep by this share.
const ERROR_BAR: f64 = 0.1;
/// The 99.9th percentile of the set-points' jitter, ms.
const JITTER_BAR_MS: f64 = 5.0;
/// How long the vehicle's end may take to start.
const START_PATIENCE: Duration = Duration::from_secs(20);
/// Time that a flight may take beyond its plan: checklist, take-off, abort ladder, landing.
const AROUND_THE_PLAN: Duration = Duration::from_secs(120);

/// Rehearse a plan in real time: the simulated vehicle and the base station as separate processes that know each other only
/// by their wires. At the vehicle's end are physics, a PX4 with its refusals and failsafes (MAVLink over UDP), a
/// motion-capture server (VRPN or NatNet), and the arm (its own protocol on a serial line); the base station is
/// `flyvine fly`, as in a laboratory.
///
/// The flight is recorded in DIR/flight.mcap, scored and compared with the same plan flown in lockstep by a vehicle with the same
/// seed, whose set-points wait as long for its position loop. A script makes things go wrong (mocap stale, frozen, jumping,
/// swapped or NaN, link lost or reordering, autopilot rebooting, arm silent, processes killed, …):
///
///   [[fault]]
///   kind = "mocap-frozen"      # also: link-loss, autopilot-reboot, arm-silent, base-killed, vehicle-killed, …
///   phase = "flight"           # pre-arm, take-off, flight, land
///   after_s = 3.0              # duration_s = … ends it again
///
///   flyvine rehearse plan.json --out run-rehearsal
///   flyvine rehearse plan.json --mocap-protocol natnet --live --out run-natnet
///   flyvine rehearse examples/tasks/swing_ES.toml --bank bank.json --fault frozen.toml --out run-frozen
///
/// Ctrl-C aborts the flight: it lands. Beside other programs that compute, ticks are kept by real-time scheduling:
/// chrt --rr 10 flyvine rehearse …
///
/// Exit code 3 if the flight was aborted or misses a bar.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct RehearseArguments {
    /// A plan, or a task to be planned on --bank.
    #[arg(value_name = "TASK.toml|PLAN.json")]
    task: PathBuf,
    /// The models to plan a task on.
    #[arg(long, value_name = "BANK.json")]
    bank: Option<PathBuf>,
    /// What goes wrong, and when.
    #[arg(long, value_name = "SCRIPT.toml")]
    fault: Option<PathBuf>,
    /// Run folder to write; it must not exist or be empty.
    #[arg(long, value_name = "DIR", default_value = "run-rehearsal")]
    out: PathBuf,
    #[command(flatten)]
    rig: RigArguments,
    #[command(flatten)]
    live: LiveArguments,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What a rehearsal showed; `rehearsal.json` of the run folder.
#[derive(Serialize)]
struct Rehearsal {
    /// Score over the sockets; none if the base station left no flight, or one that missed ticks.
    over_sockets: Option<Score>,
    /// Score in lockstep.
    in_process: Score,
    /// Mean EE error to the reference, over sockets by in lockstep, minus 1.
    error_difference: Option<f64>,
    /// How the ticks were kept.
    ticks: Option<TickReport>,
    /// Exit code of the base station; none if it was killed.
    base_exit_code: Option<i32>,
}

/// Runs `flyvine rehearse`.
pub fn run(arguments: &RehearseArguments) -> CommandResult {
    let folder = arguments.out.as_path();
    if folder.exists() && std::fs::read_dir(folder).or_input()?.next().is_some() {
        return bad_input(format!(
            "--out {}: the folder is not empty; nothing is overwritten",
            folder.display()
        ));
    }
    if let Some(path) = &arguments.fault {
        arguments.rig.check(&read_script(path)?)?;
    }
    let plan = plan(arguments)?;
    std::fs::create_dir_all(folder).or_internal()?;
    write_plan(&folder.join("plan.json"), &plan).or_internal()?;
    if let Some(path) = &arguments.fault {
        std::fs::copy(path, folder.join("fault.toml")).or_internal()?;
    }

    let base_exit_code = fly_over_sockets(folder, &plan, arguments)?;
    let in_process = fly_in_process(folder, &plan, arguments.rig.seed, loop_phase_s(folder))?;
    let over_sockets = recorded_flight(&folder.join("flight.mcap"))?.and_then(|flight| {
        // Ticks that were missed leave rows that are nobody's knot.
        let score = score_flight(&plan, &flight);
        score.inspect_err(|error| say(&format!("no score: {error}"))).ok()
    });
    let rehearsal = Rehearsal {
        error_difference: over_sockets
            .as_ref()
            .map(|score| score.ee_vs_reference.mean_m / in_process.ee_vs_reference.mean_m - 1.0),
        ticks: read_ticks(&folder.join("ticks.json"))?,
        over_sockets,
        in_process,
        base_exit_code,
    };
    write_json(&folder.join("rehearsal.json"), &rehearsal)?;
    if arguments.json {
        print_json(&rehearsal)?;
    } else {
        print(&describe(&rehearsal))?;
    }
    say(&format!("wrote {}", folder.display()));
    Ok(judge(&rehearsal))
}

fn plan(arguments: &RehearseArguments) -> Result<Plan, Failure> {
    if extension(&arguments.task) == "json" {
        return read_plan(&arguments.task).or_input();
    }
    let Some(bank) = &arguments.bank else {
        return bad_input(format!(
            "{}: a task needs --bank BANK.json to be planned on; a plan ends in .json",
            arguments.task.display()
        ));
    };
    let task = Task::read(&arguments.task).or_input()?;
    say(&format!("planning {} …", task.name));
    make_plan(&task, &read_bank(bank, false)?, &PlanOptions::default()).or_input()
}

/// How long after a run of the vehicle's position loop its set-points came, s, by its own account; 0 without a flight.
fn loop_phase_s(folder: &Path) -> f64 {
    let events = std::fs::read_to_string(folder.join("vehicle.jsonl")).unwrap_or_default();
    let events = events
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let flight = events.into_iter().find(|event| event["phase"] == "flight");
    flight
        .and_then(|event| event["loop_phase_s"].as_f64())
        .unwrap_or(0.0)
}

/// Flies the plan in lockstep, with the phase of the flight over the sockets.
fn fly_in_process(folder: &Path, plan: &Plan, seed: u64, loop_phase_s: f64) -> Result<Score, Failure> {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).or_internal()?;
    let mut vehicle = PhasedVehicle::new(vehicle, loop_phase_s);
    let outcome = fly_plan(
        plan,
        &Flying::default(),
        flyvine::control::supervisor::Limits {
            autopilot_silence_s: None,
            arm_silence_s: None,
            ..wired_limits()
        },
        &mut vehicle,
        seed,
        &mut |_, _| ControlFlow::Continue(()),
    )
    .or_input()?;
    if let End::Aborted { t_s, cause } = &outcome.end {
        say(&format!(
            "warning: the flight in lockstep was aborted at {t_s:.2} s: {cause}"
        ));
    }
    flyvine::flight::write_flight(&folder.join("flight_in_process.csv"), &outcome.flight).or_internal()?;
    score_flight(plan, &outcome.flight).or_internal()
}

/// What the base station recorded, as far as it came; none if it did not come to flying.
fn recorded_flight(recording: &Path) -> Result<Option<Flight>, Failure> {
    if !recording.exists() {
        return Ok(None);
    }
    match read_or_recover(recording) {
        Ok((flight, _)) => Ok(Some(flight)),
        // Aborted on the way up.
        Err(error) if matches!(*error.problem, Problem::NoRows) => Ok(None),
        Err(error) => Err(error).or_internal(),
    }
}

/// Starts both processes, waits for the base station, and gives its exit code.
fn fly_over_sockets(
    folder: &Path,
    plan: &Plan,
    arguments: &RehearseArguments,
) -> Result<Option<i32>, Failure> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&interrupted)).or_internal()?;
    }
    let flyvine = std::env::current_exe().or_internal()?;
    let autopilot = free_port().context("no free port on loopback").or_internal()?;
    let configuration = plan.configurations[0];
    let mut vehicle = Command::new(&flyvine);
    vehicle
        .arg("rehearse-vehicle")
        .args(["--autopilot", &autopilot.to_string()])
        .args(["--length-m", &configuration.length_m.to_string()])
        .args(["--pressure-kpa", &configuration.pressure_kpa.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    arguments.rig.pass_on(&mut vehicle);
    if arguments.fault.is_some() {
        vehicle.arg("--fault").arg(folder.join("fault.toml"));
    }
    let mut vehicle = Process::spawn("the vehicle's end", &mut vehicle)?;
    let events = vehicle.lines();
    let Ok(served) = events.recv_timeout(START_PATIENCE) else {
        return Err(anyhow!("the vehicle's end did not start")).or_internal();
    };
    let served: Served = serde_json::from_str(&served).or_internal()?;

    let bodies = folder.join("bodies.toml");
    let [quadrotor, end_effector] = rig_bodies().names();
    let names = format!("[quadrotor]\nname = \"{quadrotor}\"\n\n[end_effector]\nname = \"{end_effector}\"\n");
    flyvine::file::write_whole(&bodies, names.as_bytes()).or_internal()?;
    let mut base = Command::new(&flyvine);
    base.arg("fly")
        .arg(folder.join("plan.json"))
        .arg("--vehicle")
        .arg(format!("mavlink:udpin:{autopilot}"))
        .args(["--mocap", &served.mocap])
        .arg("--bodies")
        .arg(bodies)
        .args(["--arm", &served.arm])
        .arg("--ticks")
        .arg(folder.join("ticks.json"))
        .arg("--out")
        .arg(folder.join("flight.mcap"))
        .stdin(Stdio::null())
        .stdout(std::fs::File::create(folder.join("checklist.txt")).or_internal()?);
    if !plan.solve.converged {
        base.arg("--unconverged"); // the vehicle is none; the base station warns
    }
    arguments.live.pass_on(&mut base);
    let mut base = Process::spawn("the base station", &mut base)?;
    let limit = AROUND_THE_PLAN + Duration::from_secs_f64(plan.knots() as f64 * flyvine::DT);
    let code = watch(folder, &mut base, &events, &interrupted, limit)?;
    if code.is_none() {
        // Whether the vehicle comes down by itself is part of what there is to see.
        std::thread::sleep(Duration::from_secs(5));
        record_events(folder, &events)?;
    }
    Ok(code)
}

/// Waits for the base station, kills it when the script says so, and passes on to it that the operator wants to stop.
fn watch(
    folder: &Path,
    base: &mut Process,
    events: &Receiver<String>,
    interrupted: &AtomicBool,
    limit: Duration,
) -> Result<Option<i32>, Failure> {
    let begun = Instant::now();
    let faults = [FaultKind::BaseKilled, FaultKind::BaseStalls, FaultKind::DiskFull].map(|kind| {
        let name = serde_json::to_string(&kind).expect("a name is a string");
        (kind, name)
    });
    loop {
        let told = record_events(folder, events)?;
        for (kind, _) in faults.iter().filter(|(_, name)| told.contains(&**name)) {
            base.suffer(*kind)?;
        }
        if let Some(status) = base.child.try_wait().or_internal()? {
            return Ok(status.code());
        }
        if interrupted.swap(false, Ordering::Relaxed) {
            say("stopping: the base station aborts the flight, which takes it a while to land");
            let _ = kill_process(Pid::from_child(&base.child), Signal::INT);
        }
        if begun.elapsed() > limit {
            say("the base station did not end in time: killed");
            base.kill();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Appends what the vehicle's end has said to vehicle.jsonl, and gives it.
fn record_events(folder: &Path, events: &Receiver<String>) -> Result<String, Failure> {
    use std::io::Write;
    let lines: String = events.try_iter().map(|line| line + "\n").collect();
    if !lines.is_empty() {
        let mut file = std::fs::File::options()
            .create(true)
            .append(true)
            .open(folder.join("vehicle.jsonl"))
            .or_internal()?;
        file.write_all(lines.as_bytes()).or_internal()?;
    }
    Ok(lines)
}

/// A UDP port of loopback that nobody has.
fn free_port() -> std::io::Result<SocketAddr> {
    UdpSocket::bind("127.0.0.1:0")?.local_addr()
}

fn read_ticks(path: &Path) -> Result<Option<TickReport>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    let contents = std::fs::read(path).or_internal()?;
    serde_json::from_slice(&contents).map(Some).or_internal()
}

fn judge(rehearsal: &Rehearsal) -> Outcome {
    let near = rehearsal
        .error_difference
        .is_some_and(|difference| difference.abs() <= ERROR_BAR);
    let kept = rehearsal
        .ticks
        .as_ref()
        .is_some_and(|ticks| ticks.missed == 0 && ticks.jitter_p999_ms <= JITTER_BAR_MS);
    match near && kept && rehearsal.base_exit_code == Some(0) {
        true => Outcome::Done,
        false => Outcome::Untrusted,
    }
}

fn describe(rehearsal: &Rehearsal) -> String {
    let row = |name: &str, score: &Score| {
        vec![
            name.to_owned(),
            centimetres(score.ee_vs_reference.mean_m),
            centimetres(score.ee_vs_prediction.mean_m),
            score.rows.to_string(),
        ]
    };
    let mut rows = vec![row("in lockstep", &rehearsal.in_process)];
    rows.extend(
        rehearsal
            .over_sockets
            .as_ref()
            .map(|score| row("over sockets", score)),
    );
    let mut text = table(
        &["mean EE error, cm", "to reference", "to prediction", "rows"],
        rows,
    );
    if let Some(difference) = rehearsal.error_difference {
        text += &format!("\nover sockets: {:+.1} % (bar: 10 %)", 100.0 * difference);
    }
    if let Some(ticks) = &rehearsal.ticks {
        text += &format!(
            "\nset-points every {:.2} ms, 99.9 % within {:.2} ms of it (bar: {JITTER_BAR_MS} ms), {} ticks missed (bar: 0)",
            ticks.period_ms, ticks.jitter_p999_ms, ticks.missed
        );
    }
    text
}
