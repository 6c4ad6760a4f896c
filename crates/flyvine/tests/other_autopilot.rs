//! The physical family on an autopilot that is built differently from the one it assumes.

mod common;

use common::recorded;
use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{check, fit_physical_bank};
use flyvine::sim::VehicleParameters;
use flyvine::sim::autopilot::Law;
use flyvine::task::{test_flight, training_flights};

const CONFIGURATION: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

/// Geometric control without a velocity set-point, which counts no more than 1 m of the position error: the vehicle is
/// never sent faster than about 1 m/s.
fn fly(name: &str, commands: &[[f64; 3]], seed: u64) -> Flight {
    let mut parameters = VehicleParameters::default();
    parameters.autopilot.law = Law::Geometric;
    recorded(name, commands, parameters, CONFIGURATION, seed)
}

#[test]
fn flights_under_geometric_control_are_explained() {
    let training: Vec<Flight> = training_flights(1)
        .iter()
        .map(|flight| fly(flight.name, &flight.commands, 1))
        .collect();
    let (bank, report) =
        fit_physical_bank(&training, &PhysicalFitOptions::default(), &mut |_, _| {}).unwrap();
    assert!(report.corners[0].tip_error_m < 0.02);
    let judge = [fly("judge", &test_flight(101).commands, 101)];
    for error in &check(&bank, &judge).unwrap().flights[0].rollout {
        assert!(
            error.median_m.unwrap() < 0.04 && error.diverged_share == 0.0,
            "{error:?}"
        );
    }
}
