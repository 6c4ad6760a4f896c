//! What a task demands of the whole motion holds in the plan, and does not without being asked for.

mod common;

use flyvine::DT;
use flyvine::model::{Bank, Support};
use flyvine::task::{Plan, PlanOptions, Shape, Task, make_ensemble_plan, make_plan};

/// Least distance of the arm, a straight line in 200 pieces, from the branch of the task, and of the quadrotor.
fn distances(plan: &Plan) -> (f64, f64) {
    let (lower, upper) = ([0.3, 0.15, 0.9], [0.4, 1.5, 1.0]);
    let from_box = |point: [f64; 3]| {
        let outside = |axis: usize| {
            (lower[axis] - point[axis])
                .max(point[axis] - upper[axis])
                .max(0.0)
        };
        (0..3).map(|axis| outside(axis).powi(2)).sum::<f64>().sqrt()
    };
    let ends = plan
        .predicted_quadrotor()
        .into_iter()
        .zip(plan.predicted_end_effector());
    ends.fold((f64::INFINITY, f64::INFINITY), |(arm, quadrotor), (q, e)| {
        let along = (1..=200).map(|piece| {
            let share = f64::from(piece) / 200.0;
            from_box(std::array::from_fn(|axis| q[axis] + share * (e[axis] - q[axis])))
        });
        (along.fold(arm, f64::min), quadrotor.min(from_box(q)))
    })
}

/// Greatest distance of the tip from the tube's axis, and from the wall, in their times.
fn from_axis_and_wall(plan: &Plan) -> (f64, f64) {
    let tip = plan.predicted_end_effector();
    let knots = |from_s: f64, until_s: f64| (from_s / DT).round() as usize..=(until_s / DT).round() as usize;
    let greatest = |range: std::ops::RangeInclusive<usize>, distance: &dyn Fn([f64; 3]) -> f64| {
        range.map(|knot| distance(tip[knot])).fold(0.0, f64::max)
    };
    (
        greatest(knots(4.0, 5.0), &|e| e[1].hypot(e[2] - 0.8)),
        greatest(knots(5.0, 8.0), &|e| (e[0] - 1.0).abs()),
    )
}

fn planned(task: &Task) -> Plan {
    make_plan(task, &common::prior_bank(), &PlanOptions::default()).unwrap()
}

#[test]
fn a_plan_keeps_clear_of_the_branch_and_on_the_wall() {
    let task = common::task("around_branch.toml");
    let free = planned(&Task {
        obstacles: Vec::new(),
        tubes: Vec::new(),
        contacts: Vec::new(),
        ..task.clone()
    });
    let plan = planned(&task);
    for solved in [&free, &plan] {
        assert!(solved.solve.converged, "{:?}", solved.solve);
    }
    let ((arm, quadrotor), (axis, wall)) = (distances(&plan), from_axis_and_wall(&plan));
    // Between the points that the smooth minimum looks at, the arm may be nearer by a hair.
    assert!(
        arm >= 0.2 - 2e-3 && quadrotor >= 0.35 - 1e-6,
        "arm {arm}, quadrotor {quadrotor}"
    );
    assert!(
        axis <= 0.01 + 1e-6 && wall <= 0.005 + 1e-6,
        "axis {axis}, wall {wall}"
    );
    let ((arm, _), (axis, wall)) = (distances(&free), from_axis_and_wall(&free));
    assert!(
        arm < 0.19 && axis > 0.02 && wall > 0.006,
        "arm {arm}, axis {axis}, wall {wall}"
    );
    assert!(plan.solve.cost > free.solve.cost);
    assert_eq!(
        plan.states[0].len(),
        free.states[0].len(),
        "outputs are no part of the plan's states"
    );
}

#[test]
fn an_obstacle_around_the_start_is_refused_by_name() {
    let mut task = common::task("around_branch.toml");
    task.obstacles[0].shape = Shape::Sphere {
        centre_m: [0.1, 0.0, 1.2],
        radius_m: 0.2,
    };
    let error = make_plan(&task, &common::prior_bank(), &PlanOptions::default()).unwrap_err();
    assert!(
        error.to_string().contains("distance from branch at the start"),
        "{error}"
    );
}

#[test]
fn every_member_of_an_ensemble_keeps_clear() {
    let task = common::task("around_branch.toml");
    let banks = [common::prior_bank(), common::prior_bank()];
    let plan = make_ensemble_plan(&task, &banks, &PlanOptions::default()).unwrap();
    let (arm, _) = distances(&plan);
    assert!(arm >= 0.2 - 2e-3, "{arm}");
}

/// Limits that a fast lemniscate passes.
fn support() -> Support {
    Support {
        tilt: 0.15,
        speed_m_s: 1.2,
        arm_angle: 0.5,
        tip_speed_m_s: 2.0,
        command_lead_m: 1.0,
    }
}

/// Σ over knots of the squared share by which the quadrotor's tilt and speed pass their limits.
fn beyond(plan: &Plan) -> f64 {
    let limits = support();
    let over = |value: f64, limit: f64| (value / limit - 1.0).max(0.0).powi(2);
    let tilts = plan
        .states
        .iter()
        .map(|x| over(x[3].hypot(x[4]), (0.5 * limits.tilt).sin()));
    let speeds = plan.states.windows(2).map(|pair| {
        let moved: f64 = (0..3).map(|axis| (pair[1][axis] - pair[0][axis]).powi(2)).sum();
        over(moved.sqrt() / DT, limits.speed_m_s)
    });
    tilts.chain(speeds).sum()
}

#[test]
fn a_plan_stays_near_what_flights_have_shown() {
    let bank: Bank = common::prior_bank().with_support(Some(support())).unwrap();
    let free = common::task("lemniscate_5s_ES.toml");
    let kept = Task {
        support: common::task("swing_ES.toml").support,
        ..free.clone()
    };
    let [free, kept] = [free, kept].map(|task| make_plan(&task, &bank, &PlanOptions::default()).unwrap());
    for plan in [&free, &kept] {
        assert!(plan.solve.converged, "{:?}", plan.solve);
    }
    let (free, kept) = (beyond(&free), beyond(&kept));
    assert!(free > 0.1 && kept < 0.3 * free, "{kept} of {free}");
}

/// A point that commands within their bounds cannot reach in time: the plan says which bounds, moved out, would let them.
#[test]
fn a_plan_that_fails_says_which_bounds_stand_in_the_way() {
    let task = |x_limit: f64| {
        let text = format!(
            "name = 'reach'\nconfiguration = {{ length_m = 0.7, pressure_kpa = 0.0 }}\n\
             [command_bounds]\nlower = [{}, -0.1, 1.4]\nupper = [{x_limit}, 0.1, 1.6]\n\
             [waypoints]\npoints = [\n\
             {{ t_s = 1.5, end_effector = [0.3, 0.0, 0.8], exact = true }},\n\
             {{ t_s = 2.0, end_effector = [0.0, 0.0, 0.8] }} ]",
            -x_limit
        );
        Task::parse(&text, "reach").unwrap()
    };
    let failed = planned(&task(0.1)).solve;
    assert_eq!(failed.status, "probably infeasible");
    let ee_x = failed
        .violated
        .iter()
        .any(|words| words.starts_with("ee_x = 0.3 at knot 30"));
    assert!(ee_x, "{:?}", failed.violated);
    let cmd_x = failed
        .loosened
        .iter()
        .any(|words| words.starts_with("cmd_x") && words.ends_with("the task is solved"));
    assert!(cmd_x, "{:?}", failed.loosened);
    let solved = planned(&task(0.6)).solve;
    assert!(solved.converged && solved.loosened.is_empty(), "{solved:?}");
}

#[test]
fn a_bank_that_does_not_know_its_region_is_refused() {
    let error = make_plan(
        &common::task("swing_ES.toml"),
        &common::prior_bank(),
        &PlanOptions::default(),
    )
    .unwrap_err();
    assert!(error.to_string().contains("[support]"), "{error}");
}

#[test]
fn a_plan_grows_the_arm_as_far_as_it_must() {
    let mut task = common::task("reach_down.toml");
    // The same in less time, by an arm that grows faster.
    task.growth.as_mut().unwrap().max_rate_m_s = 0.06;
    for (point, t_s) in task
        .waypoints
        .as_mut()
        .unwrap()
        .points
        .iter_mut()
        .zip([3.5, 4.5, 5.0])
    {
        point.t_s = t_s;
    }
    let bank = common::prior_bank_of(&[0.7, 1.0]);
    let plan = make_plan(&task, &bank, &PlanOptions::default()).unwrap();
    assert!(plan.solve.converged, "{:?}", plan.solve);
    let lengths: Vec<f64> = plan.configurations.iter().map(|at| at.length_m).collect();
    let fastest = lengths
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).abs() / DT)
        .fold(0.0, f64::max);
    assert!(fastest <= 0.06 + 1e-9, "{fastest} m/s");
    assert_eq!(lengths[0], 0.7);
    // The motion is that of the bank along these lengths: the tip is where it shall be, the quadrotor high enough.
    let knot = (4.5 / DT).round() as usize;
    let (tip, length) = (plan.predicted_end_effector()[knot], lengths[knot]);
    let miss = (tip[0] - 0.8).hypot(tip[1] - 0.2).hypot(tip[2] - 0.45);
    assert!(miss < 1e-6, "{miss}");
    let lowest = plan
        .predicted_quadrotor()
        .iter()
        .map(|q| q[2])
        .fold(f64::INFINITY, f64::min);
    assert!(lowest >= 1.35 - 1e-6, "{lowest}");
    assert!((0.85..0.93).contains(&length), "{length}");

    let ensemble = make_ensemble_plan(&task, &[bank.clone(), bank], &PlanOptions::default());
    assert!(ensemble.unwrap_err().to_string().contains("growth"));
}
