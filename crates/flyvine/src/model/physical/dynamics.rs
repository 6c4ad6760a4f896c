//! The physical model as [`Dynamics`] that a plan can be optimized on.
//!
//! The state is the flat layout of [`State`]: its first nine entries are the outputs `x ∈ R⁹`, so a cost on the
//! outputs is a cost on these entries, with zero weight on the hidden rest. Nothing is a shifted copy.

use super::model::PhysicalModel;
use super::parameters::Parameters;
use super::scalar::Dual;
use super::state::{STATE_LEN, State};
use super::step::{step, step_in};
use super::surroundings::{SURROUNDINGS_LEN, Surroundings};
use super::vector::Vector;
use crate::trajopt::Dynamics;

/// Number of command entries.
const COMMAND_LEN: usize = 3;
/// Variables of the Jacobian.
const VARIABLES: usize = STATE_LEN + COMMAND_LEN;
/// Variables of the Jacobian that knows the surroundings, too: more than there are of anything else.
pub const MOST_VARIABLES: usize = VARIABLES + SURROUNDINGS_LEN;

impl PhysicalModel {
    /// [`Dynamics::step`] in moving air and with a load at the tip.
    pub fn step_in(&self, around: &Surroundings, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let set_point = Vector([command[0], command[1], command[2]]);
        let from = State::from_flat(state);
        step_in(&self.parameters, self.arm, around, &from, &set_point).write_flat(fresh);
        self.correct(state, command, fresh);
    }

    /// [`Dynamics::linearize`] there, and the Jacobian by the surroundings ([`STATE_LEN`] × [`SURROUNDINGS_LEN`]) for
    /// those who want it.
    pub fn linearize_in(
        &self,
        around: &Surroundings,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
        mut by_surroundings: Option<&mut [f64]>,
    ) {
        let parameters: Parameters<Dual> = self.parameters.lift();
        let from: [Dual; STATE_LEN] = std::array::from_fn(|i| Dual::variable(state[i], i));
        let set_point = Vector([0, 1, 2].map(|i| Dual::variable(command[i], STATE_LEN + i)));
        let around = around.to_array();
        let around =
            Surroundings::from_array(std::array::from_fn(|i| Dual::variable(around[i], VARIABLES + i)));
        let mut next = [Dual::from(0.0); STATE_LEN];
        let from = State::from_flat(&from);
        step_in(&parameters, self.arm, &around, &from, &set_point).write_flat(&mut next);
        for (i, entry) in next.iter().enumerate() {
            fresh[i] = entry.value;
            let (own, others) = entry.gradient.split_at(VARIABLES);
            jacobian[i * VARIABLES..][..VARIABLES].copy_from_slice(own);
            if let Some(by_surroundings) = by_surroundings.as_deref_mut() {
                by_surroundings[i * SURROUNDINGS_LEN..][..SURROUNDINGS_LEN]
                    .copy_from_slice(&others[..SURROUNDINGS_LEN]);
            }
        }
        self.correct(state, command, fresh);
        if let Some(correction) = &self.correction {
            correction.add_jacobian(jacobian);
        }
    }

    fn correct(&self, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        if let Some(correction) = &self.correction {
            correction.add(self.arm.length_m, state, command, fresh);
        }
    }
}

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
        let set_point = Vector([command[0], command[1], command[2]]);
        step(&self.parameters, self.arm, &State::from_flat(state), &set_point).write_flat(fresh);
        self.correct(state, command, fresh);
    }

    fn linearize(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        self.linearize_in(&Surroundings::calm(), state, command, fresh, jacobian, None);
    }
}

#[cfg(test)]
mod tests {
    use super::super::arm::ArmLength;
    use super::super::correction::Correction;
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
    fn jacobians_agree_with_finite_differences() {
        let growing = ArmLength {
            length_m: 0.8,
            rate_m_s: 0.02,
        };
        let plain = PhysicalModel::new(Parameters::defaults(), growing).unwrap();
        let corrected = PhysicalModel {
            correction: Some(Correction::across_swing(0.03)),
            ..plain.clone()
        };
        let windy = [1.2, -0.8, 0.1, 0.3];
        for (dynamics, around) in [
            (&plain, [0.0; SURROUNDINGS_LEN]),
            (&plain, windy),
            (&corrected, windy),
        ] {
            for state in states(dynamics).iter().step_by(7) {
                let (mut fresh, mut jacobian) = ([0.0; STATE_LEN], [0.0; STATE_LEN * VARIABLES]);
                let mut by_surroundings = [0.0; STATE_LEN * SURROUNDINGS_LEN];
                let (command, at) = ([0.9, -0.4, 1.7], Surroundings::from_array(around));
                dynamics.linearize_in(
                    &at,
                    state,
                    &command,
                    &mut fresh,
                    &mut jacobian,
                    Some(&mut by_surroundings),
                );
                let shifted = |column: usize, by: f64| {
                    let (mut z, mut u, mut a) = (state.clone(), command, around);
                    match column.checked_sub(STATE_LEN) {
                        None => z[column] += by,
                        Some(i) if i < COMMAND_LEN => u[i] += by,
                        Some(i) => a[i - COMMAND_LEN] += by,
                    }
                    let mut fresh = [0.0; STATE_LEN];
                    dynamics.step_in(&Surroundings::from_array(a), &z, &u, &mut fresh);
                    fresh
                };
                assert_eq!(shifted(0, 0.0), fresh);
                // In calm air the arm's drag, quadratic but for a small smooth part, has no difference quotient to
                // compare with at its corner; what wind does is compared in wind.
                let columns = if around == windy {
                    MOST_VARIABLES
                } else {
                    VARIABLES
                };
                for column in 0..columns {
                    let exact: Vec<f64> = match column.checked_sub(VARIABLES) {
                        None => jacobian.iter().skip(column).step_by(VARIABLES).copied().collect(),
                        Some(i) => by_surroundings
                            .iter()
                            .skip(i)
                            .step_by(SURROUNDINGS_LEN)
                            .copied()
                            .collect(),
                    };
                    // Richardson: (8 (f(h) − f(−h)) − (f(2h) − f(−2h))) / 12 h
                    let h = 2e-4;
                    let [a, b, c, d] = [h, -h, 2.0 * h, -2.0 * h].map(|by| shifted(column, by));
                    let scale = exact.iter().map(|entry| entry.abs()).fold(1.0, f64::max);
                    for (row, exact) in exact.iter().enumerate() {
                        let difference = (8.0 * (a[row] - b[row]) - (c[row] - d[row])) / (12.0 * h);
                        assert!(
                            (exact - difference).abs() < 1e-6 * scale,
                            "d fresh[{row}] / d [{column}]: {exact} against {difference}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn calm_surroundings_are_the_model_itself() {
        let dynamics = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
        let command = [0.9, -0.4, 1.7];
        for state in states(&dynamics) {
            let (mut plain, mut calm) = ([0.0; STATE_LEN], [0.0; STATE_LEN]);
            dynamics.step(0, &state, &command, &mut plain);
            dynamics.step_in(&Surroundings::calm(), &state, &command, &mut calm);
            assert_eq!(plain, calm);
        }
    }
}
