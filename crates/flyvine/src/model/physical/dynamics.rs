//! The physical model as [`Dynamics`] that a plan can be optimized on.
//!
//! The state is the flat layout of [`State`]: its first nine entries are the outputs `x ∈ R⁹`, so a cost on the
//! outputs is a cost on these entries, with zero weight on the hidden rest. Nothing is a shifted copy.

use super::model::PhysicalModel;
use super::parameters::Parameters;
use super::scalar::Dual;
use super::state::{STATE_LEN, State};
use super::step::step;
use super::vector::Vector;
use crate::trajopt::Dynamics;

/// Number of command entries.
const COMMAND_LEN: usize = 3;
/// Variables of the Jacobian.
const VARIABLES: usize = STATE_LEN + COMMAND_LEN;

impl Dynamics for PhysicalModel {
    fn state_len(&self) -> usize {
        STATE_LEN
    }

    fn command_len(&self) -> usize {
        COMMAND_LEN
    }

    fn fresh_len(&self) -> usize {
        STATE_LEN
    }

    fn step(&self, _knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let command = Vector([command[0], command[1], command[2]]);
        step(&self.parameters, self.arm, &State::from_flat(state), &command).write_flat(fresh);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        self.linearize(knot, state, command, &mut [0.0; STATE_LEN], jacobian);
    }

    fn linearize(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let parameters: Parameters<Dual<VARIABLES>> = self.parameters.lift();
        let variables: [Dual<VARIABLES>; VARIABLES] = std::array::from_fn(|i| {
            let value = if i < STATE_LEN {
                state[i]
            } else {
                command[i - STATE_LEN]
            };
            Dual::variable(value, i)
        });
        let [x, y, z] = [0, 1, 2].map(|i| variables[STATE_LEN + i]);
        let mut next = [Dual::from(0.0); STATE_LEN];
        let state = State::from_flat(&variables[..STATE_LEN]);
        step(&parameters, self.arm, &state, &Vector([x, y, z])).write_flat(&mut next);
        for (entry, (row, value)) in next.iter().zip(jacobian.chunks_exact_mut(VARIABLES).zip(fresh)) {
            row.copy_from_slice(&entry.gradient);
            *value = entry.value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::arm::ArmLength;
    use super::*;

    /// States along a lively manoeuvre, with every part of the model in motion.
    fn states(dynamics: &PhysicalModel) -> Vec<Vec<f64>> {
        let mut state = dynamics.rest_state([0.0, 0.0, 1.5]);
        let mut states = vec![state.clone()];
        for knot in 0..60 {
            let phase = f64::from(knot / 12);
            let command = [
                1.5 * (2.0 * phase).sin(),
                0.8 * phase.cos(),
                1.5 + 0.2 * phase.sin(),
            ];
            let mut next = vec![0.0; STATE_LEN];
            dynamics.step(0, &state, &command, &mut next);
            state = next;
            states.push(state.clone());
        }
        states
    }

    #[test]
    fn jacobian_agrees_with_finite_differences() {
        let growing = ArmLength {
            length_m: 0.8,
            rate_m_s: 0.02,
        };
        let dynamics = PhysicalModel::new(Parameters::defaults(), growing).unwrap();
        let command = [0.9, -0.4, 1.7];
        for state in states(&dynamics).iter().step_by(7) {
            let mut jacobian = vec![0.0; STATE_LEN * VARIABLES];
            dynamics.jacobian(0, state, &command, &mut jacobian);
            for column in 0..VARIABLES {
                let shifted = |by: f64| {
                    let (mut z, mut u) = (state.clone(), command);
                    if column < STATE_LEN {
                        z[column] += by
                    } else {
                        u[column - STATE_LEN] += by
                    }
                    let mut fresh = vec![0.0; STATE_LEN];
                    dynamics.step(0, &z, &u, &mut fresh);
                    fresh
                };
                // Richardson: (8 (f(h) − f(−h)) − (f(2h) − f(−2h))) / 12 h
                let h = 2e-4;
                let [a, b, c, d] = [h, -h, 2.0 * h, -2.0 * h].map(shifted);
                let scale = (0..STATE_LEN)
                    .map(|row| jacobian[row * VARIABLES + column].abs())
                    .fold(1.0, f64::max);
                for row in 0..STATE_LEN {
                    let difference = (8.0 * (a[row] - b[row]) - (c[row] - d[row])) / (12.0 * h);
                    let exact = jacobian[row * VARIABLES + column];
                    assert!(
                        (exact - difference).abs() < 1e-6 * scale,
                        "d fresh[{row}] / d [{column}]: {exact} against {difference}"
                    );
                }
            }
        }
    }
}
