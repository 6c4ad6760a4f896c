//! One swing for eight models at once: fits to bootstrap resamples of the recorded flights.

#![allow(clippy::print_stdout, clippy::print_stderr)] // tables for people, and why a test was skipped

use flyvine::flight::{Flight, HygieneOptions, clean, read_flight};
use flyvine::model::{Bank, FitOptions, Refinement, Ridge, fit_bank};
use flyvine::task::{PlanOptions, Task, make_ensemble_plan};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::path::Path;

const MEMBERS: usize = 8;

/// Training flights of the empty short arm, or `None` (said on stderr) where the shared data is absent and not required.
fn training_flights() -> Option<Vec<Flight>> {
    let beside_workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("FLYVINE_SHARED_DATA").map_or(beside_workspace, Into::into);
    if !folder.is_dir() {
        let required = std::env::var_os("FLYVINE_REQUIRE_SHARED_DATA").is_some_and(|value| value == "1");
        assert!(
            !required,
            "shared data required, but {} is absent",
            folder.display()
        );
        eprintln!("skipped: no shared data at {}", folder.display());
        return None;
    }
    let mut paths: Vec<_> = std::fs::read_dir(folder.join("flights"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.file_name()
                .unwrap()
                .to_str()
                .unwrap()
                .starts_with("ES_train")
        })
        .collect();
    paths.sort();
    let read = |path: &std::path::PathBuf| {
        let mut flight = read_flight(path).unwrap();
        clean(&mut flight, &HygieneOptions::default());
        flight
    };
    Some(paths.iter().map(read).collect())
}

/// A bank fitted to the distinct flights among as many as there are, drawn with replacement.
fn resampled_bank(flights: &[Flight], random: &mut ChaCha8Rng) -> Bank {
    let drawn: BTreeSet<usize> = flights
        .iter()
        .map(|_| random.random_range(0..flights.len()))
        .collect();
    let drawn: Vec<Flight> = drawn.into_iter().map(|i| flights[i].clone()).collect();
    let options = FitOptions {
        height_ridge: Ridge::Value(1e-3),
        linear_ridge: Ridge::Value(0.0),
        refinement: Refinement::Off,
        ..FitOptions::default()
    };
    fit_bank(&drawn, &options).unwrap().0
}

#[test]
fn every_member_reaches_the_target_below_the_ceiling() {
    let Some(flights) = training_flights() else {
        return;
    };
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let banks: Vec<Bank> = (0..MEMBERS)
        .map(|_| resampled_bank(&flights, &mut random))
        .collect();
    let task = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tasks/swing_ES.toml");
    let task = Task {
        support: None, // its outputs of every member are many states; what is shown here needs none
        ..Task::read(Path::new(task)).unwrap()
    };
    let plan = make_ensemble_plan(&task, &banks, &PlanOptions::default()).unwrap();
    println!("{:?}", plan.solve);
    for member in &plan.ensemble {
        println!("{member:?}");
    }
    assert!(plan.solve.converged, "{:?}", plan.solve);
    assert_eq!(plan.ensemble.len(), MEMBERS);
    for member in &plan.ensemble {
        assert!(member.target_miss_m.unwrap() <= 0.05, "{member:?}");
        assert!(member.max_violation <= 1e-6, "{member:?}");
    }
}
