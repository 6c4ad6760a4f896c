//! Lag models that take the velocity of the command, as dynamics of the commanded position alone.
//!
//! What is sent is the velocity of the positions themselves ([`Feedforward`](crate::link::Feedforward)), so that it is no
//! input of its own: the state is joined by the command before, u⁻, and
//!
//! ```text
//! (z, u⁻)⁺ = (z⁺, u)   with   x⁺ = f(z, u, (u − u⁻) / Δt)
//! ```
//!
//! All of its n + 3 entries are fresh: nothing is a shifted copy.

use super::lag::{LagModel, MAX_REGRESSOR_LEN, STATE_LEN};
use crate::trajopt::Dynamics;
use crate::{DT, kernel};

/// Axes of a position.
const AXES: usize = 3;

/// `(u, (u − u⁻) / Δt)`
fn inputs(command: &[f64], before: &[f64]) -> [f64; 2 * AXES] {
    std::array::from_fn(|i| match i.checked_sub(AXES) {
        None => command[i],
        Some(axis) => (command[axis] - before[axis]) / DT,
    })
}

/// Length of the state (z, u⁻), all of it fresh.
pub fn state_len(model: &LagModel) -> usize {
    model.state_len() + AXES
}

/// The state one knot later (n + 3).
pub fn step(model: &LagModel, state: &[f64], command: &[f64], fresh: &mut [f64]) {
    let n = model.state_len();
    let (own, before) = state.split_at(n);
    fresh[STATE_LEN..n].copy_from_slice(&own[..n - STATE_LEN]);
    model.step(0, own, &inputs(command, before), &mut fresh[..STATE_LEN]);
    fresh[n..].copy_from_slice(command);
}

/// [`step`], and its Jacobian ((n + 3) × (n + 6)) by (z, u⁻, u). Allocates nothing.
pub fn linearize(model: &LagModel, state: &[f64], command: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
    step(model, state, command, fresh);
    let n = model.state_len();
    let width = n + 2 * AXES;
    let mut own = [0.0; STATE_LEN * MAX_REGRESSOR_LEN];
    let own = &mut own[..STATE_LEN * width];
    let inputs = inputs(command, &state[n..]);
    model.linearize(0, &state[..n], &inputs, &mut fresh[..STATE_LEN], own);
    jacobian.fill(0.0);
    for (row, own) in jacobian.chunks_exact_mut(width).zip(own.chunks_exact(width)) {
        for (i, entry) in own.iter().enumerate() {
            for (variable, share) in variables(n, i) {
                row[variable] += share * entry;
            }
        }
    }
    for entry in STATE_LEN..n {
        jacobian[entry * width + entry - STATE_LEN] = 1.0;
    }
    for axis in 0..AXES {
        jacobian[(n + axis) * width + n + AXES + axis] = 1.0;
    }
}

/// Adds the curvature of [`step`] along `adjoint` to a Hessian over (z, u⁻, u).
pub fn add_curvature(
    model: &LagModel,
    state: &[f64],
    command: &[f64],
    adjoint: &[f64],
    stride: usize,
    hessian: &mut [f64],
) {
    let n = model.state_len();
    let len = n + 2 * AXES;
    let own_stride = kernel::padded(len);
    let mut own = vec![0.0; len * own_stride];
    let inputs = inputs(command, &state[n..]);
    model.add_curvature(
        0,
        &state[..n],
        &inputs,
        &adjoint[..STATE_LEN],
        own_stride,
        &mut own,
    );
    for (i, row) in own.chunks_exact(own_stride).enumerate() {
        for (j, entry) in row[..len].iter().enumerate() {
            for (a, of_a) in variables(n, i) {
                for (b, of_b) in variables(n, j) {
                    hessian[a * stride + b] += of_a * of_b * entry;
                }
            }
        }
    }
}

/// Entry `i` of the model's own (z, u, v) by the variables (z, u⁻, u): which, and how much.
fn variables(n: usize, i: usize) -> impl Iterator<Item = (usize, f64)> {
    let (first, second) = match i.checked_sub(n) {
        None => ((i, 1.0), None),
        Some(axis) if axis < AXES => ((i + AXES, 1.0), None),
        Some(_) => ((i, 1.0 / DT), Some((i - AXES, -1.0 / DT))),
    };
    std::iter::once(first).chain(second)
}

#[cfg(test)]
mod tests {
    use super::super::lag::tests::random_model;
    use super::super::lag::{CommandInputs, HEIGHT_ROW};
    use super::super::{Model, ScheduledModel};
    use super::*;
    use crate::link::Feedforward;
    use crate::trajopt::derivatives::assert_derivatives_within;

    fn model() -> LagModel {
        random_model(2, CommandInputs::PositionAndVelocity, &[0, HEIGHT_ROW], 4)
    }

    fn scheduled() -> ScheduledModel {
        let mut schedule = ScheduledModel::default();
        schedule.push(Model::Lag(model()));
        schedule.with_feedforward(Feedforward::Velocity)
    }

    #[test]
    fn the_velocity_is_the_difference_of_the_commands() {
        let (model, schedule) = (model(), scheduled());
        assert_eq!(
            (schedule.state_len(), schedule.fresh_len(), schedule.command_len()),
            (21, 21, 3)
        );
        let own: Vec<f64> = (0..18).map(|i| 0.3 - 0.02 * i as f64).collect();
        let (before, command) = ([0.1, -0.2, 1.5], [0.15, -0.25, 1.4]);
        let (mut next, mut expected) = ([0.0; 21], [0.0; STATE_LEN]);
        schedule.step(0, &[&own[..], &before].concat(), &command, &mut next);
        model.step(0, &own, &[0.15, -0.25, 1.4, 1.0, -1.0, -2.0], &mut expected);
        for (found, expected) in next.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!((&next[9..18], &next[18..]), (&own[..9], &command[..]));
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let point: Vec<f64> = (0..24).map(|i| 0.01 * (1.7 * i as f64).sin()).collect();
        let adjoint: Vec<f64> = (0..21).map(|i| 0.1 - 0.03 * i as f64).collect();
        assert_derivatives_within(&scheduled(), &point, &adjoint, 1e-6);
    }

    #[test]
    fn models_of_positions_stay_as_they_are() {
        let mut schedule = ScheduledModel::default();
        schedule.push(Model::Lag(random_model(2, CommandInputs::Position, &[], 1)));
        let same = schedule.clone().with_feedforward(Feedforward::Velocity);
        assert_eq!((same.state_len(), same.fresh_len()), (18, 9));
    }
}
