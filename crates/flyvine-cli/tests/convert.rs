//! `flyvine convert` between CSV, MCAP and Parquet, and from others' recordings.

#![allow(clippy::print_stdout)] // a skip

mod ulog;

use std::path::{Path, PathBuf};
use std::process::Command;

use flyvine::flight::{Configuration, Flight, Pose, Sample, read_flight, write_flight};

fn convert(from: &Path, to: &Path) {
    let output = Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
        .arg("convert")
        .args([from, to])
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
}

/// A flight with poses that were missed, and numbers that no decimal has exactly.
fn flight(command_velocity: Option<[f64; 3]>) -> Flight {
    let sample = |k: usize| {
        let t_s = k as f64 / 20.0;
        Sample {
            t_s,
            configuration: Configuration {
                length_m: 0.7 + t_s / 300.0,
                pressure_kpa: 0.1,
            },
            command: [t_s.sin(), -0.0, 1.5],
            command_velocity,
            quadrotor: (k % 7 != 3).then_some(Pose {
                position: [t_s.sin(), 1.0 / 3.0, 1.5],
                attitude: [1.0, 0.0, 0.0, 0.0],
            }),
            end_effector: (k % 5 != 2).then_some([t_s.cos(), 1e-300, 0.8]),
        }
    };
    Flight {
        name: "flight".into(),
        samples: (0..60).map(sample).collect(),
    }
}

#[test]
fn parquet_gives_back_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    for velocity in [None, Some([0.1, 0.2, 0.3])] {
        let flight = flight(velocity);
        write_flight(&file("flight.mcap"), &flight).unwrap();
        convert(&file("flight.mcap"), &file("flight.parquet"));
        convert(&file("flight.parquet"), &file("again.csv"));
        assert_eq!(read_flight(&file("again.csv")).unwrap().samples, flight.samples);
    }
}

#[test]
fn a_table_that_is_no_flight_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nonsense.parquet");
    std::fs::write(&path, "PAR1 or not").unwrap();
    let output = Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
        .args([
            "convert".as_ref(),
            path.as_os_str(),
            folder.path().join("out.csv").as_os_str(),
        ])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("nonsense.parquet"),
        "{output:?}"
    );
}

/// A Python that has `packages`; `None`, said, where it may be absent.
fn python_with(packages: &[&str]) -> Option<String> {
    let python = std::env::var("FLYVINE_PEERS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let import = format!("import {}", packages.join(", "));
    let imported = Command::new(&python).args(["-c", &import]).output();
    if imported.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let (either, all) = (packages.join(" or "), packages.join(" "));
    let required = std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() == Ok("1");
    assert!(
        !required,
        "`{python}` has no {either}, and FLYVINE_REQUIRE_PEERS=1 wants all"
    );
    println!("skipped: `{python}` has no {either} (pip install {all})");
    None
}

fn run_script(python: &str, script: &str, arguments: &[PathBuf]) {
    let output = Command::new(python)
        .args(["-c", script])
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Polars reads ours; DuckDB writes it anew, with its own types and compression, and we read that.
#[test]
fn others_read_and_write_the_table() {
    const SCRIPT: &str = r#"
import sys
import duckdb, polars
ours, theirs = sys.argv[1:]
table = polars.read_parquet(ours)
assert table.height == 60 and table["qr_x"].null_count() == 9 and table["ee_z"].null_count() == 12, table
duckdb.sql(f"copy (select *, 'x' as remark from '{ours}' order by t_s) to '{theirs}' (format parquet)")
"#;
    let Some(python) = python_with(&["duckdb", "polars"]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let flight = flight(None);
    write_flight(&file("flight.csv"), &flight).unwrap();
    convert(&file("flight.csv"), &file("ours.parquet"));
    run_script(&python, SCRIPT, &[file("ours.parquet"), file("theirs.parquet")]);
    convert(&file("theirs.parquet"), &file("back.csv"));
    assert_eq!(read_flight(&file("back.csv")).unwrap().samples, flight.samples);
}

/// A bag that the package `rosbags` wrote, which nobody here did.
#[test]
fn a_ros_2_bag_is_a_flight() {
    const SCRIPT: &str = r#"
import sys
from math import cos, sin
import numpy as np
from pathlib import Path
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_HUMBLE)
msg = store.types
def pose(k, position, kind="Pose"):
    ns = 1_700_000_000_000_000_000 + k * 10_000_000
    header = msg["std_msgs/msg/Header"](stamp=msg["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9), frame_id="world")
    q = msg["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=sin(0.1), w=cos(0.1))
    if kind == "Pose":
        p = msg["geometry_msgs/msg/Pose"](position=msg["geometry_msgs/msg/Point"](*position), orientation=q)
        return ns, msg["geometry_msgs/msg/PoseStamped"](header=header, pose=p)
    t = msg["geometry_msgs/msg/Transform"](translation=msg["geometry_msgs/msg/Vector3"](*position), rotation=q)
    return ns, msg["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id="tip body", transform=t)
with Writer(Path(sys.argv[1]), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    kinds = {"/drone": "PoseStamped", "/tip": "TransformStamped", "/command": "PoseStamped"}
    topics = {name: bag.add_connection(name, f"geometry_msgs/msg/{kind}", typestore=store) for name, kind in kinds.items()}
    def write(name, k, position, kind="Pose"):
        ns, message = pose(k, position, kind)
        bag.write(topics[name], ns, store.serialize_cdr(message, f"geometry_msgs/msg/{kinds[name]}"))
    for k in range(200):
        write("/drone", k, [0.01 * k, 0.0, 1.5])
        if k >= 5:
            write("/tip", k, [0.01 * k, 0.5, 0.8], "Transform")
        if k % 5 == 0 and k >= 10:
            write("/command", k, [0.001 * k, 0.0, 1.5])
"#;
    let Some(python) = python_with(&["rosbags"]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    run_script(&python, SCRIPT, &[file("bag")]);
    let bag = std::fs::read_dir(file("bag"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let bag = bag
        .into_iter()
        .find(|path| path.extension().is_some_and(|end| end == "mcap"))
        .unwrap();
    let topics = "quadrotor = \"/drone\"\nend_effector = \"/tip\"\ncommand = \"/command\"\nlength_m = 0.7\npressure_kpa = 0.0\n";
    std::fs::write(file("topics.toml"), topics).unwrap();
    let convert = |to: &str| {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin("flyvine"));
        command
            .arg("convert")
            .arg("--topics")
            .args([file("topics.toml"), bag.clone(), file(to)]);
        command.output().unwrap()
    };
    let output = convert("flight.csv");
    assert!(output.status.success(), "{output:?}");
    let flight = read_flight(&file("flight.csv")).unwrap();
    // From the first command, 0.1 s after the first pose, to the end, 1.99 s after it.
    assert_eq!(flight.samples.len(), 38);
    for (k, sample) in flight.samples.iter().enumerate() {
        let row = (10 + 5 * k) as f64;
        assert!(
            (sample.command[0] - 0.001 * row).abs() < 1e-12,
            "row {k}: {sample:?}"
        );
        let quadrotor = sample.quadrotor.unwrap();
        assert!(
            (quadrotor.position[0] - 0.01 * row).abs() < 1e-9,
            "row {k}: {sample:?}"
        );
        assert!((quadrotor.attitude[3] - 0.1_f64.sin()).abs() < 1e-9);
        assert_eq!(sample.end_effector.unwrap()[1..], [0.5, 0.8]);
    }

    std::fs::write(file("topics.toml"), topics.replace("/tip", "/nobody")).unwrap();
    let output = convert("none.csv");
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("no messages of topic /nobody"),
        "{output:?}"
    );
}
