use super::*;
use crate::flight::StepStatus;
use crate::model::physical::{ArmLength, Parameters, PhysicalModel};
use crate::trajopt::Dynamics;
use nalgebra::DMatrix;

const STAGES: usize = 8;
/// Scales of the weights on commands: one beside the one that is used.
const SCALES: [f64; 2] = [2.0, 0.5];
const USED: usize = 1;

/// A small horizon on the physical model, away from rest.
struct Case {
    model: PhysicalModel,
    stage: Stage,
    weights: TrackingWeights,
    jacobians: Vec<f64>,
    terminal: DMatrix<f64>,
    state: Vec<f64>,
    commands: Vec<f64>,
    disturbance: Vec<f64>,
    delay: f64,
}

impl Case {
    fn new(delay: f64) -> Self {
        let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
        let stage = Stage {
            state: model.state_len(),
            command: 3,
            fresh: model.fresh_len(),
        };
        let n = stage.state;
        let mut state = model.rest_state([0.0, 0.0, 1.5]);
        let mut next = vec![0.0; n];
        for _ in 0..6 {
            model.step(0, &state, &[0.5, -0.3, 1.6], &mut next);
            std::mem::swap(&mut state, &mut next);
        }
        let commands: Vec<f64> = (0..3 * STAGES)
            .map(|i| [0.5, -0.3, 1.6][i % 3] + 0.05 * (i as f64).sin())
            .collect();
        let mut case = Self {
            weights: TrackingWeights {
                state: (0..n).map(|i| if i < 9 { 1.0 + i as f64 } else { 0.0 }).collect(),
                command: vec![0.3; 3],
                command_change: vec![0.7; 3],
            },
            terminal: DMatrix::from_fn(
                n,
                n,
                |i, j| if i == j { 2.0 } else { 0.3 / (1.0 + (i + j) as f64) },
            ),
            disturbance: (0..n).map(|i| 1e-3 * (i as f64).cos()).collect(),
            model,
            stage,
            jacobians: Vec::new(),
            delay,
            state,
            commands,
        };
        case.jacobians = case.jacobians_along();
        case
    }

    /// The command in force at stage j; before the first the held command, zero.
    fn effective(&self, commands: &[f64], j: usize) -> [f64; 3] {
        let older = |axis: usize| j.checked_sub(1).map_or(0.0, |before| commands[3 * before + axis]);
        std::array::from_fn(|axis| (1.0 - self.delay) * commands[3 * j + axis] + self.delay * older(axis))
    }

    fn states(&self, commands: &[f64]) -> Vec<Vec<f64>> {
        let mut states = vec![self.state.clone()];
        for j in 0..STAGES {
            let mut next = vec![0.0; self.stage.state];
            let command = self.effective(commands, j);
            self.model.step(0, states.last().unwrap(), &command, &mut next);
            let pushes = 1.0 + 0.9_f64.powi(j as i32);
            next.iter_mut()
                .zip(&self.disturbance)
                .for_each(|(z, d)| *z += pushes * d);
            states.push(next);
        }
        states
    }

    fn jacobians_along(&self) -> Vec<f64> {
        let (width, stride) = (self.stage.state + 3, self.stage.stride());
        let mut padded = Vec::new();
        let states = self.states(&self.commands);
        for (j, state) in states[..STAGES].iter().enumerate() {
            let mut jacobian = vec![0.0; self.stage.fresh * width];
            let command = self.effective(&self.commands, j);
            self.model.jacobian(0, state, &command, &mut jacobian);
            for row in jacobian.chunks_exact(width) {
                padded.extend_from_slice(row);
                padded.resize(padded.len().next_multiple_of(stride), 0.0);
            }
        }
        padded
    }

    /// The cost by its definition; references are zero, the held command too.
    fn cost(&self, commands: &[f64]) -> f64 {
        let states = self.states(commands);
        let mut cost = 0.0;
        for state in &states[1..] {
            cost += state
                .iter()
                .zip(&self.weights.state)
                .map(|(z, q)| q * z * z)
                .sum::<f64>();
        }
        let last = nalgebra::DVector::from_column_slice(&states[STAGES]);
        cost += (last.transpose() * &self.terminal * &last)[0];
        for i in 0..commands.len() {
            let before = i.checked_sub(3).map_or(0.0, |before| commands[before]);
            cost += SCALES[USED] * (0.3 * commands[i].powi(2) + 0.7 * (commands[i] - before).powi(2));
        }
        cost
    }

    fn limits(&self, bound: f64) -> HorizonLimits {
        HorizonLimits {
            command_lower: vec![-bound; 3],
            command_upper: vec![bound; 3],
            command_change: None,
            states: Vec::new(),
            penalty: 1.0,
        }
    }
}

#[test]
fn the_gradient_is_exact_at_the_linearization_point() {
    for delay in [0.0, 0.3] {
        one_step_is_a_newton_step(Case::new(delay));
    }
}

/// H v = −∇J, with ∇J by central differences. Late commands change the gradient, not H.
fn one_step_is_a_newton_step(case: Case) {
    let condensed = Condensed::new(
        &case.stage,
        &case.jacobians,
        &case.weights,
        &SCALES,
        Some(&case.terminal),
        &[],
    )
    .unwrap();
    let zeros = vec![0.0; STAGES * case.stage.state];
    let mut horizon = Horizon::new(case.stage, STAGES, case.weights.clone(), case.limits(1e3));
    let window = Window {
        dynamics: &case.model,
        knot: 0,
        condensed: &condensed,
        scale: USED,
        jacobians: &case.jacobians,
        state_reference: &zeros,
        command_reference: &zeros[..3 * STAGES],
        reference_before: &[0.0; 3],
        terminal: Some(&case.terminal),
    };
    let start = Start {
        state: &case.state,
        held_command: &[0.0; 3],
        disturbance: &case.disturbance,
        gust: &case.disturbance,
        decay: 0.9,
        delay: case.delay,
        command_deviation: f64::INFINITY,
    };
    horizon.start_from(&case.commands);
    let report = horizon.solve(&window, &start, Budget::NONE);
    assert_eq!((report.status, report.active), (StepStatus::Optimal, 0));
    assert!(report.residual < 1e-10);
    let step: Vec<f64> = horizon
        .commands()
        .iter()
        .zip(&case.commands)
        .map(|(u, before)| u - before)
        .collect();
    let stride = crate::kernel::padded(3 * STAGES);
    let scale = step.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    assert!(scale > 1e-2);
    for i in 0..3 * STAGES {
        let mut moved = case.commands.clone();
        let mut cost = |by: f64| {
            moved[i] = case.commands[i] + by;
            case.cost(&moved)
        };
        let slope = (cost(1e-5) - cost(-1e-5)) / 2e-5;
        let product: f64 = (0..3 * STAGES)
            .map(|j| condensed.hessians[USED].matrix[i * stride + j] * step[j])
            .sum();
        assert!(
            (product + slope).abs() < 1e-5 * (1.0 + slope.abs()),
            "{i}: {product} against {}",
            -slope
        );
    }
}

#[test]
fn the_condensed_hessian_is_that_of_the_linearized_cost() {
    let case = Case::new(0.0);
    let condensed = Condensed::new(
        &case.stage,
        &case.jacobians,
        &case.weights,
        &SCALES,
        Some(&case.terminal),
        &[8],
    )
    .unwrap();
    let (n, stride) = (case.stage.state, crate::kernel::padded(3 * STAGES));
    // ½ vᵀHv is the cost of v on δz⁺ = A δz + B v from zero.
    let v: Vec<f64> = (0..3 * STAGES).map(|i| (1.7 * i as f64).cos()).collect();
    let mut cost = 0.0;
    let mut change = nalgebra::DVector::zeros(n);
    for (j, jacobian) in case.jacobians.chunks_exact(case.stage.jacobian_len()).enumerate() {
        let (a, b) = case.stage.transition(jacobian);
        change = a * change + b * nalgebra::DVector::from_column_slice(&v[3 * j..3 * j + 3]);
        cost += change
            .iter()
            .zip(&case.weights.state)
            .map(|(z, q)| q * z * z)
            .sum::<f64>();
        let soft: f64 = (0..3 * STAGES)
            .map(|i| condensed.soft[j * stride + i] * v[i])
            .sum();
        assert!(
            (soft - change[8]).abs() < 1e-12,
            "sensitivity of the bounded entry at stage {j}"
        );
    }
    cost += (change.transpose() * &case.terminal * &change)[0];
    for i in 0..v.len() {
        let before = i.checked_sub(3).map_or(0.0, |before| v[before]);
        cost += SCALES[USED] * (0.3 * v[i].powi(2) + 0.7 * (v[i] - before).powi(2));
    }
    let mut quadratic = 0.0;
    for i in 0..v.len() {
        for j in 0..v.len() {
            quadratic += 0.5 * v[i] * condensed.hessians[USED].matrix[i * stride + j] * v[j];
        }
    }
    assert!(
        (quadratic - cost).abs() < 1e-10 * cost,
        "{quadratic} against {cost}"
    );
}

#[test]
fn a_horizon_without_command_weight_is_refused() {
    let mut case = Case::new(0.0);
    case.weights = TrackingWeights {
        state: vec![0.0; case.stage.state],
        command: vec![0.0; 3],
        command_change: vec![0.0; 3],
    };
    let refused = Condensed::new(&case.stage, &case.jacobians, &case.weights, &SCALES, None, &[]);
    assert!(matches!(
        refused,
        Err(CondensedError::NotPositiveDefinite { stages: STAGES, .. })
    ));
}

#[test]
fn hard_limits_hold_whatever_the_budget() {
    let case = Case::new(0.0);
    let condensed = Condensed::new(&case.stage, &case.jacobians, &case.weights, &SCALES, None, &[8]).unwrap();
    let limits = HorizonLimits {
        command_change: Some(vec![0.07; 3]),
        states: vec![SoftBound {
            index: 8,
            lower: 0.75,
            upper: f64::INFINITY,
        }],
        penalty: 1e4,
        ..case.limits(0.4)
    };
    let zeros = vec![0.0; STAGES * case.stage.state];
    let cases = [f64::INFINITY, 0.32]
        .into_iter()
        .flat_map(|deviation| [0, 1, 3, usize::MAX].map(|changes| (deviation, changes)));
    for (deviation, changes) in cases {
        let mut horizon = Horizon::new(case.stage, STAGES, case.weights.clone(), limits.clone());
        let window = Window {
            dynamics: &case.model,
            knot: 0,
            condensed: &condensed,
            scale: USED,
            jacobians: &case.jacobians,
            state_reference: &zeros,
            command_reference: &zeros[..3 * STAGES],
            reference_before: &[0.0; 3],
            terminal: None,
        };
        let held = [0.35, -0.3, 0.38];
        let start = Start {
            state: &case.state,
            held_command: &held,
            disturbance: &case.disturbance,
            gust: &case.disturbance,
            decay: 0.9,
            delay: case.delay,
            command_deviation: deviation,
        };
        for _ in 0..3 {
            let budget = Budget {
                changes,
                deadline: None,
            };
            let report = horizon.solve(&window, &start, budget);
            assert_eq!(
                report.status == StepStatus::Optimal,
                changes > 3 || report.changes < changes
            );
            for (i, &command) in horizon.commands().iter().enumerate() {
                let before = i
                    .checked_sub(3)
                    .map_or(held[i % 3], |before| horizon.commands()[before]);
                assert!(command.abs() <= deviation.min(0.4) && (command - before).abs() <= 0.07 + 1e-12);
            }
        }
    }
}
