//! Recordings of flights: whole ones, and those of processes that were killed.

#![expect(clippy::print_stderr, reason = "tests say that they skip")]

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use flyvine::flight::{Configuration, Flight, Pose, Problem, Sample, read_flight, recover_flight};
use flyvine_link::autopilot::ArmTelemetry;
use flyvine_link::recording::{Body, FlightRecorder, LogLevel, PlannedPaths, RecordingError, SupervisorRow};

/// Row k of a flight that everybody in this file knows.
fn sample(k: usize) -> Sample {
    let t_s = k as f64 / 20.0;
    Sample {
        t_s,
        configuration: Configuration {
            length_m: 0.7,
            pressure_kpa: 0.1,
        },
        command: [t_s.sin(), 0.0, 1.5],
        command_velocity: None,
        quadrotor: (k % 7 != 3).then_some(Pose {
            position: [t_s.sin(), 0.1, 1.5],
            attitude: [1.0, 0.0, 0.0, 0.0],
        }),
        end_effector: Some([t_s.sin() - 0.1, 1.0 / 3.0, 0.8]),
    }
}

/// When row k is flown, ns since 1970.
fn time_ns(k: usize) -> u64 {
    1_700_000_000_000_000_000 + 50_000_000 * k as u64
}

fn create(path: &Path, planned: &PlannedPaths) -> Result<FlightRecorder, RecordingError> {
    FlightRecorder::create(path, time_ns(0), planned, Arc::default())
}

fn record(recorder: &FlightRecorder, k: usize) {
    let supervisor = SupervisorRow {
        setpoint: sample(k).command,
        state: "flying".into(),
        autopilot_mode: "Offboard".into(),
        armed: true,
        quadrotor_age_s: Some(0.012),
        ..SupervisorRow::default()
    };
    recorder.supervisor(time_ns(k), supervisor);
    recorder.row(time_ns(k), &sample(k), None);
    if let Some(pose) = sample(k).quadrotor {
        recorder.pose(time_ns(k), Body::Quadrotor, pose);
    }
    let telemetry = ArmTelemetry {
        heard_s: 0.0,
        length_m: Some(0.7),
        pressure_kpa: None,
        growth_m_s: 0.0,
        state: Some(vine_arm::State::Active),
    };
    recorder.arm(time_ns(k), telemetry);
    if k.is_multiple_of(50) {
        recorder.log(time_ns(k), LogLevel::Info, format!("row {k}"));
    }
}

/// Nothing went wrong.
fn finish(mut recorder: FlightRecorder) {
    recorder.finish().unwrap();
}

fn planned() -> PlannedPaths {
    let path: Vec<[f64; 3]> = (0..100).map(|k| sample(k).command).collect();
    PlannedPaths {
        command: path.clone(),
        end_effector: path.clone(),
        reference: path,
    }
}

fn check_rows(flight: &Flight) {
    for (k, row) in flight.samples.iter().enumerate() {
        assert_eq!(*row, sample(k));
    }
}

#[test]
fn a_finished_recording_is_a_flight() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let recorder = create(&path, &planned()).unwrap();
    for k in 0..400 {
        record(&recorder, k);
    }
    finish(recorder);
    let flight = read_flight(&path).unwrap();
    assert_eq!(flight.samples.len(), 400);
    check_rows(&flight);

    let bytes = std::fs::read(&path).unwrap();
    let mut counts = std::collections::BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_insert(0) += 1;
    }
    let expected = [
        ("/arm", 400),
        ("/command", 400),
        ("/configuration", 400),
        ("/end_effector", 400),
        ("/log", 8),
        ("/mocap/quadrotor", 343),
        ("/plan/command", 1),
        ("/plan/end_effector", 1),
        ("/plan/reference", 1),
        ("/quadrotor", 343),
        ("/setpoint", 400),
        ("/supervisor", 400),
    ];
    let expected = expected.map(|(topic, count)| (topic.to_owned(), count));
    assert_eq!(counts, std::collections::BTreeMap::from(expected));
    check_peers(&path, 400);
}

#[test]
fn a_recording_cut_anywhere_is_recovered_to_its_last_whole_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let recorder = create(&path, &planned()).unwrap();
    for k in 0..60 {
        record(&recorder, k);
        // Several chunks.
        std::thread::sleep(Duration::from_millis(20));
    }
    finish(recorder);
    let bytes = std::fs::read(&path).unwrap();
    let (cut, mut most) = (folder.path().join("cut.mcap"), 0);
    for end in (0..bytes.len()).step_by(211) {
        std::fs::write(&cut, &bytes[..end]).unwrap();
        if let Ok(flight) = recover_flight(&cut) {
            check_rows(&flight);
            assert!(flight.samples.len() >= most, "less of more bytes");
            most = flight.samples.len();
        }
    }
    assert!(most >= 59, "{most}");
}

/// Not a test by itself: the process that is killed in the next one.
#[test]
#[ignore = "run by a_killed_process_leaves_a_readable_recording"]
fn record_until_killed() {
    let Ok(path) = std::env::var("FLYVINE_TEST_RECORDING") else {
        return;
    };
    let recorder = create(Path::new(&path), &planned()).unwrap();
    // Bounded, should nobody kill it.
    for k in 0..100_000 {
        record(&recorder, k);
        std::thread::sleep(Duration::from_micros(500));
    }
}

#[test]
fn a_killed_process_leaves_a_readable_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("killed.mcap");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "record_until_killed"])
        .env("FLYVINE_TEST_RECORDING", &path)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let before = loop {
        assert!(began.elapsed() < Duration::from_secs(30), "nothing is recorded");
        std::thread::sleep(Duration::from_millis(50));
        match recover_flight(&path) {
            Ok(flight) if flight.samples.len() > 500 => break flight.samples.len(),
            _ => (),
        }
    };
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    let flight = recover_flight(&path).unwrap();
    check_rows(&flight);
    assert!(flight.samples.len() >= before);
    check_peers(&path, before);
}

#[test]
fn nonsense_in_a_row_does_not_spoil_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let recorder = create(&path, &PlannedPaths::default()).unwrap();
    let nowhere = Pose {
        position: [0.0, f64::NAN, 1.5],
        attitude: [1.0, 0.0, 0.0, 0.0],
    };
    for k in 0..20 {
        let mut row = sample(k);
        match k {
            4 => row.quadrotor = Some(nowhere),
            5 => row.end_effector = Some([0.0, 0.0, 1e6]),
            19 => row.command[1] = f64::INFINITY,
            _ => (),
        }
        recorder.row(time_ns(k), &row, None);
    }
    finish(recorder);
    let flight = read_flight(&path).unwrap();
    assert_eq!(flight.samples.len(), 19);
    assert_eq!(flight.samples[4].quadrotor, None);
    assert_eq!(flight.samples[4].end_effector, sample(4).end_effector);
    assert_eq!(flight.samples[5].end_effector, None);
}

#[test]
fn a_recording_without_a_flight_has_no_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let recorder = create(&path, &planned()).unwrap();
    recorder.log(time_ns(0), LogLevel::Error, "aborted on the way up");
    recorder.supervisor(time_ns(1), SupervisorRow::default());
    finish(recorder);
    let error = read_flight(&path).unwrap_err();
    assert!(matches!(*error.problem, Problem::NoRows), "{error}");
}

#[test]
fn a_disk_that_goes_away_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
    rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
    // A pipe that is read until the recording has begun: as much of a disk as can be pulled out in a test.
    let reader = path.clone();
    let (pull, pulled) = std::sync::mpsc::channel::<()>();
    let reader = std::thread::spawn(move || {
        let mut disk = File::open(reader).unwrap();
        disk.read_exact(&mut [0; 16]).unwrap();
        pulled.recv().unwrap();
    });
    let failed = Arc::new(AtomicBool::new(false));
    let mut recorder =
        FlightRecorder::create(&path, 0, &PlannedPaths::default(), Arc::clone(&failed)).unwrap();
    pull.send(()).unwrap();
    reader.join().unwrap();
    let began = Instant::now();
    while !failed.load(Ordering::Relaxed) {
        assert!(began.elapsed() < Duration::from_secs(30), "nobody was told");
        record(&recorder, 0);
        std::thread::sleep(Duration::from_millis(20));
    }
    recorder.finish().unwrap_err();
}

#[test]
fn what_cannot_be_written_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no folder").join("flight.mcap");
    let error = create(&path, &planned()).unwrap_err().to_string();
    assert!(error.contains("no folder"), "{error}");
}

/// The reference reader finds at least `rows` commands too, even if the file has no end.
fn check_peers(path: &Path, rows: usize) {
    const SCRIPT: &str = r#"
import sys
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader
from mcap.records import Channel, Chunk, Message
topics, commands = {}, 0
try:
    for record in StreamReader(open(sys.argv[1], "rb"), record_size_limit=None).records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topics[record.channel_id] == "/command":
            commands += 1
except (McapError, EOFError) as error:
    print("ends with", repr(error), file=sys.stderr)
print(commands)
"#;
    let python = std::env::var("FLYVINE_PEERS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_package = Command::new(&python)
        .args(["-c", "import mcap"])
        .stderr(Stdio::null())
        .status();
    if !has_package.is_ok_and(|status| status.success()) {
        assert!(
            std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() != Ok("1"),
            "`{python}` has no package `mcap`, and FLYVINE_REQUIRE_PEERS=1 wants it"
        );
        eprintln!("skipped: `{python}` has no package `mcap` (pip install mcap)");
        return;
    }
    let output = Command::new(python)
        .args(["-c", SCRIPT])
        .arg(path)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let found: usize = String::from_utf8_lossy(&output.stdout).trim().parse().unwrap();
    assert!(found >= rows, "{found} of {rows}: {output:?}");
}
