//! The physical model as [`Dynamics`] that a plan can be optimized on.

use super::arm::ArmLength;
use super::error::PhysicalError;
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
/// Least room for the arm below its base, m.
const SHORTEST_ARM_M: f64 = 0.05;

/// Parameters and arm length per knot; knots past the end keep the last ones, without growth.
///
/// The state is the flat layout of [`State`]: its first nine entries are the outputs `x ∈ R⁹`, so a cost on the
/// outputs is a cost on these entries, with zero weight on the hidden rest.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalDynamics {
    parameters: Vec<Parameters<f64>>,
    arms: Vec<ArmLength>,
}

impl PhysicalDynamics {
    /// One entry of each per knot (one entry: constant).
    ///
    /// # Errors
    /// No knot, arrays of different lengths, a parameter outside its bounds, or an arm without length.
    pub fn new(parameters: Vec<Parameters<f64>>, arms: Vec<ArmLength>) -> Result<Self, PhysicalError> {
        if parameters.len() != arms.len() || arms.is_empty() {
            return Err(PhysicalError::Shape {
                what: "arm lengths of the schedule",
                found: arms.len(),
                expected: parameters.len().max(1),
            });
        }
        for (knot, (set, arm)) in parameters.iter().zip(&arms).enumerate() {
            PhysicalError::check_bounds(set)?;
            let shortest_m = set.base_offset + SHORTEST_ARM_M;
            let usable = arm.length_m >= shortest_m && arm.length_m.is_finite() && arm.rate_m_s.is_finite();
            if !usable {
                return Err(PhysicalError::ArmTooShort {
                    knot,
                    length_m: arm.length_m,
                    shortest_m,
                });
            }
        }
        Ok(PhysicalDynamics { parameters, arms })
    }

    /// Parameters and arm at `knot`.
    pub fn at_knot(&self, knot: usize) -> (&Parameters<f64>, ArmLength) {
        let last = self.arms.len() - 1;
        let mut arm = self.arms[knot.min(last)];
        if knot > last {
            arm.rate_m_s = 0.0;
        }
        (&self.parameters[knot.min(last)], arm)
    }
}

impl Dynamics for PhysicalDynamics {
    fn state_len(&self) -> usize {
        STATE_LEN
    }

    fn command_len(&self) -> usize {
        COMMAND_LEN
    }

    fn fresh_len(&self) -> usize {
        STATE_LEN
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let (parameters, arm) = self.at_knot(knot);
        let command = Vector([command[0], command[1], command[2]]);
        step(parameters, arm, &State::from_flat(state), &command).write_flat(fresh);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let (parameters, arm) = self.at_knot(knot);
        let parameters: Parameters<Dual<VARIABLES>> = parameters.lift();
        let variables: [Dual<VARIABLES>; VARIABLES] = std::array::from_fn(|i| {
            let value = if i < STATE_LEN {
                state[i]
            } else {
                command[i - STATE_LEN]
            };
            Dual::variable(value, i)
        });
        let state = State::from_flat(&variables[..STATE_LEN]);
        let command = Vector([
            variables[STATE_LEN],
            variables[STATE_LEN + 1],
            variables[STATE_LEN + 2],
        ]);
        let mut fresh = [Dual::from(0.0); STATE_LEN];
        step(&parameters, arm, &state, &command).write_flat(&mut fresh);
        for (row, entry) in jacobian.chunks_exact_mut(VARIABLES).zip(&fresh) {
            row.copy_from_slice(&entry.gradient);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// States along a lively manoeuvre, with every part of the model in motion.
    fn states(dynamics: &PhysicalDynamics) -> Vec<Vec<f64>> {
        let (parameters, arm) = dynamics.at_knot(0);
        let mut state = vec![0.0; STATE_LEN];
        State::rest(parameters, arm.length_m, [0.0, 0.0, 1.5]).write_flat(&mut state);
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
        let dynamics = PhysicalDynamics::new(vec![Parameters::defaults()], vec![growing]).unwrap();
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

    #[test]
    fn bad_schedules_are_refused() {
        let good = Parameters::defaults();
        let arm = ArmLength::constant(0.7);
        assert!(PhysicalDynamics::new(vec![], vec![]).is_err());
        assert!(PhysicalDynamics::new(vec![good], vec![arm, arm]).is_err());
        assert!(PhysicalDynamics::new(vec![good], vec![ArmLength::constant(0.01)]).is_err());
        assert!(PhysicalDynamics::new(vec![good], vec![ArmLength::constant(f64::NAN)]).is_err());
        let bad = Parameters {
            rate_gain: -1.0,
            ..good
        };
        let error = PhysicalDynamics::new(vec![bad], vec![arm]).unwrap_err();
        assert!(error.to_string().contains("rate_gain"), "{error}");
    }
}
