//! Whole flights: the loop, the supervisor and real vehicles, built in and behind `exec:`.

use std::ops::ControlFlow;

use flyvine::DT;
use flyvine::control::supervisor::{EventKind, Limits};
use flyvine::control::{End, FlightOutcome, OpenLoop, Trajectory, fly};
use flyvine::flight::Configuration;
use flyvine::link::Vehicle;
use flyvine::link::exec::{ExecOptions, ExecVehicle};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};

const CORNERS: [(f64, f64); 4] = [(0.7, 0.0), (0.7, 0.4), (1.0, 0.0), (1.0, 0.4)];

/// A second of hover, one round of a figure eight in 5 s, and a second of hover at its end.
fn figure_eight((length_m, pressure_kpa): (f64, f64)) -> Trajectory {
    let command = |k: usize| {
        let phase = std::f64::consts::TAU * (k as f64 * DT - 1.0).clamp(0.0, 5.0) / 5.0;
        [0.8 * phase.sin(), 0.8 * phase.cos() * phase.sin(), 1.5]
    };
    let knots = (7.0 / DT) as usize + 1;
    let rest = vec![0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5 - length_m];
    Trajectory::new(
        (0..knots - 1).map(command).collect(),
        vec![rest; knots],
        Vec::new(),
        vec![
            Configuration {
                length_m,
                pressure_kpa
            };
            knots
        ],
        [-3.0; 3],
        [3.0; 3],
    )
    .unwrap()
}

fn fly_open_loop(trajectory: &Trajectory, vehicle: &mut dyn Vehicle, seed: u64) -> FlightOutcome {
    let mut go_on = |_: usize, _: usize| ControlFlow::Continue(());
    let mut controller = OpenLoop::new(trajectory);
    fly(
        trajectory,
        &mut controller,
        Limits::default(),
        vehicle,
        seed,
        &mut go_on,
    )
    .unwrap()
}

fn assert_completed(outcome: &FlightOutcome, trajectory: &Trajectory) {
    assert!(matches!(outcome.end, End::Completed), "{:?}", outcome.end);
    assert_eq!(outcome.flight.samples.len(), trajectory.knots());
}

/// Largest |y| of the tip, m: the figure eight's command has 0.4 m.
fn swing_width(outcome: &FlightOutcome) -> f64 {
    let tips = outcome
        .flight
        .samples
        .iter()
        .filter_map(|sample| sample.end_effector);
    tips.map(|tip| tip[1].abs()).fold(0.0, f64::max)
}

#[test]
fn the_simulated_vehicle_flies_at_every_corner_and_the_supervisor_has_nothing_to_say() {
    for noise in [true, false] {
        let mut parameters = VehicleParameters::default();
        if !noise {
            parameters.mocap.position_noise_m = 0.0;
            parameters.mocap.attitude_noise_deg = 0.0;
        }
        for corner in CORNERS {
            let trajectory = figure_eight(corner);
            let mut vehicle = SimulatedVehicle::new(parameters.clone()).unwrap();
            let outcome = fly_open_loop(&trajectory, &mut vehicle, 1);
            assert_completed(&outcome, &trajectory);
            assert!(
                outcome.events.is_empty(),
                "{corner:?}, noise {noise}: {:?}",
                outcome.events
            );
            assert!((0.1..0.8).contains(&swing_width(&outcome)));
            vehicle.close().unwrap();
        }
    }
}

#[test]
fn a_simulated_vehicle_with_motion_capture_faults_is_flown_through_them() {
    let mut parameters = VehicleParameters::default();
    parameters.mocap.dropout_probability = 0.05;
    parameters.mocap.freeze_probability = 0.02;
    parameters.mocap.frozen_frames = 5;
    let trajectory = figure_eight(CORNERS[0]);
    let mut vehicle = SimulatedVehicle::new(parameters).unwrap();
    let outcome = fly_open_loop(&trajectory, &mut vehicle, 3);
    assert_completed(&outcome, &trajectory);
    let coasted = |frozen_only: bool| {
        outcome
            .events
            .iter()
            .any(|event| matches!(event.kind, EventKind::Coasting { frozen, .. } if frozen || !frozen_only))
    };
    assert!(coasted(true), "{:?}", outcome.events);
    let missed = outcome
        .flight
        .samples
        .iter()
        .filter(|sample| sample.end_effector.is_none())
        .count();
    assert!(missed > 0, "what was missed stays missing in the recording");
}

#[test]
fn a_simulated_vehicle_whose_poses_freeze_for_good_is_stopped() {
    let mut parameters = VehicleParameters::default();
    parameters.mocap.freeze_probability = 0.02;
    parameters.mocap.frozen_frames = 1000;
    let trajectory = figure_eight(CORNERS[0]);
    let outcome = fly_open_loop(&trajectory, &mut SimulatedVehicle::new(parameters).unwrap(), 1);
    let End::Aborted { t_s, cause } = &outcome.end else {
        panic!("completed on frozen poses")
    };
    assert!(cause.to_string().contains("frozen"), "t = {t_s} s: {cause}");
}

/// The worked example, as a user starts it.
fn example() -> ExecVehicle {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/vehicle.py");
    ExecVehicle::spawn(&format!("python3 '{script}'"), ExecOptions::default()).unwrap()
}

#[test]
fn the_example_vehicle_flies_a_figure_eight_behind_exec() {
    let trajectory = figure_eight(CORNERS[0]);
    let mut vehicle = example();
    let outcome = fly_open_loop(&trajectory, &mut vehicle, 1);
    assert_completed(&outcome, &trajectory);
    assert!(outcome.events.is_empty(), "{:?}", outcome.events);
    assert!(
        (0.1..0.8).contains(&swing_width(&outcome)),
        "{}",
        swing_width(&outcome)
    );

    // A reset starts over: same seed, same flight; another seed, other noise.
    assert_eq!(fly_open_loop(&trajectory, &mut vehicle, 1).flight, outcome.flight);
    assert_ne!(fly_open_loop(&trajectory, &mut vehicle, 2).flight, outcome.flight);
    vehicle.close().unwrap();
}

#[test]
fn the_example_vehicle_follows_a_growing_arm() {
    let length = |k: usize| 0.7 + 0.001 * k as f64;
    let knots = 200;
    let trajectory = Trajectory::new(
        vec![[0.0, 0.0, 1.5]; knots - 1],
        vec![vec![0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8]; knots],
        Vec::new(),
        (0..knots)
            .map(|k| Configuration {
                length_m: length(k),
                pressure_kpa: 0.0,
            })
            .collect(),
        [-3.0; 3],
        [3.0; 3],
    )
    .unwrap();
    let mut vehicle = example();
    let outcome = fly_open_loop(&trajectory, &mut vehicle, 1);
    assert_completed(&outcome, &trajectory);
    for (k, sample) in outcome.flight.samples.iter().enumerate().skip(1) {
        // Row k is seen with the length told along with command k − 1.
        let (pose, tip) = (sample.quadrotor.unwrap(), sample.end_effector.unwrap());
        assert!(
            (pose.position[2] - tip[2] - length(k - 1)).abs() < 3e-3,
            "row {k}"
        );
    }
    vehicle.close().unwrap();
}
