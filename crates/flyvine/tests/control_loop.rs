//! The control loop makes no allocations, from the first tick to the last.

mod common;

use flyvine::control::estimator::EstimatorError;
use flyvine::control::mpc::{LinearizedPlan, ModelPredictive, MpcOptions, TrackingWeights};
use flyvine::control::supervisor::Limits;
use flyvine::control::{Controller, Proposal, Tick, Tracking, Trajectory};
use flyvine::link::Observation;
use flyvine::model::ScheduledModel;
use flyvine::task::{Plan, PlanOptions, make_plan};
use flyvine::trajopt::Dynamics;

fn plan() -> Plan {
    let task = common::task("lemniscate_5s_ES.toml");
    make_plan(&task, &common::prior_bank(), &PlanOptions::default()).unwrap()
}

/// What motion capture sees of the state z: not every frame has the tip.
fn observe(knot: usize, z: &[f64]) -> Observation {
    let seen = common::observed(knot, z);
    Observation {
        end_effector: seen.end_effector.filter(|_| !(40..44).contains(&knot)),
        ..seen
    }
}

/// Flies the model itself under a side wind, and counts the allocations of all ticks but not of the vehicle.
fn allocations(controller: &mut dyn Controller, model: &ScheduledModel, trajectory: &Trajectory) -> u64 {
    let mut z = trajectory.state(0).to_vec();
    let mut fresh = vec![0.0; model.fresh_len()];
    let mut held_command = trajectory.start().0;
    let mut count = 0;
    controller.prepare(&observe(0, &z));
    for knot in 0..trajectory.knots() - 1 {
        let tick = Tick {
            knot,
            observation: observe(knot, &z),
            held_command,
        };
        let mut proposal = Proposal::Failed;
        count += allocation_counter::measure(|| proposal = controller.propose(&tick)).count_total;
        let Proposal::Command(command) = proposal else {
            panic!("knot {knot}: {proposal:?}");
        };
        held_command = command;
        model.step(knot, &z, &command, &mut fresh);
        z.copy_from_slice(&fresh);
        z[9] += 0.01; // velocity along x
    }
    count
}

#[test]
fn ticks_do_not_allocate() -> Result<(), EstimatorError> {
    let plan = plan();
    let trajectory = Trajectory::of_plan(&plan).unwrap();
    let model = plan.model().unwrap();
    let mut tracking = Tracking::new(&trajectory, &model)?;
    assert_eq!(allocations(&mut tracking, &model, &trajectory), 0, "tracking");
    let room = Limits::default().room;
    let mut predictive = ModelPredictive::new(
        &trajectory,
        &model,
        &plan.reference,
        &room,
        &MpcOptions::default(),
    )
    .unwrap();
    assert_eq!(allocations(&mut predictive, &model, &trajectory), 0, "predictive");
    Ok(())
}

#[test]
fn a_plans_first_command_is_no_deviation_from_it() {
    let plan = plan();
    let trajectory = Trajectory::of_plan(&plan).unwrap();
    let model = plan.model().unwrap();
    let weights = TrackingWeights {
        state: vec![1.0; model.state_len()],
        command: vec![1.0; 3],
        command_change: vec![1.0; 3],
    };
    let linearized =
        LinearizedPlan::new(&trajectory, &model, &plan.reference, &weights, &[1.0], 5, &[]).unwrap();
    let before = |knot: usize| {
        linearized
            .window(knot, &model, 0)
            .unwrap()
            .reference_before
            .to_vec()
    };
    // The plan begins with a step away from where the vehicle hovers, and the change of commands is counted from there.
    assert_eq!(before(0), trajectory.start().0);
    assert_eq!(before(1), trajectory.command(0));
    assert_ne!(before(0), before(1));
}
