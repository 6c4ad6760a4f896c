//! The modes of the closed loop about hover.

use flyvine::flight::Corner;
use flyvine::link::Vehicle;
use flyvine::sim::hover::{modes, oscillations};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use nalgebra::Vector2;

#[test]
fn known_oscillations_are_found() {
    let known = [(0.55, -0.012), (1.3, 0.15), (3.0, 0.5)];
    let response: Vec<Vector2<f64>> = (0..160)
        .map(|k| {
            let t = k as f64 * flyvine::DT;
            let sum = |phase: f64| {
                known
                    .iter()
                    .enumerate()
                    .map(|(j, (frequency, damping))| {
                        let w = std::f64::consts::TAU * frequency;
                        let turn = w * (1.0 - f64::powi(*damping, 2)).sqrt() * t;
                        (-damping * w * t).exp() * (turn + phase * (j + 1) as f64).cos()
                    })
                    .sum()
            };
            // A mode that only decays is none.
            Vector2::new(sum(0.3), sum(0.8) + 0.5 * (-2.0 * t).exp())
        })
        .collect();
    let found = oscillations(&response, flyvine::DT);
    assert_eq!(found.len(), known.len(), "{found:?}");
    for (mode, (frequency_hz, damping_ratio)) in found.iter().zip(known) {
        assert!((mode.frequency_hz - frequency_hz).abs() < 1e-3, "{mode:?}");
        assert!((mode.damping_ratio - damping_ratio).abs() < 1e-3, "{mode:?}");
    }
}

/// The least damped mode of the short inflated arm, against peaks of the tip's swing that are counted and compared.
#[test]
fn the_least_damped_mode_is_what_is_left_of_a_nudge() {
    let mut parameters = VehicleParameters::default();
    parameters.arm.drag_coefficient_normal = 0.0;
    parameters.arm.tip_drag_area_m2 = 0.0;
    let configuration = Corner::Is.configuration();
    let mode = modes(&parameters, configuration).expect("the default vehicle hovers")[0];
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(configuration, 0).expect("in range");
    let tip: Vec<f64> = (0..1000)
        .map(|row| {
            let x = if row < 10 { 0.01 } else { 0.0 };
            vehicle.step([x, 0.0, 1.5].into(), configuration).expect("flies");
            vehicle.positions().1.x
        })
        .collect();
    // Crossings of zero from 10 s on, and the greatest of ten swings there and at the end.
    let crossings: Vec<f64> = (200..999)
        .filter(|&k| tip[k] < 0.0 && tip[k + 1] >= 0.0)
        .map(|k| flyvine::DT * (k as f64 - tip[k] / (tip[k + 1] - tip[k])))
        .collect();
    let turns = (crossings.len() - 1) as f64;
    let frequency = turns / (crossings[crossings.len() - 1] - crossings[0]);
    assert!(
        (frequency / mode.frequency_hz - 1.0).abs() < 0.01,
        "{frequency} Hz, {mode:?}"
    );
    let greatest = |rows: &[f64]| rows.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
    let decrement = (greatest(&tip[200..400]) / greatest(&tip[800..1000])).ln() / 30.0;
    let damping = decrement / (std::f64::consts::TAU * mode.frequency_hz);
    assert!((damping - mode.damping_ratio).abs() < 2e-3, "{damping}, {mode:?}");
}

/// Why a default vehicle that carries 50 g on its short, inflated arm swings on and on: the load undamps the very mode that is
/// lightly damped without it. The swings of the other corners die, carrying it or not.
#[test]
fn a_load_undamps_the_short_inflated_arms_swing() {
    let least_damped = |corner: Corner, load_kg: f64| {
        let mut parameters = VehicleParameters::default();
        parameters.payload.tip_mass_kg = load_kg;
        modes(&parameters, corner.configuration()).expect("hovers")[0]
    };
    let (empty, loaded) = (least_damped(Corner::Is, 0.0), least_damped(Corner::Is, 0.05));
    assert!((0.0..0.03).contains(&empty.damping_ratio), "{empty:?}");
    assert!(loaded.damping_ratio < 0.0, "{loaded:?}");
    assert!(
        (loaded.frequency_hz / empty.frequency_hz - 0.95).abs() < 0.03,
        "{empty:?}, {loaded:?}"
    );
    for corner in [Corner::Es, Corner::El, Corner::Il] {
        let (empty, loaded) = (least_damped(corner, 0.0), least_damped(corner, 0.05));
        assert!(
            empty.damping_ratio > loaded.damping_ratio && loaded.damping_ratio > 0.0,
            "{corner:?}: {empty:?}, {loaded:?}"
        );
    }
}
