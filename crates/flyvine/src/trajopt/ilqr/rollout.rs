//! Rolling commands through the dynamics, and what a trajectory costs.

use super::super::augmented_lagrangian::AugmentedLagrangian;
use super::super::{Dynamics, Problem};
use super::Trajectory;

/// What a trajectory costs.
#[derive(Debug, Clone, Copy)]
pub struct Costs {
    /// J.
    pub cost: f64,
    /// J plus the multiplier terms.
    pub merit: f64,
}

/// Rolls the trajectory's own commands out from its first state, and linearizes along it.
///
/// # Errors
/// The first knot whose state is not finite.
pub fn rollout<D: Dynamics + ?Sized>(dynamics: &D, trajectory: &mut Trajectory) -> Result<(), usize> {
    for knot in 0..trajectory.shape.steps() {
        trajectory.advance(dynamics, knot, true);
        if !trajectory.state(knot + 1).iter().all(|entry| entry.is_finite()) {
            return Err(knot + 1);
        }
    }
    Ok(())
}

/// `‖z_k − z̄_k‖²_Q`.
pub fn state_cost(problem: &Problem, knot: usize, state: &[f64]) -> f64 {
    weighted_square(
        state,
        &problem.state_reference[knot * state.len()..],
        &problem.state_weight,
    )
}

/// `‖u_k − ū_k‖²_R`.
pub fn command_cost(problem: &Problem, knot: usize, command: &[f64]) -> f64 {
    weighted_square(
        command,
        &problem.command_reference[knot * command.len()..],
        &problem.command_weight,
    )
}

/// `ψ_k`, the multiplier terms at one knot.
pub fn constraint_cost(constraints: &AugmentedLagrangian, knot: usize, state: &[f64]) -> f64 {
    constraints
        .at(knot)
        .iter()
        .map(|constraint| constraint.cost(state[constraint.index]))
        .sum()
}

/// The problem's cost J.
pub fn cost(problem: &Problem, trajectory: &Trajectory) -> f64 {
    let last = trajectory.shape.steps();
    let running: f64 = (0..last)
        .map(|knot| {
            state_cost(problem, knot, trajectory.state(knot))
                + command_cost(problem, knot, trajectory.command(knot))
        })
        .sum();
    running + state_cost(problem, last, trajectory.state(last))
}

/// `Σ_k ψ_k` at all knots.
pub fn multiplier_terms(constraints: &AugmentedLagrangian, trajectory: &Trajectory) -> f64 {
    (1..trajectory.shape.knots)
        .map(|knot| constraint_cost(constraints, knot, trajectory.state(knot)))
        .sum()
}

/// `Σ w (v − r)²`, in four sums that do not wait for each other.
fn weighted_square(value: &[f64], reference: &[f64], weight: &[f64]) -> f64 {
    const SUMS: usize = 4;
    let mut sums = [0.0; SUMS];
    let (values, last_values) = value.as_chunks::<SUMS>();
    let (references, last_references) = reference[..value.len()].as_chunks::<SUMS>();
    let (weights, last_weights) = weight.as_chunks::<SUMS>();
    for ((value, reference), weight) in values.iter().zip(references).zip(weights) {
        for i in 0..SUMS {
            sums[i] += weight[i] * (value[i] - reference[i]) * (value[i] - reference[i]);
        }
    }
    for i in 0..last_values.len() {
        let error = last_values[i] - last_references[i];
        sums[i] += last_weights[i] * error * error;
    }
    sums.iter().sum()
}
