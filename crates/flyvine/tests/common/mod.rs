//! Recordings that are not part of the project, and a bank that needs none.

#![allow(dead_code, clippy::print_stderr)] // no test binary uses all of it; why a test was skipped

use flyvine::DT;
use flyvine::flight::{Configuration, Flight, HygieneOptions, Pose, Sample, clean, read_flight};
use flyvine::link::{Observation, Vehicle};
use flyvine::model::physical::{ArmLength, Parameters, PhysicalModel};
use flyvine::model::{Bank, BankModel, BankProvenance, Model, ModelDiagnostics};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::Task;
use std::path::{Path, PathBuf};

/// A bank of the physical family's priors, for the empty short arm.
pub fn prior_bank() -> Bank {
    prior_bank_of(&[0.7])
}

/// The same for arms of these lengths, m.
pub fn prior_bank_of(lengths_m: &[f64]) -> Bank {
    let model = |&length_m: &f64| {
        let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(length_m)).unwrap();
        BankModel {
            configuration: Configuration {
                length_m,
                pressure_kpa: 0.0,
            },
            model: Model::Physical(Box::new(model)),
            diagnostics: ModelDiagnostics::default(),
        }
    };
    Bank::new(lengths_m.iter().map(model).collect(), BankProvenance::default()).unwrap()
}

/// The cleaned recording of `commands`, flown on the built-in vehicle from its hover.
pub fn recorded(
    name: &str,
    commands: &[[f64; 3]],
    parameters: VehicleParameters,
    configuration: Configuration,
    seed: u64,
) -> Flight {
    let mut vehicle = SimulatedVehicle::new(parameters).unwrap();
    let mut seen = vehicle.reset(configuration, seed).unwrap();
    let mut samples = Vec::with_capacity(commands.len());
    for &command in commands {
        let Observation {
            t_s,
            quadrotor,
            end_effector,
        } = seen;
        samples.push(Sample {
            t_s,
            configuration,
            command,
            command_velocity: None,
            quadrotor,
            end_effector,
        });
        seen = vehicle.step(command.into(), configuration).unwrap();
    }
    let name = name.to_owned();
    let mut flight = Flight { name, samples };
    clean(&mut flight, &HygieneOptions::default());
    flight
}

/// What motion capture sees of a model's state `z` at `knot`.
pub fn observed(knot: usize, z: &[f64]) -> Observation {
    let vector = [z[3], z[4], z[5]];
    let scalar = (1.0 - vector.iter().map(|v| v * v).sum::<f64>()).sqrt();
    Observation {
        t_s: knot as f64 * DT,
        quadrotor: Some(Pose {
            position: [z[0], z[1], z[2]],
            attitude: [scalar, vector[0], vector[1], vector[2]],
        }),
        end_effector: Some([z[6], z[7], z[8]]),
    }
}

/// A shipped task.
pub fn task(name: &str) -> Task {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tasks");
    Task::read(&folder.join(name)).unwrap()
}

/// The shared data, or `None` (said on stderr) where `folder` in them is absent and not required.
pub fn shared_data(folder: &str) -> Option<PathBuf> {
    let beside_workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("FLYVINE_SHARED_DATA").map_or(beside_workspace, PathBuf::from);
    if data.join(folder).is_dir() {
        return Some(data);
    }
    let required = std::env::var_os("FLYVINE_REQUIRE_SHARED_DATA").is_some_and(|value| value == "1");
    assert!(
        !required,
        "shared data required, but {} is absent",
        data.join(folder).display()
    );
    eprintln!("skipped: no shared data at {}", data.join(folder).display());
    None
}

/// The recordings in `folder` whose file names match, by name, cleaned.
pub fn flights(folder: &Path, matches: impl Fn(&str) -> bool, read: impl Fn(&Path) -> Flight) -> Vec<Flight> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| matches(path.file_name().unwrap().to_str().unwrap()))
        .collect();
    paths.sort();
    let cleaned = |path: &PathBuf| {
        let mut flight = read(path);
        clean(&mut flight, &HygieneOptions::default());
        flight
    };
    paths.iter().map(cleaned).collect()
}

/// The reference vehicle's flights whose file names match, as [`flights`].
pub fn reference_flights(matches: impl Fn(&str) -> bool) -> Option<Vec<Flight>> {
    let folder = shared_data("flights")?.join("flights");
    Some(flights(&folder, matches, |path| read_flight(path).unwrap()))
}
