//! Recordings for tests, where the shared data is present.

use crate::flight::{Configuration, Flight, Pose, Sample};
use std::path::PathBuf;

/// Folder of the shared data, or `None` (said on stderr) where it is absent and not required.
#[allow(clippy::print_stderr)] // a skipped test must say so
pub(crate) fn shared_data() -> Option<PathBuf> {
    let default = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    let folder = std::env::var_os("FLYVINE_SHARED_DATA").map_or(default, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    let required = std::env::var_os("FLYVINE_REQUIRE_SHARED_DATA").is_some_and(|value| value == "1");
    assert!(
        !required,
        "shared data required, but {} is absent",
        folder.display()
    );
    eprintln!("skipped: no shared data at {}", folder.display());
    None
}

/// The flights of `folder` whose names match, sorted by name, frozen poses masked.
pub(crate) fn flights(folder: &str, matches: impl Fn(&str) -> bool) -> Option<Vec<Flight>> {
    let folder = shared_data()?.join(folder);
    let mut names: Vec<String> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".csv") && matches(name))
        .collect();
    names.sort();
    Some(names.iter().map(|name| read(&folder.join(name), name)).collect())
}

fn read(path: &std::path::Path, name: &str) -> Flight {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let header = reader.headers().unwrap().clone();
    let velocity = header.iter().any(|column| column == "cmd_vx");
    let mut samples: Vec<Sample> = Vec::new();
    for record in reader.records() {
        let record = record.unwrap();
        let cell: Vec<Option<f64>> = record.iter().map(|cell| cell.parse().ok()).collect();
        let value = |column: usize| cell[column].unwrap();
        let quadrotor = cell[6].map(|_| Pose {
            position: [value(6), value(7), value(8)],
            attitude: [value(9), value(10), value(11), value(12)],
        });
        let end_effector = cell[13].map(|_| [value(13), value(14), value(15)]);
        samples.push(Sample {
            t_s: value(0),
            configuration: Configuration {
                length_m: value(1),
                pressure_kpa: value(2),
            },
            command: [value(3), value(4), value(5)],
            command_velocity: velocity.then(|| [value(16), value(17), value(18)]),
            quadrotor,
            end_effector,
        });
    }
    let raw = samples.clone();
    for row in 1..samples.len() {
        if raw[row].quadrotor == raw[row - 1].quadrotor {
            samples[row].quadrotor = None;
        }
        if raw[row].end_effector == raw[row - 1].end_effector {
            samples[row].end_effector = None;
        }
    }
    Flight {
        name: name.to_owned(),
        samples,
    }
}
