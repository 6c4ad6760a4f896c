//! The default vehicle against hardware: the paper's 12 flown plans replayed, and the measured curves of its
//! figures.

#![allow(clippy::print_stdout, clippy::print_stderr)] // tables for people, and why a test was skipped

mod common;

use common::shared_data;
use flyvine::sim::hover::modes;
use flyvine::sim::paper;
use flyvine::sim::replay::{Measured, ReplayRow, replay_table};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use std::path::Path;

fn rows_of(parameters: VehicleParameters) -> Option<Vec<ReplayRow>> {
    let folder = shared_data("author/commands")?;
    let recordings = paper::recordings(&folder.join("author/commands"), &folder.join("paper_figures"))
        .expect("the shared data are complete");
    let vehicle = SimulatedVehicle::new(parameters).expect("valid");
    Some(replay_table(&vehicle, &recordings).expect("the vehicle flies every plan"))
}

fn rows() -> Option<Vec<ReplayRow>> {
    rows_of(VehicleParameters::default())
}

/// The calibrated vehicle whose long arm shares its beam with the short one.
fn tied() -> VehicleParameters {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/vehicles/vine_tied.toml");
    VehicleParameters::from_toml(&std::fs::read_to_string(path).expect("bundled")).expect("valid")
}

/// RMS (cm) of an independent, calibrated MuJoCo vehicle on the swings ES, IS, EL, IL: quadrotor x, end-effector
/// x, end-effector height minus quadrotor height.
const REFERENCE_SWINGS: [[f64; 3]; 4] = [
    [3.6, 4.7, 5.3],
    [7.1, 8.7, 8.7],
    [3.8, 11.3, 13.3],
    [3.6, 10.8, 6.4],
];

/// The flight that swings by some 9 cm on hardware; see [`a_swing_from_before_the_flight_explains_the_oscillation`].
const OSCILLATING: &str = "lemniscate 10s IS";

/// The swings, which come first.
fn closer_than_the_reference_vehicle(rows: &[ReplayRow]) {
    for (row, [quadrotor, end_effector, height]) in rows.iter().zip(REFERENCE_SWINGS) {
        println!("{row:.3?}");
        assert!(100.0 * row.quadrotor_m < 1.3 * quadrotor, "{row:?}");
        assert!(100.0 * row.end_effector_m < end_effector, "{row:?}");
        assert!(
            row.height_m.is_some_and(|found| 100.0 * found < height),
            "{row:?}"
        );
    }
}

#[test]
fn swings_are_closer_to_hardware_than_the_reference_vehicle() {
    let Some(rows) = rows() else { return };
    closer_than_the_reference_vehicle(&rows);
}

#[test]
fn lemniscates_stay_near_the_measured_paths() {
    let Some(rows) = rows() else { return };
    assert_eq!(rows.len(), 12);
    for row in &rows[4..] {
        println!("{row:.3?}");
        let end_effector = if row.name == OSCILLATING { 8.1 } else { 6.0 };
        assert!(
            100.0 * row.quadrotor_m < 5.0 && 100.0 * row.end_effector_m < end_effector,
            "{row:?}"
        );
    }
}

/// One beam per pressure is enough for all that the beams of four corners do, and for the quadrotor's paths.
#[test]
fn tied_beams_are_as_close_to_hardware() {
    let Some(rows) = rows_of(tied()) else { return };
    closer_than_the_reference_vehicle(&rows);
    for row in &rows[4..] {
        println!("{row:.3?}");
        let end_effector = if row.name == OSCILLATING { 8.1 } else { 6.0 };
        assert!(
            100.0 * row.quadrotor_m < 4.0 && 100.0 * row.end_effector_m < end_effector,
            "{row:?}"
        );
    }
}

/// What the slow flight of the short inflated arm may be: a hover mode without damping. The tied calibration gives that arm's
/// beam a damping of 0.0028 ± 0.0020 N m² s (95 %). With 0.0011 its swing grows about hover, and a swing from before the flight
/// lasts through it and brings the path within the other flights' distance, which no start at rest does. When and how far
/// the vehicle was nudged is the best of 300 draws: this shows what can be, it predicts nothing.
#[test]
fn a_swing_from_before_the_flight_explains_the_oscillation() {
    let Some(folder) = shared_data("author/commands") else {
        return;
    };
    let recordings = paper::recordings(&folder.join("author/commands"), &folder.join("paper_figures"))
        .expect("the shared data are complete");
    let at_rest = recordings
        .into_iter()
        .find(|recording| recording.name == OSCILLATING)
        .expect("one of the twelve");
    let mut parameters = tied();
    parameters.arm.corners.inflated_short.damping_n_m2_s *= 0.4;
    let mode = modes(&parameters, at_rest.configurations[0]).expect("hovers")[0];
    assert!(
        (-0.03..0.0).contains(&mode.damping_ratio) && (mode.frequency_hz - 0.85).abs() < 0.05,
        "{mode:?}"
    );

    // Four seconds of hover with a nudge before the plan.
    let (before, nudge) = (80, 16..22);
    let mut nudged = at_rest.clone();
    let hover = |row| {
        let share = if nudge.contains(&row) { 1.0 } else { 0.0 };
        [0.38 * share, 0.17 * share, flyvine::HOVER_HEIGHT_M]
    };
    nudged.commands.splice(0..0, (0..before).map(hover));
    nudged.velocities.splice(0..0, vec![None; before]);
    nudged
        .configurations
        .splice(0..0, vec![at_rest.configurations[0]; before]);
    if let Measured::Path { after_s, .. } = &mut nudged.measured {
        *after_s += before as f64 * flyvine::DT;
    }
    let vehicle = SimulatedVehicle::new(parameters).expect("valid");
    let rows = replay_table(&vehicle, &[at_rest, nudged]).expect("flies");
    println!("{rows:.3?}");
    assert!(100.0 * rows[0].end_effector_m > 7.0, "{rows:?}");
    assert!(
        100.0 * rows[1].end_effector_m < 6.0 && 100.0 * rows[1].quadrotor_m < 4.0,
        "{rows:?}"
    );
}

#[test]
fn the_table_does_not_depend_on_the_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(rows)
    };
    assert_eq!(on(1), on(2));
}
