//! `flyvine convert` between CSV, MCAP and Parquet.

#![allow(clippy::print_stdout)] // a skip

use std::path::Path;
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
    let python = std::env::var("FLYVINE_PEERS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_packages = Command::new(&python)
        .args(["-c", "import duckdb, polars"])
        .output();
    if !has_packages.is_ok_and(|output| output.status.success()) {
        let required = std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() == Ok("1");
        assert!(
            !required,
            "`{python}` has no duckdb or polars, and FLYVINE_REQUIRE_PEERS=1 wants them"
        );
        println!("skipped: `{python}` has no duckdb or polars (pip install duckdb polars)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let flight = flight(None);
    write_flight(&file("flight.csv"), &flight).unwrap();
    convert(&file("flight.csv"), &file("ours.parquet"));
    let output = Command::new(python)
        .args(["-c", SCRIPT])
        .args([file("ours.parquet"), file("theirs.parquet")])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    convert(&file("theirs.parquet"), &file("back.csv"));
    assert_eq!(read_flight(&file("back.csv")).unwrap().samples, flight.samples);
}
