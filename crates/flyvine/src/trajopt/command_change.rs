//! Problems in which it matters how much the command changes from one knot to the next.
//!
//! The state is joined by the command before, u⁻, and by the change that led to it, δ, in every lag, so that the
//! companion form stays:
//!
//! ```text
//! (x, u⁻, δ)⁺ = (f(z, u), u, u − u⁻)
//! ```
//!
//! A weight on δ and bounds on it are then a weight and bounds on a state; what the command is, and its own bounds, do
//! not change.

use super::joined::Joined;
use super::{Dynamics, Problem, StateBound};
use crate::kernel;

/// A model that also says how much the command changes.
#[derive(Debug, Clone)]
pub struct WithCommandChange<D> {
    dynamics: D,
    joined: Joined,
}

impl<D: Dynamics> WithCommandChange<D> {
    /// Joins command and change to the state of `dynamics`, whose state is a whole number of lags.
    pub fn new(dynamics: D) -> Self {
        let joined = Joined::new(&dynamics, 2 * dynamics.command_len());
        Self { dynamics, joined }
    }

    /// A name for every entry of the state, from those of the model's own and of the command's axes.
    pub fn names(&self, own: &[String], axes: &[String]) -> Vec<String> {
        let changes = axes.iter().map(|axis| format!("change of {axis}"));
        let joined: Vec<String> = axes.iter().cloned().chain(changes).collect();
        self.joined.names(own, &joined)
    }

    /// The model's own states (N × n) out of the joined ones.
    pub fn own_states(&self, joined: &[f64]) -> Vec<f64> {
        self.joined.own_states(joined)
    }

    /// `problem` with a cost of `weight` on the square of every entry of every change, none larger than `largest`
    /// (+∞ for no limit). The command before the first is `before` (m).
    pub fn pose(&self, problem: &Problem, before: &[f64], weight: f64, largest: f64) -> Problem {
        let Joined { command, fresh, .. } = self.joined;
        let mut start = before.to_vec();
        start.resize(2 * command, 0.0);
        let mut posed = self.joined.pose(problem, &start);
        let change = fresh + command;
        posed.state_weight[change..][..command].fill(weight);
        if largest.is_finite() {
            posed.state_bounds.extend((0..command).map(|axis| StateBound {
                first_knot: 1,
                last_knot: problem.knots - 1,
                index: change + axis,
                lower: -largest,
                upper: largest,
                price: f64::INFINITY,
            }));
        }
        posed
    }

    /// u and u − u⁻.
    fn write_change(&self, state: &[f64], command: &[f64], joined: &mut [f64]) {
        let before = &state[self.joined.fresh..][..self.joined.command];
        let (now, change) = joined.split_at_mut(self.joined.command);
        now.copy_from_slice(command);
        for ((change, u), before) in change.iter_mut().zip(command).zip(before) {
            *change = u - before;
        }
    }
}

impl<D: Dynamics> Dynamics for WithCommandChange<D> {
    fn state_len(&self) -> usize {
        self.joined.state_len()
    }

    fn command_len(&self) -> usize {
        self.joined.command
    }

    fn fresh_len(&self) -> usize {
        self.joined.block()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let (own, joined) = fresh.split_at_mut(self.joined.fresh);
        self.dynamics.step(knot, &self.joined.gather(state), command, own);
        self.write_change(state, command, joined);
    }

    fn linearize(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let (n, m) = (self.state_len(), self.joined.command);
        let (next, joined) = fresh.split_at_mut(self.joined.fresh);
        self.write_change(state, command, joined);
        let mut own = vec![0.0; self.joined.fresh * (self.joined.state + m)];
        self.dynamics
            .linearize(knot, &self.joined.gather(state), command, next, &mut own);
        jacobian.fill(0.0);
        self.joined.spread_jacobian(&own, n + m, jacobian);
        for axis in 0..m {
            let (command, change) = (self.joined.fresh + axis, self.joined.fresh + m + axis);
            jacobian[command * (n + m) + n + axis] = 1.0;
            jacobian[change * (n + m) + n + axis] = 1.0;
            jacobian[change * (n + m) + command] = -1.0;
        }
    }

    fn add_curvature(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        let own_len = self.joined.state + self.joined.command;
        let own_stride = kernel::padded(own_len);
        let mut own = vec![0.0; own_len * own_stride];
        self.dynamics.add_curvature(
            knot,
            &self.joined.gather(state),
            command,
            &adjoint[..self.joined.fresh],
            own_stride,
            &mut own,
        );
        self.joined.add_hessian(&own, own_stride, stride, hessian);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::derivatives::{Toy, assert_derivatives, toy_problem};
    use crate::trajopt::{Options, Solution, Solver, Status};

    fn solve(weight: f64, largest: f64) -> Solution {
        let joined = WithCommandChange::new(Toy);
        let problem = joined.pose(&toy_problem(), &[0.05], weight, largest);
        let mut solver = Solver::new(&problem, &joined, Options::default()).unwrap();
        let solution = solver.solve().clone();
        assert_eq!(solution.status, Status::Converged);
        solution
    }

    fn largest_change(commands: &[f64]) -> f64 {
        let mut before = 0.05;
        let mut largest: f64 = 0.0;
        for &command in commands {
            largest = largest.max((command - before).abs());
            before = command;
        }
        largest
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let point: Vec<f64> = (0..7).map(|i| 0.3 - 0.1 * i as f64).collect();
        assert_derivatives(&WithCommandChange::new(Toy), &point, &[1.5, -2.0, 0.5]);
    }

    #[test]
    fn without_weight_and_limit_nothing_changes() {
        let problem = toy_problem();
        let mut solver = Solver::new(&problem, &Toy, Options::default()).unwrap();
        let plain = solver.solve();
        let joined = solve(0.0, f64::INFINITY);
        assert!((joined.cost - plain.cost).abs() < 1e-8);
        let states = WithCommandChange::new(Toy).own_states(&joined.states);
        for (found, expected) in states.iter().zip(&plain.states) {
            assert!((found - expected).abs() < 1e-5);
        }
    }

    #[test]
    fn changes_cost_and_keep_their_limit() {
        let free = largest_change(&solve(0.0, f64::INFINITY).commands);
        let costly = largest_change(&solve(3.0, f64::INFINITY).commands);
        assert!(costly < 0.9 * free, "{costly} against {free}");
        let limit = 0.7 * free;
        let limited = largest_change(&solve(0.0, limit).commands);
        assert!((limited - limit).abs() < 1e-6, "{limited} against {limit}");
    }

    #[test]
    fn entries_are_named_lag_by_lag() {
        let own = ["x".to_owned(), "x before".to_owned()];
        let names = WithCommandChange::new(Toy).names(&own, &["u".to_owned()]);
        assert_eq!(names, ["x", "u", "change of u", "x before", "u", "change of u"]);
    }
}
