//! A bank between banks of two payloads predicts flights with a payload in between.

#![allow(clippy::print_stdout)] // what was measured

mod common;

use common::recorded;
use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{Bank, FitOptions, WindowKind, bank_between, check, fit_bank, fit_physical_bank};
use flyvine::sim::VehicleParameters;
use flyvine::task::{test_flight, training_flights};

const CONFIGURATION: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
/// Payloads of the two banks, kg, and of the flights in between.
const PAYLOADS_KG: [f64; 2] = [0.0, 0.1];
const BETWEEN_KG: f64 = 0.05;

/// Flies `commands` on the built-in vehicle with this payload at the tip.
fn fly(name: &str, commands: &[[f64; 3]], payload_kg: f64, seed: u64) -> Flight {
    let mut parameters = VehicleParameters::default();
    parameters.payload.tip_mass_kg = payload_kg;
    recorded(
        &format!("{name} {payload_kg} kg"),
        commands,
        parameters,
        CONFIGURATION,
        seed,
    )
}

fn training(payload_kg: f64) -> Vec<Flight> {
    let flights = training_flights(1).into_iter();
    flights
        .map(|flight| fly(flight.name, &flight.commands, payload_kg, 1))
        .collect()
}

/// Median error of the end effector over 2.5 s on a flight that no fit saw, with the payload in between, of the mixed bank and of
/// those that it was mixed of, m.
fn medians_m(fit: impl Fn(&[Flight]) -> Bank) -> (f64, [f64; 2]) {
    let banks = PAYLOADS_KG.map(|payload_kg| (payload_kg, fit(&training(payload_kg))));
    let judge = [fly("judge", &test_flight(101).commands, BETWEEN_KG, 101)];
    let median_m = |bank: &Bank| {
        let report = check(bank, &judge).unwrap();
        let pooled = report.pooled.iter();
        let mut all = pooled.filter(|pooled| pooled.kind == WindowKind::All);
        let error = &all.find(|pooled| pooled.error.horizon_s == 2.5).unwrap().error;
        error.median_m.unwrap()
    };
    let mixed = bank_between("payload_kg", &banks, BETWEEN_KG).unwrap();
    let found = (median_m(&mixed), [0, 1].map(|i| median_m(&banks[i].1)));
    println!("mixed {:.4} m, neighbours {:.4?} m", found.0, found.1);
    found
}

#[test]
fn a_lag_bank_between_payloads_predicts_better_than_its_neighbours() {
    let (mixed_m, neighbours_m) = medians_m(|flights| fit_bank(flights, &FitOptions::default()).unwrap().0);
    assert!(neighbours_m.iter().all(|&other_m| mixed_m < 0.9 * other_m));
}

#[test]
#[ignore = "two physical fits: a minute"]
fn a_physical_bank_between_payloads_predicts_better_than_its_neighbours() {
    let options = PhysicalFitOptions::default();
    let (mixed_m, neighbours_m) =
        medians_m(|flights| fit_physical_bank(flights, &options, &mut |_, _| {}).unwrap().0);
    assert!(neighbours_m.iter().all(|&other_m| mixed_m < 0.9 * other_m));
}
