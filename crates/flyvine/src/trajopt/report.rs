//! From the solver's workspace to a [`super::Solution`].

use super::ilqr::{Shape, rollout};
use super::{Dynamics, Solver, Status};

impl<D: Dynamics + ?Sized> Solver<'_, D> {
    /// Fills the solution in; allocates nothing after the first solve.
    pub(super) fn report(&mut self, status: Status) {
        let solution = &mut self.solution;
        solution.status = status;
        solution.iterations = self.progress.iterations;
        solution.factorizations = self.progress.factorizations;
        solution.stationarity = self.progress.stationarity;
        let value = |knot: usize, index: usize| self.trajectory.state(knot)[index];
        solution.max_violation = self.constraints.max_violation(value);
        solution.soft_cost = self.constraints.soft_cost(value);
        solution.cost = rollout::cost(self.problem, &self.trajectory);
        self.constraints.report(value, &mut solution.multipliers);
        self.copy_states();
        self.copy_policy();
        if let Status::GuessDiverges { knot } = status {
            self.forget_from(knot);
        }
    }

    fn copy_states(&mut self) {
        let n = self.shape.state;
        for (knot, state) in self.solution.states.chunks_exact_mut(n).enumerate() {
            state.copy_from_slice(self.trajectory.state(knot));
        }
    }

    fn copy_policy(&mut self) {
        let Shape {
            state: n,
            command: m,
            stride,
            ..
        } = self.shape;
        let (lower, upper) = (&self.problem.command_lower, &self.problem.command_upper);
        for knot in 0..self.shape.steps() {
            let command = self.trajectory.command(knot);
            self.solution.commands[knot * m..][..m].copy_from_slice(command);
            for j in 0..m {
                let gain = &self.policy.gain(knot)[j * stride..][..n];
                self.solution.gains[(knot * m + j) * n..][..n].copy_from_slice(gain);
                let on_bound = command[j] <= lower[j] || command[j] >= upper[j];
                let multiplier = if on_bound {
                    -self.adjoint.gradient(knot)[j]
                } else {
                    0.0
                };
                self.solution.command_multipliers[knot * m + j] = multiplier;
            }
        }
    }

    /// A guess that diverged leaves the problem's command guess and the finite beginning of its rollout: later states
    /// repeat the last finite one, and cost and violation are infinite.
    fn forget_from(&mut self, knot: usize) {
        let n = self.shape.state;
        let finite = |state: &[f64]| state.iter().all(|entry| entry.is_finite());
        let first_bad = (0..knot)
            .find(|&k| !finite(&self.solution.states[k * n..][..n]))
            .unwrap_or(knot);
        for k in first_bad.max(1)..self.shape.knots {
            self.solution.states.copy_within((k - 1) * n..k * n, k * n);
        }
        let (lower, upper) = (&self.problem.command_lower, &self.problem.command_upper);
        for (i, guess) in self.problem.command_guess.iter().enumerate() {
            let j = i % self.shape.command;
            self.solution.commands[i] = guess.clamp(lower[j], upper[j]);
        }
        self.solution.gains.fill(0.0);
        self.solution.command_multipliers.fill(0.0);
        self.solution.multipliers.clear();
        self.solution.cost = f64::INFINITY;
        self.solution.soft_cost = f64::INFINITY;
        self.solution.max_violation = f64::INFINITY;
        self.solution.stationarity = f64::INFINITY;
    }
}
