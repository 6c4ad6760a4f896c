//! A swing replanned in flight, on a vehicle that the plan's model does not quite describe.

mod common;

use flyvine::DT;
use flyvine::control::{Controller, OpenLoop, Proposal, Replanning, Tick, Trajectory};
use flyvine::model::ScheduledModel;
use flyvine::task::{PlanOptions, Swing, make_plan};
use flyvine::trajopt::Dynamics;

/// Speed that the wind adds at every knot, m/s.
const WIND_MPS: [f64; 3] = [0.012, 0.0, 0.006];
/// Where the hidden states of physical models begin with the quadrotor's velocity.
const VELOCITY: usize = 9;

/// The states (N × n) that the model passes in wind, commanded by `controller`.
fn flown(controller: &mut dyn Controller, model: &ScheduledModel, trajectory: &Trajectory) -> Vec<Vec<f64>> {
    let mut states = vec![trajectory.state(0).to_vec()];
    let mut held_command = trajectory.start().0;
    controller.prepare(&common::observed(0, &states[0]));
    for knot in 0..trajectory.knots() - 1 {
        let z = &states[knot];
        let tick = Tick {
            knot,
            observation: common::observed(knot, z),
            held_command,
        };
        let Proposal::Command(command) = controller.propose(&tick) else {
            panic!("knot {knot}: no command");
        };
        held_command = command;
        let mut next = vec![0.0; model.fresh_len()];
        model.step(knot, z, &command, &mut next);
        for (velocity, wind) in next[VELOCITY..].iter_mut().zip(WIND_MPS) {
            *velocity += wind;
        }
        states.push(next);
    }
    states
}

/// Distance of the end effector from the target at its time, and how far the quadrotor was beyond its limits, both m.
fn judge(states: &[Vec<f64>], swing: &Swing) -> (f64, f64) {
    let at_target = &states[(swing.target_time_s / DT).round() as usize];
    let miss_m = (at_target[6] - swing.target_m[0]).hypot(at_target[8] - swing.target_m[1]);
    let [x_max_m, z_max_m] = swing.quadrotor_limits_m;
    let beyond = |z: &Vec<f64>| (z[0] - x_max_m).max(z[2] - z_max_m);
    (
        miss_m,
        states.iter().map(beyond).fold(f64::NEG_INFINITY, f64::max),
    )
}

#[test]
fn replanning_meets_the_target_inside_the_limits_where_open_loop_does_not() {
    let mut task = common::task("swing_ES.toml");
    task.support = None; // no flights stand behind the prior bank, and its autopilot is too slow for the shipped target
    let swing = Swing {
        target_m: [1.1, 0.9],
        approach_m: [0.06, 0.04],
        ..task.swing.take().unwrap()
    };
    task.swing = Some(swing.clone());
    let plan = make_plan(&task, &common::prior_bank(), &PlanOptions::default()).unwrap();
    let trajectory = Trajectory::of_plan(&plan).unwrap();
    let model = plan.model().unwrap();

    let mut open_loop = OpenLoop::new(&trajectory);
    let (miss_m, beyond_m) = judge(&flown(&mut open_loop, &model, &trajectory), &swing);
    assert!(miss_m > 0.05 && beyond_m > 0.0, "open loop: {miss_m}, {beyond_m}");

    let mut replanning = Replanning::new(&trajectory, &model, plan.problem().unwrap())
        .unwrap()
        .with_command_change(task.command_change);
    let (miss_m, beyond_m) = judge(&flown(&mut replanning, &model, &trajectory), &swing);
    assert!(miss_m < 0.03 && beyond_m < 0.0, "replanned: {miss_m}, {beyond_m}");
}
