//! The simulated vehicle as a whole.

use flyvine::flight::Configuration;
use flyvine::link::Vehicle;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};

const CORNERS: [(f64, f64); 4] = [(0.7, 0.0), (0.7, 0.4), (1.0, 0.0), (1.0, 0.4)];

fn corner(index: usize) -> Configuration {
    let (length_m, pressure_kpa) = CORNERS[index];
    Configuration {
        length_m,
        pressure_kpa,
    }
}

#[test]
fn hover_is_an_equilibrium() {
    for index in 0..4 {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        for _ in 0..400 {
            vehicle.step([0.0, 0.0, 1.5], corner(index)).expect("flies");
        }
        let truth = vehicle.truth();
        let [x, y, z] = truth.quadrotor.position;
        assert!(
            x.abs().max(y.abs()).max((z - 1.5).abs()) < 1e-3,
            "corner {index}: {truth:?}"
        );
    }
}

#[test]
fn a_step_settles_in_every_corner() {
    for index in 0..4 {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        let mut late = 0.0_f64;
        for k in 0..400 {
            vehicle.step([0.5, 0.0, 1.5], corner(index)).expect("flies");
            if k > 300 {
                late = late.max((vehicle.truth().end_effector[0] - 0.5).abs());
            }
        }
        assert!(
            late < 0.1,
            "corner {index}: the tip still swings by {late:.3} m after 15 s"
        );
    }
}

#[test]
fn same_seed_same_bits() {
    let fly = |seed| {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        let mut rows = vec![vehicle.reset(corner(3), seed).expect("a corner is in range")];
        for k in 0..100 {
            rows.push(
                vehicle
                    .step([0.01 * f64::from(k), 0.0, 1.5], corner(3))
                    .expect("flies"),
            );
        }
        rows
    };
    assert_eq!(fly(7), fly(7));
    assert_ne!(fly(7), fly(8));
}
