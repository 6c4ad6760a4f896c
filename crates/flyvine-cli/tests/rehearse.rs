//! Flights over the real wires by the built binary: Ctrl-C lands, a killed base station leaves a readable flight, a dry run
//! arms nothing, the deployment's arm follows.

mod common;

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use common::{bodies_file, demo_run};
use flyvine::flight::read_flight;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

fn binary() -> Command {
    Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
}

fn plan(experiment: &str) -> PathBuf {
    demo_run().join("experiments").join(experiment).join("plan.json")
}

/// A process that does not outlive its test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a rehearsal that goes on by itself.
fn rehearse(plan: &Path, folder: &Path, more: &[&str]) -> Process {
    let mut command = binary();
    command
        .arg("rehearse")
        .arg(plan)
        .arg("--out")
        .arg(folder)
        .arg("--json")
        .args(more);
    Process(
        command
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    )
}

/// The exit code, within two minutes.
fn end(process: &mut Process) -> Option<i32> {
    let begun = Instant::now();
    loop {
        if let Some(status) = process.0.try_wait().unwrap() {
            return status.code();
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "it does not end");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Waits until the vehicle's end says that a phase has begun.
fn wait_for_phase(folder: &Path, phase: &str) {
    let begun = Instant::now();
    while !phases(folder).iter().any(|found| found == phase) {
        assert!(
            begun.elapsed() < Duration::from_secs(90),
            "no phase {phase}: {:?}",
            phases(folder)
        );
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn phases(folder: &Path) -> Vec<String> {
    let events = std::fs::read_to_string(folder.join("vehicle.jsonl")).unwrap_or_default();
    let event = |line| {
        serde_json::from_str::<Value>(line).ok()?["phase"]
            .as_str()
            .map(str::to_owned)
    };
    events.lines().filter_map(event).collect()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// How many messages each topic of a recording has.
fn topics(recording: &Path) -> std::collections::BTreeMap<String, usize> {
    let bytes = std::fs::read(recording).unwrap();
    let mut counts = std::collections::BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_insert(0) += 1;
    }
    counts
}

fn run(command: &mut Command) -> Output {
    command.output().unwrap()
}

/// A flight that ended early has a score, and exit code 3.
fn assert_scored_as_cut_short(flight: &Path, folder: &Path) {
    let score = run(binary()
        .arg("score")
        .arg(flight)
        .arg("--plan")
        .arg(folder.join("plan.json")));
    assert_eq!(score.status.code(), Some(3), "it ended early: {score:?}");
    assert!(
        String::from_utf8_lossy(&score.stdout).contains("reference"),
        "{score:?}"
    );
}

fn assert_landed(folder: &Path) {
    let phases = phases(folder);
    assert!(phases.iter().any(|phase| phase == "land"), "{phases:?}");
}

#[test]
fn ctrl_c_is_an_abort_that_lands() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("run");
    let mut rehearsal = rehearse(&plan("lemniscate_10s_ES"), &folder, &[]);
    wait_for_phase(&folder, "flight");
    std::thread::sleep(Duration::from_millis(300));
    kill_process(Pid::from_child(&rehearsal.0), Signal::INT).unwrap();
    assert_eq!(end(&mut rehearsal), Some(3));
    assert_eq!(json(&folder.join("rehearsal.json"))["base_exit_code"], 3);
    assert_landed(&folder);

    // The recording is a whole flight like any other, with everything that was heard beside it.
    let recording = folder.join("flight.mcap");
    let flight = read_flight(&recording).unwrap();
    assert!(flight.samples.len() > 20);
    assert_eq!(flight.samples[0].t_s, 0.0);
    assert_scored_as_cut_short(&recording, &folder);
    let topics = topics(&recording);
    for topic in [
        "/plan/command",
        "/plan/reference",
        "/log",
        "/supervisor",
        "/setpoint",
        "/arm",
    ] {
        assert!(topics.contains_key(topic), "{topic}: {topics:?}");
    }
    // Motion capture comes at 100 Hz, before and after the flight too.
    assert!(
        topics["/mocap/quadrotor"] > 5 * topics["/quadrotor"],
        "{topics:?}"
    );
    assert!(topics["/supervisor"] > topics["/command"], "{topics:?}");
    let said = String::from_utf8_lossy(&std::fs::read(&recording).unwrap()).into_owned();
    assert!(said.contains("stopped by the operator"));
}

#[test]
fn a_killed_base_station_leaves_a_flight_that_is_read_back() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, script) = (scratch.path().join("run"), scratch.path().join("kill.toml"));
    let fault = "[[fault]]\nkind = \"base-killed\"\nphase = \"flight\"\nafter_s = 2.0\n";
    std::fs::write(&script, fault).unwrap();
    let script = script.to_str().unwrap();
    let natnet = ["--fault", script, "--mocap-protocol", "natnet"];
    let mut rehearsal = rehearse(&plan("lemniscate_10s_ES"), &folder, &natnet);
    assert_eq!(end(&mut rehearsal), Some(3));
    assert_eq!(
        json(&folder.join("rehearsal.json"))["base_exit_code"],
        Value::Null,
        "it was killed"
    );

    let (cut, whole) = (folder.join("flight.mcap"), folder.join("whole.csv"));
    assert!(read_flight(&cut).unwrap_err().to_string().contains("cut off"));
    let convert = run(binary().arg("convert").args([&cut, &whole]));
    assert_eq!(convert.status.code(), Some(3), "something was lost: {convert:?}");
    // 2 s at 20 Hz, but for the last chunk of 250 ms and the time in which a kill takes effect.
    let rows = read_flight(&whole).unwrap().samples.len();
    assert!((30..=60).contains(&rows), "{rows} rows");
    assert_scored_as_cut_short(&whole, &folder);
}

#[test]
fn a_full_disk_ends_the_flight_on_the_ground() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, script) = (scratch.path().join("run"), scratch.path().join("full.toml"));
    std::fs::write(
        &script,
        "[[fault]]\nkind = \"disk-full\"\nphase = \"flight\"\nafter_s = 1.0\n",
    )
    .unwrap();
    let plan = plan("lemniscate_10s_ES");
    let mut rehearsal = rehearse(&plan, &folder, &["--fault", script.to_str().unwrap()]);
    assert_eq!(end(&mut rehearsal), Some(3));
    let said = std::io::read_to_string(rehearsal.0.stderr.take().unwrap()).unwrap();
    assert!(said.contains("abort: the recording cannot be written"), "{said}");
    assert_landed(&folder);

    // What cannot happen here is refused.
    std::fs::write(&script, "[[fault]]\nkind = \"solver-late\"\nphase = \"flight\"\n").unwrap();
    let mut refused = rehearse(
        &plan,
        &scratch.path().join("none"),
        &["--fault", script.to_str().unwrap()],
    );
    assert_eq!(end(&mut refused), Some(2));
}

#[test]
fn a_dry_run_arms_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    let autopilot = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut vehicle = binary();
    vehicle.args(["rehearse-vehicle", "--autopilot", &autopilot.to_string()]);
    let mut vehicle = Process(vehicle.stdout(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(vehicle.0.stdout.take().unwrap()).lines();
    let served: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
    let bodies = bodies_file(scratch.path());
    let recording = scratch.path().join("flight.mcap");
    let mut base = binary();
    base.arg("fly")
        .arg(plan("swing_ES"))
        .args(["--vehicle", &format!("mavlink:udpin:{autopilot}")]);
    base.args([
        "--mocap",
        served["mocap"].as_str().unwrap(),
        "--arm",
        served["arm"].as_str().unwrap(),
    ]);
    base.arg("--bodies")
        .arg(bodies)
        .arg("--dry-run")
        .arg("--out")
        .arg(&recording);
    let output = run(&mut base);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        said.contains("dry run: 49 set-points sent, nothing armed"),
        "{said}"
    );
    assert!(!recording.exists(), "nothing was flown");
    kill_process(Pid::from_child(&vehicle.0), Signal::TERM).unwrap();
    let events: Vec<String> = lines.map_while(Result::ok).collect();
    assert!(events.iter().any(|event| event.contains("pre-arm")), "{events:?}");
    assert!(
        !events.iter().any(|event| event.contains("take-off")),
        "{events:?}"
    );
}

#[test]
fn a_plan_that_did_not_converge_is_not_flown_on_a_vehicle_unasked() {
    let scratch = tempfile::tempdir().unwrap();
    let mut plan: Value = serde_json::from_slice(&std::fs::read(plan("swing_ES")).unwrap()).unwrap();
    plan["solve"]["converged"] = false.into();
    plan["solve"]["violated"] = vec!["qr_z in [-inf, 1.53] at knot 26: off by 8.6e-2"].into();
    let path = scratch.path().join("plan.json");
    std::fs::write(&path, plan.to_string()).unwrap();
    let fly = |more: &[&str]| {
        let recording = scratch.path().join("flight.mcap");
        let mut fly = binary();
        fly.arg("fly")
            .arg(&path)
            .args(["--vehicle", "mavlink:udpin:127.0.0.1:0"]);
        let output = run(fly.args(more).arg("--out").arg(recording));
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let refused = fly(&[]);
    for part in ["did not converge", "off by 8.6e-2", "--unconverged"] {
        assert!(refused.contains(part), "{refused}");
    }
    // Asked for, it is the next thing that is amiss.
    for asked in ["--unconverged", "--dry-run"] {
        let said = fly(&[asked]);
        assert!(
            said.contains("warning: the plan did not converge") && said.contains("--mocap"),
            "{said}"
        );
    }
}

#[test]
fn without_motion_capture_nothing_is_opened() {
    let output = run(binary().arg("fly").arg(plan("swing_ES")).args([
        "--vehicle",
        "mavlink:udpin:127.0.0.1:0",
        "--out",
        "flight.mcap",
    ]));
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("--mocap"),
        "{output:?}"
    );
}
