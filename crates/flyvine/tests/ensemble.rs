//! One swing for eight models at once: fits to bootstrap resamples of the recorded flights.

#![allow(clippy::print_stdout)] // tables for people

mod common;

use common::reference_flights;
use flyvine::flight::Flight;
use flyvine::model::{Bank, FitOptions, Positions, Refinement, Ridge, fit_bank};
use flyvine::task::{PlanOptions, Task, make_ensemble_plan};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

const MEMBERS: usize = 8;

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
        positions: Some(Positions::Absolute),
        refinement: Refinement::Off,
        ..FitOptions::default()
    };
    fit_bank(&drawn, &options).unwrap().0
}

#[test]
fn every_member_reaches_the_target_below_the_ceiling() {
    let Some(flights) = reference_flights(|name| name.starts_with("ES_train")) else {
        return;
    };
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let banks: Vec<Bank> = (0..MEMBERS)
        .map(|_| resampled_bank(&flights, &mut random))
        .collect();
    let task = Task {
        support: None, // its outputs of every member are many states; what is shown here needs none
        ..common::task("swing_ES.toml")
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
