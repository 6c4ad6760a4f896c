//! States joined by further entries in every lag, so that the companion form stays.

use super::{Dynamics, Equality, Problem, StateBound};

/// A model's state (x_k, x_{k−1}, …), every lag of which is joined by entries y: (x_k, y_k, x_{k−1}, y_{k−1}, …).
#[derive(Debug, Clone, Copy)]
pub(super) struct Joined {
    /// Length n of the model's state.
    pub state: usize,
    /// Length m of the command.
    pub command: usize,
    /// Entries of one lag of the model's state.
    pub fresh: usize,
    /// Entries that join each lag.
    pub extra: usize,
}

impl Joined {
    /// Joins `extra` entries to every lag of the state of `dynamics`, which is a whole number of lags.
    pub fn new<D: Dynamics + ?Sized>(dynamics: &D, extra: usize) -> Self {
        let (state, fresh) = (dynamics.state_len(), dynamics.fresh_len());
        debug_assert_eq!(state % fresh, 0, "whole lags");
        Self {
            state,
            command: dynamics.command_len(),
            fresh,
            extra,
        }
    }

    /// Entries of one lag.
    pub fn block(self) -> usize {
        self.fresh + self.extra
    }

    /// Length of the joined state.
    pub fn state_len(self) -> usize {
        self.state / self.fresh * self.block()
    }

    /// Entry of the joined state for entry i of the model's.
    pub fn index(self, i: usize) -> usize {
        i / self.fresh * self.block() + i % self.fresh
    }

    /// Entry (z, u) of the joined problem for entry i of the model's own (z, u).
    pub fn variable(self, i: usize) -> usize {
        match i.checked_sub(self.state) {
            None => self.index(i),
            Some(axis) => self.state_len() + axis,
        }
    }

    /// The model's own state.
    pub fn gather(self, joined: &[f64]) -> Vec<f64> {
        (0..self.state).map(|i| joined[self.index(i)]).collect()
    }

    /// The model's own states (N × n) out of the joined ones.
    pub fn own_states(self, joined: &[f64]) -> Vec<f64> {
        joined
            .chunks_exact(self.state_len())
            .flat_map(|state| self.gather(state))
            .collect()
    }

    /// A name for every entry of the joined state, from those of the model's own (n) and of the joined ones.
    pub fn names(self, own: &[String], joined: &[String]) -> Vec<String> {
        own.chunks_exact(self.fresh)
            .flat_map(|lag| lag.iter().chain(joined).cloned())
            .collect()
    }

    /// `problem` on the joined state: what joins starts as `start` in every lag, and neither costs nor is bounded.
    pub fn pose(self, problem: &Problem, start: &[f64]) -> Problem {
        let n = self.state_len();
        let mut joined = Problem {
            start: vec![0.0; n],
            state_reference: vec![0.0; problem.knots * n],
            state_weight: vec![0.0; n],
            state_bounds: problem
                .state_bounds
                .iter()
                .map(|bound| StateBound {
                    index: self.index(bound.index),
                    ..bound.clone()
                })
                .collect(),
            equalities: problem
                .equalities
                .iter()
                .map(|equality| Equality {
                    index: self.index(equality.index),
                    ..equality.clone()
                })
                .collect(),
            ..problem.clone()
        };
        for lag in joined.start.chunks_exact_mut(self.block()) {
            lag[self.fresh..].copy_from_slice(start);
        }
        for i in 0..self.state {
            joined.start[self.index(i)] = problem.start[i];
            joined.state_weight[self.index(i)] = problem.state_weight[i];
            for knot in 0..problem.knots {
                joined.state_reference[knot * n + self.index(i)] =
                    problem.state_reference[knot * self.state + i];
            }
        }
        joined
    }

    /// Spreads the model's Jacobian (fresh × (n + m)) over the first rows, of length `width`, of the joined one.
    pub fn spread_jacobian(self, own: &[f64], width: usize, joined: &mut [f64]) {
        let rows = joined.chunks_exact_mut(width);
        for (row, own) in rows.zip(own.chunks_exact(self.state + self.command)) {
            for (i, &entry) in own.iter().enumerate() {
                row[self.variable(i)] = entry;
            }
        }
    }

    /// Adds a Hessian over the model's (z, u), whose rows are `own_stride` apart, to the joined one.
    pub fn add_hessian(self, own: &[f64], own_stride: usize, stride: usize, hessian: &mut [f64]) {
        let len = self.state + self.command;
        for (i, row) in own.chunks_exact(own_stride).take(len).enumerate() {
            for (j, entry) in row[..len].iter().enumerate() {
                hessian[self.variable(i) * stride + self.variable(j)] += entry;
            }
        }
    }
}
