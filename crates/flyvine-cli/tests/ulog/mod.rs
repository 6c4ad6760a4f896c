//! `flyvine convert` of PX4's logs: a real one, and one whose content is known (tests/data/make_ulogs.py).

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use flyvine::flight::{Flight, read_flight};

const ARM: &str = "length_m = 0.7\npressure_kpa = 0.0\n";

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name)
}

/// Converts `log` with `options`; the flight, if there is one.
fn convert(folder: &Path, log: &Path, options: &str) -> (Output, Option<Flight>) {
    let (toml, flight) = (folder.join("log.toml"), folder.join("flight.csv"));
    std::fs::write(&toml, options).unwrap();
    let _ = std::fs::remove_file(&flight);
    let output = Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
        .arg("convert")
        .arg("--ulog")
        .args([&toml, log, &flight])
        .output()
        .unwrap();
    let flight = flight.exists().then(|| read_flight(&flight).unwrap());
    (output, flight)
}

fn converted(folder: &Path, log: &Path, options: &str) -> Flight {
    let (output, flight) = convert(folder, log, options);
    assert!(output.status.success(), "{output:?}");
    flight.unwrap()
}

fn refused(folder: &Path, log: &Path, options: &str, why: &str) {
    let (output, _) = convert(folder, log, options);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(why), "{said}");
}

fn assert_near(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    let near = found
        .iter()
        .zip(expected)
        .all(|(a, b)| (a - b).abs() <= tolerance);
    assert!(near, "{what}: found {found:?}, expected {expected:?}");
}

/// What pyulog and numpy make of a real flight.
#[test]
fn a_real_log_is_read_as_pyulog_reads_it() {
    let folder = tempfile::tempdir().unwrap();
    let log = data("px4_flight.ulg");
    let sparse = format!("{ARM}mode = \"any\"\nmax_gap_s = 0.25\nmax_command_gap_s = 0.25\n");
    let flight = converted(folder.path(), &log, &sparse);
    let text = std::fs::read_to_string(data("px4_flight.csv")).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(flight.samples.len(), rows.len());
    for (k, (sample, row)) in flight.samples.iter().zip(&rows).enumerate() {
        let pose = sample.quadrotor.unwrap();
        let [w, x, y, z] = pose.attitude;
        let forward = [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
        ];
        assert_near(&[sample.t_s], &row[..1], 1e-9, "time");
        assert_near(&sample.command, &row[1..4], 1e-5, &format!("command of row {k}"));
        assert_near(&pose.position, &row[4..7], 1e-5, &format!("position of row {k}"));
        // Interpolated along the arc, not its chord.
        assert_near(&forward, &row[7..], 2e-3, &format!("attitude of row {k}"));
        assert!(sample.end_effector.is_none(), "PX4 knows nothing of it");
    }

    refused(folder.path(), &log, ARM, "was logged in OFFBOARD");
    let full_rate = format!("{ARM}mode = \"any\"\n");
    refused(folder.path(), &log, &full_rate, "trajectory_setpoint 0");
    let vision = format!("{sparse}quadrotor = \"vision\"\n");
    refused(
        folder.path(),
        &log,
        &vision,
        "no messages of topic vehicle_visual_odometry",
    );
}

/// North is y, a heading of 90 degrees is along x; times are those of the samples; what the estimator disowns is missing.
#[test]
fn frames_times_and_modes_are_those_of_px4() {
    let folder = tempfile::tempdir().unwrap();
    let log = data("px4_offboard.ulg");
    for (quadrotor, ahead_m) in [("estimate", 0.0), ("vision", 0.01)] {
        let flight = converted(
            folder.path(),
            &log,
            &format!("{ARM}quadrotor = \"{quadrotor}\"\n"),
        );
        // OFFBOARD from 2 s on, set-points with a position up to 5.95 s.
        assert_eq!(flight.samples.len(), 80);
        for sample in &flight.samples {
            let t_s = 2.0 + sample.t_s;
            assert_near(&sample.command, &[0.5, t_s.cos(), 1.5], 1e-6, "command");
            let Some(pose) = sample.quadrotor else {
                assert!(
                    quadrotor == "estimate" && (2.94..3.13).contains(&t_s),
                    "{sample:?}"
                );
                continue;
            };
            assert!(quadrotor == "vision" || !(3.0..3.09).contains(&t_s), "{sample:?}");
            assert_near(&pose.position, &[0.5, t_s.sin() + ahead_m, 1.5], 2e-4, "position");
            assert_near(&pose.attitude, &[1.0, 0.0, 0.0, 0.0], 1e-6, "attitude");
        }
    }
    let smoothed = format!("{ARM}command = \"vehicle_local_position_setpoint\"\n");
    let flight = converted(folder.path(), &log, &smoothed);
    assert_near(
        &flight.samples[0].command,
        &[0.5, (2.0_f64 - 0.005).sin(), 1.5],
        1e-6,
        "command",
    );
    assert_eq!(
        flight.samples.len(),
        101,
        "it goes on without a base station's positions"
    );
}

/// The quadrotor's track in both files tells how their clocks differ.
#[test]
fn the_tip_comes_from_another_recording() {
    let folder = tempfile::tempdir().unwrap();
    let log = data("px4_offboard.ulg");
    let offset_s = -1234.5678;
    let table = |columns: &str, speed: f64| {
        let mut text = columns.to_owned() + "\n";
        for k in 0..700 {
            let t_s = 0.01 * k as f64;
            let (y, clock_s) = ((speed * t_s).sin(), t_s - offset_s);
            text += &match columns.contains("qr_x") {
                true => format!("{clock_s},0.4,{y},0.8,0.5,{y},1.5\n"),
                false if k % 50 == 0 => format!("{clock_s},,,\n"),
                false => format!("{clock_s},0.4,{y},0.8\n"),
            };
        }
        std::fs::write(folder.path().join("tip.csv"), text).unwrap();
    };
    let tip = format!("{ARM}[end_effector]\nfile = \"tip.csv\"\n");
    let known = format!("{tip}clock_offset_s = {offset_s}\n");

    table("t_s,ee_x,ee_y,ee_z,qr_x,qr_y,qr_z", 1.0);
    let (output, flight) = convert(folder.path(), &log, &tip);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("agree to 0.0 cm"), "{said}");
    for sample in flight.unwrap().samples {
        let expected = [0.4, (2.0 + sample.t_s).sin(), 0.8];
        assert_near(&sample.end_effector.unwrap(), &expected, 1e-3, "tip");
    }
    table("t_s,ee_x,ee_y,ee_z,qr_x,qr_y,qr_z", 2.0);
    refused(folder.path(), &log, &tip, "are both of one flight");
    table("t_s,ee_x,ee_y,ee_z", 1.0);
    refused(folder.path(), &log, &tip, "no clock_offset_s");
    let flight = converted(folder.path(), &log, &known);
    assert_near(
        &flight.samples[0].end_effector.unwrap(),
        &[0.4, 2.0_f64.sin(), 0.8],
        1e-4,
        "tip",
    );
}

#[test]
fn what_is_whole_of_a_log_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.ulg");
    let whole = std::fs::read(data("px4_offboard.ulg")).unwrap();
    std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let (output, flight) = convert(folder.path(), &cut, ARM);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    assert!((20..60).contains(&flight.unwrap().samples.len()));
    std::fs::write(&cut, "not a log").unwrap();
    refused(folder.path(), &cut, ARM, "cut.ulg");

    let without = Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
        .arg("convert")
        .args([data("px4_offboard.ulg"), folder.path().join("flight.csv")])
        .output()
        .unwrap();
    assert_eq!(without.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&without.stderr).contains("--ulog"),
        "{without:?}"
    );
}
