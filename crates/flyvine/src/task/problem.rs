//! From a task's references to the optimal-control problem on a model.

use super::file::{Motion, Task};
use super::reference::Reference;
use crate::flight::SIGNALS;
use crate::trajopt::{Equality, Problem, StateBound};

/// Length of the measured state x.
const STATE: usize = SIGNALS.len();
/// Where the end-effector position begins in x.
const END_EFFECTOR: usize = 6;

/// Poses `task` as an optimal-control problem.
///
/// * `start` (n): the model's state at rest; its first `9 · lags` entries are x_0 and its lagged copies, the
///   rest, if any, are hidden states, which carry no cost.
/// * `command_reference` ((N−1) × 3): ū, which is also the initial guess.
pub fn pose_problem(
    task: &Task,
    reference: &Reference,
    command_reference: &[[f64; 3]],
    start: &[f64],
    lags: usize,
) -> Problem {
    let knots = reference.end_effector.len();
    let state_len = start.len();
    let weights = task.weights();
    let bounds = task.command_bounds();

    let mut state_weight = vec![0.0; state_len];
    state_weight[..STATE * lags].fill(weights.state);
    state_weight[END_EFFECTOR..STATE].fill(weights.end_effector);

    // z̄_k = (x̄_k, x̄_{k−1}, x̄_{k−2}), with x̄ at rest before the start; attitude reference 0.
    let mut state_reference = vec![0.0; knots * state_len];
    for (knot, row) in state_reference.chunks_exact_mut(state_len).enumerate() {
        for lag in 0..lags {
            let block = &mut row[STATE * lag..STATE * (lag + 1)];
            match knot.checked_sub(lag) {
                Some(past) => {
                    block[..3].copy_from_slice(&reference.quadrotor[past]);
                    block[END_EFFECTOR..].copy_from_slice(&reference.end_effector[past]);
                }
                None => {
                    block[..3].copy_from_slice(&start[..3]);
                    block[END_EFFECTOR..].copy_from_slice(&start[END_EFFECTOR..STATE]);
                }
            }
        }
    }

    let everywhere = |index: usize, lower: Option<f64>, upper: Option<f64>, price: Option<f64>| StateBound {
        first_knot: 1,
        last_knot: knots - 1,
        index,
        lower: lower.unwrap_or(f64::NEG_INFINITY),
        upper: upper.unwrap_or(f64::INFINITY),
        price: price.unwrap_or(f64::INFINITY),
    };
    let index_of = |name: &str| {
        SIGNALS
            .iter()
            .position(|signal| *signal == name)
            .expect("validated signal")
    };
    let mut state_bounds: Vec<StateBound> = task
        .state_bounds
        .iter()
        .map(|bound| everywhere(index_of(&bound.signal), bound.lower, bound.upper, bound.price))
        .collect();
    let mut equalities = Vec::new();
    match task.motion() {
        Motion::Swing(swing) => {
            let [x_limit, z_limit] = swing.quadrotor_limits_m;
            state_bounds.push(everywhere(index_of("qr_x"), None, Some(x_limit), None));
            state_bounds.push(everywhere(index_of("qr_z"), None, Some(z_limit), None));
            // The paper prints z_QR here; its text means the end effector.
            let knot = swing.target_knot();
            let ([x, z], [dx, dz]) = (swing.target_m, swing.approach_m);
            let price = swing.target_price.unwrap_or(f64::INFINITY);
            for (knot, x, z) in [(knot, x, z), (knot - 1, x - dx, z - dz)] {
                equalities.push(Equality {
                    knot,
                    index: index_of("ee_x"),
                    value: x,
                    price,
                });
                equalities.push(Equality {
                    knot,
                    index: index_of("ee_z"),
                    value: z,
                    price,
                });
            }
        }
        Motion::Waypoints(waypoints) => {
            for point in waypoints.points.iter().filter(|point| point.exact) {
                let knot = (point.t_s / crate::DT).round() as usize;
                for (axis, &value) in point.end_effector.iter().enumerate() {
                    equalities.push(Equality {
                        knot,
                        index: END_EFFECTOR + axis,
                        value,
                        price: f64::INFINITY,
                    });
                }
            }
        }
        Motion::Lemniscate(_) | Motion::Deploy(_) => {}
    }

    let commands: Vec<f64> = command_reference
        .iter()
        .flat_map(|command| std::array::from_fn::<f64, 3, _>(|axis| command[axis]))
        .collect();
    let guess = commands.chunks_exact(3).flat_map(|command| {
        std::array::from_fn::<f64, 3, _>(|axis| command[axis].clamp(bounds.lower[axis], bounds.upper[axis]))
    });
    Problem {
        knots,
        start: start.to_vec(),
        state_reference,
        command_guess: guess.collect(),
        command_reference: commands,
        state_weight,
        command_weight: vec![weights.command; 3],
        command_lower: bounds.lower.to_vec(),
        command_upper: bounds.upper.to_vec(),
        state_bounds,
        equalities,
    }
}

/// Asks of the model, wherever `problem` asks for an end effector, what makes up for its error: `error_m` (N × 3) is by
/// how much the end effector was off the model's prediction at every knot.
///
/// What the first `9 · lags` entries of the state are is as for [`pose_problem`].
pub(super) fn make_up_for(problem: &mut Problem, error_m: &[[f64; 3]], lags: usize) {
    let error = |knot: usize, index: usize| match index.checked_sub(END_EFFECTOR) {
        Some(axis) if axis < 3 => error_m[knot][axis],
        _ => 0.0,
    };
    let state_len = problem.start.len();
    for (knot, row) in problem.state_reference.chunks_exact_mut(state_len).enumerate() {
        for (lag, block) in row[..STATE * lags].chunks_exact_mut(STATE).enumerate() {
            for (index, value) in block.iter_mut().enumerate() {
                *value -= error(knot.saturating_sub(lag), index);
            }
        }
    }
    for equality in &mut problem.equalities {
        equality.value -= error(equality.knot, equality.index);
    }
    let bounds = std::mem::take(&mut problem.state_bounds);
    for bound in bounds {
        if !(END_EFFECTOR..STATE).contains(&bound.index) {
            problem.state_bounds.push(bound);
            continue;
        }
        let at = |knot| StateBound {
            first_knot: knot,
            last_knot: knot,
            lower: bound.lower - error(knot, bound.index),
            upper: bound.upper - error(knot, bound.index),
            ..bound
        };
        problem
            .state_bounds
            .extend((bound.first_knot..=bound.last_knot).map(at));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(text: &str) -> Task {
        Task::parse(text, "test").unwrap()
    }

    #[test]
    fn lagged_references_are_shifted_copies() {
        let task = task(
            "name = 'l'\nconfiguration = { length_m = 0.7, pressure_kpa = 0.0 }\n[lemniscate]\nperiod_s = 5.0\nramp_s = 3.0",
        );
        let reference = task.reference();
        let rest = [0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8];
        let commands = vec![[0.0, 0.0, 1.5]; task.knots() - 1];
        let problem = pose_problem(&task, &reference, &commands, &rest.repeat(3), 3);
        assert_eq!(problem.knots, 161);
        let row = |knot: usize| &problem.state_reference[27 * knot..27 * (knot + 1)];
        for knot in 1..161 {
            assert_eq!(row(knot)[9..27], row(knot - 1)[..18]);
        }
        assert_eq!(row(0), rest.repeat(3));
        assert_eq!(
            problem
                .state_weight
                .iter()
                .filter(|weight| **weight == 20.0)
                .count(),
            3
        );
    }

    #[test]
    fn hidden_states_carry_no_cost() {
        let task = task(
            "name = 's'\nconfiguration = { length_m = 0.7, pressure_kpa = 0.0 }\n[swing]\ntarget_m = [1.5, 1.0]",
        );
        let mut start = vec![0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8];
        start.extend([0.0; 20]);
        let commands = vec![[0.0, 0.0, 1.5]; task.knots() - 1];
        let problem = pose_problem(&task, &task.reference(), &commands, &start, 1);
        assert!(problem.state_weight[9..].iter().all(|weight| *weight == 0.0));
        assert_eq!(problem.knots, 50);
        let knots: Vec<usize> = problem.equalities.iter().map(|equality| equality.knot).collect();
        assert_eq!(knots, [25, 25, 24, 24]);
        assert_eq!(problem.state_bounds.len(), 2);
    }

    #[test]
    fn what_makes_up_for_an_error_is_as_far_off_the_other_way() {
        let task = task(
            "name = 's'\nconfiguration = { length_m = 0.7, pressure_kpa = 0.0 }\n\
             [[state_bounds]]\nsignal = 'ee_z'\nlower = 0.3\n[swing]\ntarget_m = [1.5, 1.0]",
        );
        let rest = [0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8];
        let commands = vec![[0.0, 0.0, 1.5]; task.knots() - 1];
        let asked = pose_problem(&task, &task.reference(), &commands, &rest.repeat(2), 2);
        let error: Vec<[f64; 3]> = (0..task.knots())
            .map(|knot| [0.01 * knot as f64, 0.0, -0.02])
            .collect();
        let mut posed = asked.clone();
        make_up_for(&mut posed, &error, 2);
        let moved = |knot: usize, index: usize| {
            posed.state_reference[18 * knot + index] - asked.state_reference[18 * knot + index]
        };
        assert!((moved(10, 6) + 0.1).abs() < 1e-12 && (moved(10, 15) + 0.09).abs() < 1e-12);
        assert!((moved(10, 8) - 0.02).abs() < 1e-12 && moved(10, 0) == 0.0);
        let values = |problem: &Problem| problem.equalities.iter().map(|e| e.value).collect::<Vec<_>>();
        let expected = [1.5 - 0.25, 1.0 + 0.02, 1.4 - 0.24, 0.9 + 0.02];
        for (found, expected) in values(&posed).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        let floor: Vec<f64> = (posed.state_bounds.iter())
            .filter(|bound| bound.index == 8)
            .map(|bound| bound.lower)
            .collect();
        assert_eq!((floor.len(), floor[0]), (task.knots() - 1, 0.32));
        assert_eq!(posed.start, asked.start);
    }
}
