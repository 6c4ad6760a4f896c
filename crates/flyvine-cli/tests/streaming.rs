//! `flyvine fit --stream`, `--shard` and `--merge`: the same bank, whoever reads which flights.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use flyvine::flight::{Configuration, Flight, Pose, Sample, write_flight};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;

fn flyvine() -> Command {
    Command::cargo_bin("flyvine").unwrap()
}

/// A quadrotor that follows waves of commands late, with a tip that swings below it.
fn flight(number: usize, rows: usize) -> Flight {
    let mut quadrotor = [0.0, 0.0, 1.5];
    let mut tip = [0.0, 0.0, 0.8];
    let samples = (0..rows).map(|row| {
        let t_s = 0.05 * row as f64;
        // Waves whose frequencies differ from axis to axis and from flight to flight, and small ones that excite the rest.
        let wave = |axis: usize| {
            let rate = 0.7 + 0.37 * axis as f64 + 0.21 * number as f64;
            let ripple = |k: f64| (k * rate * t_s + k).sin() / k;
            ripple(1.0) + 0.3 * ripple(3.7) + 0.2 * ripple(8.3)
        };
        let command = [wave(0), wave(1), 1.5 + 0.1 * wave(2)];
        let mut attitude = [0.0; 3];
        for axis in 0..3 {
            let late = command[axis] - quadrotor[axis];
            attitude[axis] = 0.05 * late * (1.0 + 0.1 * late);
            quadrotor[axis] += 0.15 * late;
            let rest = quadrotor[axis] - if axis == 2 { 0.7 } else { 0.0 };
            tip[axis] += 0.2 * (rest - tip[axis]);
        }
        let ripple = |k: usize| 1e-3 * ((row * row * (k + 3) + 7 * row + number) as f64).sin();
        let [x, y, z] = attitude;
        let w = (1.0 - x * x - y * y - z * z).sqrt();
        Sample {
            t_s,
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.0,
            },
            command,
            command_velocity: None,
            quadrotor: Some(Pose {
                position: std::array::from_fn(|axis| quadrotor[axis] + ripple(axis)),
                attitude: [w, x, y, z],
            }),
            end_effector: Some(std::array::from_fn(|axis| tip[axis] + ripple(axis + 3))),
        }
    });
    Flight {
        name: format!("flight_{number}"),
        samples: samples.collect(),
    }
}

fn flights(folder: &Path) -> Vec<PathBuf> {
    (0..5)
        .map(|number| {
            let path = folder.join(format!("flight_{number}.csv"));
            write_flight(&path, &flight(number, 300)).unwrap();
            path
        })
        .collect()
}

#[test]
fn shards_merge_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let flights = flights(folder.path());
    let file = |name: &str| folder.path().join(name);
    let fit = |arguments: &[&str], out: &Path| {
        let mut command = flyvine();
        command.arg("fit").args(arguments).arg("--out").arg(out);
        command
    };
    fit(&["--stream"], &file("whole.json"))
        .args(&flights)
        .env("RAYON_NUM_THREADS", "1")
        .assert()
        .success()
        .stdout(contains("1485")); // 5 flights of 300 rows, less three for lags and successor
    for shard in ["1/3", "2/3", "3/3"] {
        let out = file(&format!("part_{}.json", &shard[..1]));
        fit(&["--shard", shard], &out).args(&flights).assert().success();
    }
    let parts = ["part_3.json", "part_1.json", "part_2.json"].map(file);
    let merge = |parts: &[PathBuf]| {
        let mut command = flyvine();
        command
            .args(["fit", "--merge"])
            .args(parts)
            .arg("--out")
            .arg(file("merged.json"));
        command
    };
    merge(&parts).assert().success();
    let bytes = |name: &str| std::fs::read(file(name)).unwrap();
    assert!(bytes("whole.json") == bytes("merged.json"));

    merge(&parts[..2]).assert().code(2).stderr(contains(
        "found one that begins with flight 4, expected flight 2 of 5",
    ));
    let cut = bytes("part_2.json");
    std::fs::write(file("part_2.json"), &cut[..cut.len() - 7]).unwrap();
    merge(&parts)
        .assert()
        .code(2)
        .stderr(contains("part_2.json").and(contains("expected a partial fit, whole")));
}

#[test]
fn a_cell_that_is_no_number_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let flights = flights(folder.path());
    let text = std::fs::read_to_string(&flights[1]).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<&str> = lines[4].split(',').collect();
    cells[3] = "NaN";
    lines[4] = cells.join(",");
    std::fs::write(&flights[1], lines.join("\n") + "\n").unwrap();
    flyvine()
        .args(["fit", "--stream"])
        .args(&flights)
        .arg("--out")
        .arg(folder.path().join("bank.json"))
        .assert()
        .code(2)
        .stderr(
            contains("flight_1.csv")
                .and(contains("line 5"))
                .and(contains("cmd_x")),
        );
}

#[test]
fn what_does_not_stream_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let flights = flights(folder.path());
    for (arguments, message) in [
        (
            &["--stream", "--family", "physical"][..],
            "only least squares streams",
        ),
        (&["--shard", "3/2"], "expected i/n with 1 ≤ i ≤ n"),
        (&["--shard", "6/6"], "6/6 of 5 flights"),
        (&["--orthogonal"], "--orthogonal goes with --stream or --shard"),
        (&["--stream", "--refinement", "on"], "refinement"),
    ] {
        flyvine()
            .arg("fit")
            .args(&flights)
            .args(arguments)
            .arg("--out")
            .arg(folder.path().join("bank.json"))
            .assert()
            .code(2)
            .stderr(contains(message));
    }
}
