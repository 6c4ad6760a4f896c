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

use super::{Dynamics, Equality, Problem, StateBound};
use crate::kernel;

/// A model that also says how much the command changes.
#[derive(Debug, Clone)]
pub struct WithCommandChange<D> {
    dynamics: D,
    /// Lengths n, m and fresh of the model.
    state: usize,
    command: usize,
    fresh: usize,
}

/// What an entry of the joined state is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// Entry i of the model's state.
    State(usize),
    /// The command before, along this axis.
    Command(usize),
    /// Its change, along this axis.
    Change(usize),
}

impl<D: Dynamics> WithCommandChange<D> {
    /// Joins command and change to the state of `dynamics`, whose state is a whole number of lags.
    pub fn new(dynamics: D) -> Self {
        let (state, command, fresh) = (dynamics.state_len(), dynamics.command_len(), dynamics.fresh_len());
        debug_assert_eq!(state % fresh, 0, "whole lags");
        Self {
            dynamics,
            state,
            command,
            fresh,
        }
    }

    /// Entries of one lag.
    fn block(&self) -> usize {
        self.fresh + 2 * self.command
    }

    /// Entry of the joined state for entry i of the model's.
    fn index(&self, i: usize) -> usize {
        i / self.fresh * self.block() + i % self.fresh
    }

    fn gather(&self, joined: &[f64]) -> Vec<f64> {
        (0..self.state).map(|i| joined[self.index(i)]).collect()
    }

    /// What entry `index` of the joined state is.
    pub fn entry(&self, index: usize) -> Entry {
        let (lag, place) = (index / self.block(), index % self.block());
        match place.checked_sub(self.fresh) {
            None => Entry::State(lag * self.fresh + place),
            Some(axis) if axis < self.command => Entry::Command(axis),
            Some(axis) => Entry::Change(axis - self.command),
        }
    }

    /// The model's own states (N × n) out of the joined ones.
    pub fn own_states(&self, joined: &[f64]) -> Vec<f64> {
        joined
            .chunks_exact(self.state_len())
            .flat_map(|state| self.gather(state))
            .collect()
    }

    /// `problem` with a cost of `weight` on the square of every entry of every change, none larger than `largest`
    /// (+∞ for no limit). The command before the first is `before` (m).
    pub fn pose(&self, problem: &Problem, before: &[f64], weight: f64, largest: f64) -> Problem {
        let (n, block) = (self.state_len(), self.block());
        let mut start = vec![0.0; n];
        let mut state_weight = vec![0.0; n];
        let mut state_reference = vec![0.0; problem.knots * n];
        for i in 0..self.state {
            start[self.index(i)] = problem.start[i];
            state_weight[self.index(i)] = problem.state_weight[i];
            for knot in 0..problem.knots {
                state_reference[knot * n + self.index(i)] = problem.state_reference[knot * self.state + i];
            }
        }
        for lag in start.chunks_exact_mut(block) {
            lag[self.fresh..][..self.command].copy_from_slice(before);
        }
        let change = self.fresh + self.command;
        state_weight[change..][..self.command].fill(weight);
        let mut state_bounds: Vec<StateBound> = problem
            .state_bounds
            .iter()
            .map(|bound| StateBound {
                index: self.index(bound.index),
                ..bound.clone()
            })
            .collect();
        if largest.is_finite() {
            state_bounds.extend((0..self.command).map(|axis| StateBound {
                first_knot: 1,
                last_knot: problem.knots - 1,
                index: change + axis,
                lower: -largest,
                upper: largest,
                price: f64::INFINITY,
            }));
        }
        let joined = |equality: &Equality| Equality {
            index: self.index(equality.index),
            ..equality.clone()
        };
        Problem {
            start,
            state_reference,
            state_weight,
            state_bounds,
            equalities: problem.equalities.iter().map(joined).collect(),
            ..problem.clone()
        }
    }
}

impl<D: Dynamics> Dynamics for WithCommandChange<D> {
    fn state_len(&self) -> usize {
        self.state / self.fresh * self.block()
    }

    fn command_len(&self) -> usize {
        self.command
    }

    fn fresh_len(&self) -> usize {
        self.block()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let (own, joined) = fresh.split_at_mut(self.fresh);
        self.dynamics.step(knot, &self.gather(state), command, own);
        self.write_change(state, command, joined);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let mut fresh = vec![0.0; self.block()];
        self.linearize(knot, state, command, &mut fresh, jacobian);
    }

    fn linearize(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let (n, m) = (self.state_len(), self.command);
        let (next, joined) = fresh.split_at_mut(self.fresh);
        self.write_change(state, command, joined);
        let mut own = vec![0.0; self.fresh * (self.state + m)];
        self.dynamics
            .linearize(knot, &self.gather(state), command, next, &mut own);
        jacobian.fill(0.0);
        let rows = jacobian.chunks_exact_mut(n + m);
        for (row, own) in rows.zip(own.chunks_exact(self.state + m)) {
            for (i, &entry) in own[..self.state].iter().enumerate() {
                row[self.index(i)] = entry;
            }
            row[n..].copy_from_slice(&own[self.state..]);
        }
        for axis in 0..m {
            let (command, change) = (self.fresh + axis, self.fresh + m + axis);
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
        let own_len = self.state + self.command;
        let own_stride = kernel::padded(own_len);
        let mut own = vec![0.0; own_len * own_stride];
        self.dynamics.add_curvature(
            knot,
            &self.gather(state),
            command,
            &adjoint[..self.fresh],
            own_stride,
            &mut own,
        );
        let index = |i: usize| match i.checked_sub(self.state) {
            None => self.index(i),
            Some(axis) => self.state_len() + axis,
        };
        for (i, row) in own.chunks_exact(own_stride).enumerate() {
            for (j, entry) in row[..own_len].iter().enumerate() {
                hessian[index(i) * stride + index(j)] += entry;
            }
        }
    }
}

impl<D: Dynamics> WithCommandChange<D> {
    /// u and u − u⁻.
    fn write_change(&self, state: &[f64], command: &[f64], joined: &mut [f64]) {
        let before = &state[self.fresh..][..self.command];
        let (now, change) = joined.split_at_mut(self.command);
        now.copy_from_slice(command);
        for ((change, u), before) in change.iter_mut().zip(command).zip(before) {
            *change = u - before;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::derivatives::assert_derivatives;
    use crate::trajopt::{Options, Solution, Solver, Status};

    /// `x⁺ = 0.5 x_{k−1} + 0.1 x² + u + 0.2 x u` with two lags.
    struct Toy;

    impl Dynamics for Toy {
        fn state_len(&self) -> usize {
            2
        }

        fn command_len(&self) -> usize {
            1
        }

        fn fresh_len(&self) -> usize {
            1
        }

        fn step(&self, _knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64]) {
            fresh[0] = 0.5 * z[1] + 0.1 * z[0] * z[0] + u[0] + 0.2 * z[0] * u[0];
        }

        fn jacobian(&self, _knot: usize, z: &[f64], u: &[f64], jacobian: &mut [f64]) {
            jacobian.copy_from_slice(&[0.2 * z[0] + 0.2 * u[0], 0.5, 1.0 + 0.2 * z[0]]);
        }

        fn add_curvature(
            &self,
            _knot: usize,
            _z: &[f64],
            _u: &[f64],
            adjoint: &[f64],
            stride: usize,
            hessian: &mut [f64],
        ) {
            hessian[0] += 0.2 * adjoint[0];
            hessian[2] += 0.2 * adjoint[0];
            hessian[2 * stride] += 0.2 * adjoint[0];
        }
    }

    fn problem() -> Problem {
        let knots = 8;
        Problem {
            knots,
            start: vec![0.1, 0.1],
            state_reference: vec![0.5; 2 * knots],
            command_reference: vec![0.0; knots - 1],
            state_weight: vec![1.0, 0.5],
            command_weight: vec![0.1],
            command_lower: vec![-2.0],
            command_upper: vec![2.0],
            state_bounds: vec![],
            equalities: vec![Equality {
                knot: 5,
                index: 0,
                value: 0.9,
                price: f64::INFINITY,
            }],
            command_guess: vec![0.0; knots - 1],
        }
    }

    fn solve(weight: f64, largest: f64) -> Solution {
        let joined = WithCommandChange::new(Toy);
        let problem = joined.pose(&problem(), &[0.05], weight, largest);
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
        let problem = problem();
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
    fn entries_are_told_apart() {
        let joined = WithCommandChange::new(Toy);
        let entries: Vec<Entry> = (0..6).map(|index| joined.entry(index)).collect();
        let lag = |i| [Entry::State(i), Entry::Command(0), Entry::Change(0)];
        assert_eq!(entries, [lag(0), lag(1)].concat());
    }
}
