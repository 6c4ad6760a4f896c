//! Flights of a small linear vehicle, and of faults put in its way.

use super::*;
use crate::control::supervisor::Body;
use crate::control::{OpenLoop, Tracking};
use crate::flight::{Configuration, Pose};
use crate::link::{Observation, Setpoint};
use crate::model::{CommandInputs, LagModel, ScheduledModel};
use crate::trajopt::Dynamics;

const SHORT: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
const KNOTS: usize = 80;
const NO_LIMIT: [f64; 3] = [f64::INFINITY; 3];

/// x⁺ of the quadrotor (a first-order lag behind the command, leaning into its motion) and of the tip (a
/// first-order lag behind the quadrotor).
fn next(x: &[f64], u: &[f64], fresh: &mut [f64]) {
    for axis in 0..3 {
        let motion = 0.2 * (u[axis] - x[axis]);
        fresh[axis] = x[axis] + motion;
        fresh[3 + axis] = 0.1 * motion;
        let below = if axis == 2 {
            x[axis] - SHORT.length_m
        } else {
            x[axis]
        };
        fresh[6 + axis] = x[6 + axis] + 0.3 * (below - x[6 + axis]);
    }
}

const REST: [f64; 9] = [0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8];

/// `next` as a model of two lags: n = 18.
fn model() -> ScheduledModel {
    const WIDTH: usize = 21;
    let (mut linear, mut offset) = (vec![0.0; 9 * WIDTH], vec![0.0; 9]);
    let mut basis = [0.0; 12];
    next(&[0.0; 9], &[0.0; 3], &mut offset);
    for input in 0..12 {
        basis.fill(0.0);
        basis[input] = 1.0;
        let mut response = [0.0; 9];
        next(&basis[..9], &basis[9..], &mut response);
        let column = if input < 9 { input } else { 18 + input - 9 };
        for row in 0..9 {
            linear[row * WIDTH + column] = response[row] - offset[row];
        }
    }
    let model = LagModel::new(2, CommandInputs::Position, offset, linear, &[]).unwrap();
    ScheduledModel::mixture(&[model], &[1.0]).unwrap()
}

type Fault = Box<dyn FnMut(usize, &mut Observation)>;

/// The same physics with wind, and a fault in what motion capture says.
struct TestVehicle {
    state: [f64; 9],
    steps: usize,
    wind: [f64; 3],
    fault: Fault,
    ends_at: usize,
}

impl TestVehicle {
    fn new() -> Self {
        Self {
            state: REST,
            steps: 0,
            wind: [0.0; 3],
            fault: Box::new(|_, _| ()),
            ends_at: usize::MAX,
        }
    }

    fn with_fault(fault: impl FnMut(usize, &mut Observation) + 'static) -> Self {
        Self {
            fault: Box::new(fault),
            ..Self::new()
        }
    }

    fn observe(&mut self) -> Result<Observation, VehicleError> {
        let t_s = self.steps as f64 * DT;
        if self.steps >= self.ends_at {
            return Err(VehicleError::Diverged {
                t_s,
                what: "a test".into(),
            });
        }
        let x = &self.state;
        let w = (1.0 - x[3] * x[3] - x[4] * x[4] - x[5] * x[5]).sqrt();
        let pose = Pose {
            position: [x[0], x[1], x[2]],
            attitude: [w, x[3], x[4], x[5]],
        };
        let mut observation = Observation {
            t_s,
            quadrotor: Some(pose),
            end_effector: Some([x[6], x[7], x[8]]),
        };
        (self.fault)(self.steps, &mut observation);
        Ok(observation)
    }
}

impl Vehicle for TestVehicle {
    fn reset(&mut self, _configuration: Configuration, _seed: u64) -> Result<Observation, VehicleError> {
        (self.state, self.steps) = (REST, 0);
        self.observe()
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        _configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let mut fresh = [0.0; 9];
        next(&self.state, &setpoint.position, &mut fresh);
        for axis in 0..3 {
            fresh[6 + axis] += self.wind[axis];
        }
        self.state = fresh;
        self.steps += 1;
        self.observe()
    }
}

/// A circle of commands with the states that the model predicts, and a gain on the newest tip position.
fn trajectory() -> Trajectory {
    let model = model();
    let mut state: Vec<f64> = [REST, REST].concat();
    let (mut states, mut commands) = (vec![state.clone()], Vec::new());
    for k in 0..KNOTS - 1 {
        let phase = 0.08 * k as f64;
        let command = [0.8 * phase.sin(), 0.8 * (1.0 - phase.cos()), 1.5];
        let mut fresh = [0.0; 9];
        model.step(k, &state, &command, &mut fresh);
        state.copy_within(..9, 9);
        state[..9].copy_from_slice(&fresh);
        states.push(state.clone());
        commands.push(command);
    }
    let mut gain = vec![0.0; 3 * 18];
    for axis in 0..3 {
        gain[axis * 18 + 6 + axis] = -0.8;
    }
    let lower = NO_LIMIT.map(|x| -x);
    Trajectory::new(
        commands,
        states,
        vec![gain; KNOTS - 1],
        vec![SHORT; KNOTS],
        lower,
        NO_LIMIT,
    )
    .unwrap()
}

fn fly_it(controller: &mut dyn Controller, vehicle: &mut TestVehicle) -> FlightOutcome {
    fly(
        &trajectory(),
        controller,
        Limits::default(),
        vehicle,
        1,
        &mut |_, _| ControlFlow::Continue(()),
    )
    .unwrap()
}

fn open_loop(mut vehicle: TestVehicle) -> FlightOutcome {
    fly_it(&mut OpenLoop::new(&trajectory()), &mut vehicle)
}

fn tracked(mut vehicle: TestVehicle) -> FlightOutcome {
    let (trajectory, model) = (trajectory(), model());
    fly_it(&mut Tracking::new(&trajectory, &model).unwrap(), &mut vehicle)
}

/// Mean distance of the tip to the prediction, m.
fn error_m(outcome: &FlightOutcome) -> f64 {
    let trajectory = trajectory();
    let distances = outcome.flight.samples.iter().enumerate().map(|(k, sample)| {
        let (tip, planned) = (sample.end_effector.unwrap(), &trajectory.state(k)[6..9]);
        (0..3).map(|i| (tip[i] - planned[i]).powi(2)).sum::<f64>().sqrt()
    });
    distances.sum::<f64>() / outcome.flight.samples.len() as f64
}

fn reason(outcome: &FlightOutcome) -> Reason {
    match outcome.end {
        End::Aborted {
            cause: AbortCause::Supervisor(reason),
            ..
        } => reason,
        ref end => panic!("expected an abort by the supervisor, found {end:?}"),
    }
}

#[test]
fn n_knots_make_n_rows_with_the_commands_of_the_plan() {
    let (trajectory, outcome) = (trajectory(), open_loop(TestVehicle::new()));
    assert!(matches!(outcome.end, End::Completed) && outcome.events.is_empty());
    assert_eq!(outcome.flight.samples.len(), KNOTS);
    for (k, sample) in outcome.flight.samples.iter().enumerate() {
        assert_eq!(sample.t_s, k as f64 * DT);
        // u_k is in the row of x_k, and the last row repeats the final command.
        assert_eq!(sample.command, trajectory.command(k.min(KNOTS - 2)));
        let (state, planned) = (sample.state().unwrap(), trajectory.state(k));
        assert!((0..9).all(|i| (state[i] - planned[i]).abs() < 1e-12), "knot {k}");
    }
}

#[test]
fn tracking_without_disturbance_is_open_loop() {
    assert!(error_m(&tracked(TestVehicle::new())) < 1e-9);
}

#[test]
fn tracking_beats_open_loop_in_wind() {
    let windy = || TestVehicle {
        wind: [0.02, -0.01, 0.0],
        ..TestVehicle::new()
    };
    let (open, closed) = (error_m(&open_loop(windy())), error_m(&tracked(windy())));
    assert!(
        closed < 0.95 * open,
        "open loop {open:.4} m, tracking {closed:.4} m"
    );
}

#[test]
fn tracking_coasts_on_the_model_through_missing_poses() {
    let gaps = |k: usize, observation: &mut Observation| {
        if k % 7 >= 4 {
            observation.quadrotor = None;
        }
        if k % 5 == 1 {
            observation.end_effector = None;
        }
    };
    let (whole, gappy) = (
        tracked(TestVehicle::new()),
        tracked(TestVehicle::with_fault(gaps)),
    );
    assert!(matches!(gappy.end, End::Completed), "{:?}", gappy.end);
    for (a, b) in whole.flight.samples.iter().zip(&gappy.flight.samples) {
        assert!((0..3).all(|i| (a.command[i] - b.command[i]).abs() < 1e-9));
    }
    assert!(
        gappy.flight.samples[4].quadrotor.is_none(),
        "the recording tells what was seen"
    );
}

#[test]
fn tracking_stays_within_the_bounds_of_the_plan() {
    let far = |k: usize, observation: &mut Observation| {
        observation.end_effector = Some([0.3 + 1e-3 * k as f64, 0.3, 0.9]);
    };
    let plan = trajectory();
    let tight = Trajectory::new(
        (0..KNOTS - 1).map(|_| [0.0, 0.0, 1.5]).collect(),
        (0..KNOTS).map(|k| plan.state(k).to_vec()).collect(),
        (0..KNOTS - 1).map(|k| plan.gain(k).unwrap().to_vec()).collect(),
        vec![SHORT; KNOTS],
        [-0.02, -0.02, 1.495],
        [0.02, 0.02, 1.505],
    )
    .unwrap();
    let model = model();
    let mut controller = Tracking::new(&tight, &model).unwrap();
    let mut vehicle = TestVehicle::with_fault(far);
    let mut go_on = |_: usize, _: usize| ControlFlow::Continue(());
    let outcome = fly(
        &tight,
        &mut controller,
        Limits::default(),
        &mut vehicle,
        1,
        &mut go_on,
    )
    .unwrap();
    let commands: Vec<[f64; 3]> = outcome
        .flight
        .samples
        .iter()
        .map(|sample| sample.command)
        .collect();
    let (lower, upper) = tight.command_bounds();
    let inside = |u: &[f64; 3]| (0..3).all(|i| (lower[i]..=upper[i]).contains(&u[i]));
    assert!(commands.iter().all(inside), "{commands:?}");
    let at_a_bound = |u: &[f64; 3]| (0..3).any(|i| u[i] == lower[i] || u[i] == upper[i]);
    assert!(commands.iter().any(at_a_bound), "the far tip pulls: {commands:?}");
}

#[test]
fn tracking_refuses_what_it_cannot_track() {
    let no_lags = Trajectory::new(
        vec![[0.0, 0.0, 1.5]],
        vec![REST.to_vec(); 2],
        Vec::new(),
        vec![SHORT; 2],
        [-3.0; 3],
        [3.0; 3],
    )
    .unwrap();
    let refused = Tracking::new(&no_lags, &model()).err().unwrap().to_string();
    assert!(
        refused.contains("9 entries; expected the model's 18"),
        "{refused}"
    );
}

#[test]
fn a_lost_pose_ends_the_flight_in_a_hold_and_the_rows_are_kept() {
    let outcome = open_loop(TestVehicle::with_fault(|k, observation| {
        if k >= 20 {
            observation.quadrotor = None;
        }
    }));
    assert!(matches!(
        reason(&outcome),
        Reason::StalePose {
            body: Body::Quadrotor,
            ..
        }
    ));
    let End::Aborted { t_s, .. } = outcome.end else {
        panic!("{:?}", outcome.end)
    };
    // Last seen in row 19; older than 400 ms in row 28.
    assert!((t_s - 28.0 * DT).abs() < 1e-9, "t = {t_s} s");
    let samples = &outcome.flight.samples;
    assert_eq!(samples.len(), 28 + (Limits::default().hold_s / DT) as usize);
    let seen = samples[19].quadrotor.unwrap().position;
    assert!(
        samples[28..].iter().all(|sample| sample.command == seen),
        "held where it was last seen"
    );
    assert_eq!(
        samples[27].command,
        trajectory().command(27),
        "until then the plan"
    );
}

#[test]
fn a_vehicle_error_is_the_reason_and_the_rows_are_kept() {
    let outcome = open_loop(TestVehicle {
        ends_at: 30,
        ..TestVehicle::new()
    });
    let End::Aborted {
        t_s,
        cause: AbortCause::Vehicle(ref error),
    } = outcome.end
    else {
        panic!("{:?}", outcome.end)
    };
    assert!(error.to_string().contains("diverged"));
    assert_eq!((t_s, outcome.flight.samples.len()), (29.0 * DT, 30));
    let outcome = open_loop(TestVehicle {
        ends_at: 0,
        ..TestVehicle::new()
    });
    assert!(matches!(
        outcome.end,
        End::Aborted {
            cause: AbortCause::Vehicle(_),
            ..
        }
    ));
    assert!(outcome.flight.samples.is_empty());
}

#[test]
fn a_vehicle_error_in_the_hold_does_not_hide_the_first_reason() {
    let mut vehicle = TestVehicle::with_fault(|k, observation| {
        if k == 10 {
            observation.end_effector = Some([f64::NAN; 3]);
        }
    });
    vehicle.ends_at = 15;
    let outcome = open_loop(vehicle);
    assert_eq!(reason(&outcome), Reason::ImpossiblePose(Body::EndEffector));
    assert!(outcome.hold_error.is_some());
    assert_eq!(outcome.flight.samples.len(), 15);
}

#[test]
fn the_operator_can_stop_a_flight() {
    let trajectory = trajectory();
    let mut stop_at_5 = |knot: usize, _: usize| {
        if knot == 5 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let outcome = fly(
        &trajectory,
        &mut OpenLoop::new(&trajectory),
        Limits::default(),
        &mut TestVehicle::new(),
        1,
        &mut stop_at_5,
    )
    .unwrap();
    assert_eq!(reason(&outcome), Reason::Operator);
}

#[test]
fn bad_controllers_end_the_flight() {
    struct Bad(Proposal);
    impl Controller for Bad {
        fn propose(&mut self, tick: &Tick) -> Proposal {
            if tick.knot < 10 {
                Proposal::Command([0.0, 0.0, 1.5])
            } else {
                self.0
            }
        }
    }
    for (proposal, expected, rows) in [
        (Proposal::Late, Reason::ControllerLate, 11),
        (Proposal::Failed, Reason::ControllerFailed, 10),
        (
            Proposal::Command([0.0, f64::NAN, 1.5]),
            Reason::CommandNotFinite,
            10,
        ),
    ] {
        let outcome = fly_it(&mut Bad(proposal), &mut TestVehicle::new());
        assert_eq!(reason(&outcome), expected);
        let End::Aborted { t_s, .. } = outcome.end else {
            panic!()
        };
        assert!((t_s - rows as f64 * DT).abs() < 1e-9);
        assert!(
            outcome
                .flight
                .samples
                .iter()
                .all(|sample| sample.command.iter().all(|u| u.is_finite()))
        );
    }
}

#[test]
fn bad_limits_and_a_start_outside_the_room_are_refused_before_the_flight() {
    let trajectory = trajectory();
    let refused = |limits: Limits| {
        fly(
            &trajectory,
            &mut OpenLoop::new(&trajectory),
            limits,
            &mut TestVehicle::new(),
            1,
            &mut |_, _| ControlFlow::Continue(()),
        )
        .unwrap_err()
        .to_string()
    };
    assert!(
        refused(Limits {
            hold_s: f64::NAN,
            ..Limits::default()
        })
        .contains("hold_s")
    );
    let mut low = Limits::default();
    low.room.quadrotor_z_m = [0.5, 1.2];
    assert!(refused(low).contains("expected both in the room"));
}
