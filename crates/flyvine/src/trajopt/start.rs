//! Where a solve starts.

use super::ilqr::backward::Convexification;
use super::ilqr::forward::ForwardPass;
use super::ilqr::rollout;
use super::validation::check_array;
use super::{Dynamics, ProblemError, Solver};

/// Where a solve starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start<'a> {
    /// The problem's command guess.
    Guess,
    /// These commands ((N−1) × m), rolled out.
    Commands(&'a [f64]),
    /// These commands, and states (N × n) that they need not lead to: the rollout is steered towards the states by
    /// linear feedback, so an unstable model does not carry it away.
    Trajectory {
        /// States (N × n).
        states: &'a [f64],
        /// Commands ((N−1) × m).
        commands: &'a [f64],
    },
    /// Commands, multipliers and penalties of the last solve.
    Previous,
}

impl Start<'_> {
    pub(super) fn validate(&self, knots: usize, n: usize, m: usize) -> Result<(), ProblemError> {
        match *self {
            Self::Guess | Self::Previous => Ok(()),
            Self::Commands(commands) => check_array("start commands", commands, (knots - 1) * m),
            Self::Trajectory { states, commands } => {
                check_array("start commands", commands, (knots - 1) * m)?;
                check_array("start states", states, knots * n)
            }
        }
    }
}

impl<D: Dynamics + ?Sized> Solver<'_, D> {
    /// Replaces the state at knot 0, for the next solve.
    ///
    /// # Errors
    /// Wrong length, or not finite.
    pub fn set_start(&mut self, start: &[f64]) -> Result<(), ProblemError> {
        check_array("start", start, self.shape.state)?;
        self.start.copy_from_slice(start);
        Ok(())
    }

    /// Makes `trajectory` a rollout from the start; the knot at which it leaves the finite numbers otherwise.
    pub(super) fn initialize(&mut self, start: Start<'_>) -> Result<(), usize> {
        let problem = self.problem;
        match start {
            Start::Previous => self.roll_out(),
            Start::Trajectory { states, commands } => {
                self.set_commands(commands);
                self.steer_towards(states)
                    .or_else(|_| self.roll_out_commands(commands))
            }
            Start::Commands(commands) => self.roll_out_commands(commands),
            Start::Guess => self.roll_out_commands(&problem.command_guess),
        }
    }

    /// An unstable model may carry an open-loop rollout away; then it is steered towards the reference.
    fn roll_out_commands(&mut self, commands: &[f64]) -> Result<(), usize> {
        let problem = self.problem;
        self.set_commands(commands);
        self.roll_out().or_else(|knot| {
            self.set_commands(commands);
            self.steer_towards(&problem.state_reference).map_err(|_| knot)
        })
    }

    fn set_commands(&mut self, commands: &[f64]) {
        let (lower, upper) = (&self.problem.command_lower, &self.problem.command_upper);
        for (knot, commands) in commands.chunks_exact(self.shape.command).enumerate() {
            for (j, entry) in self.trajectory.command_mut(knot).iter_mut().enumerate() {
                *entry = commands[j].clamp(lower[j], upper[j]);
            }
        }
    }

    fn roll_out(&mut self) -> Result<(), usize> {
        self.trajectory.state_mut(0).copy_from_slice(&self.start);
        rollout::rollout(self.dynamics, &mut self.trajectory)?;
        self.progress.cost = rollout::cost(self.problem, &self.trajectory);
        self.progress.merit =
            self.progress.cost + rollout::multiplier_terms(&self.constraints, &self.trajectory);
        if self.progress.merit.is_finite() {
            Ok(())
        } else {
            Err(self.shape.steps())
        }
    }

    /// Rolls `u = u_k + K_k (z − states_k)` out, with K the linear-quadratic regulator along the given states.
    fn steer_towards(&mut self, states: &[f64]) -> Result<(), usize> {
        for (knot, state) in states.chunks_exact(self.shape.state).enumerate() {
            self.trajectory.state_mut(knot).copy_from_slice(state);
        }
        self.trajectory.linearize(self.dynamics);
        self.expansion
            .update(self.problem, &self.constraints, &self.trajectory);
        self.adjoint.clear();
        let (trajectory, expansion, adjoint) = (&self.trajectory, &self.expansion, &self.adjoint);
        let regulator = Convexification::GAUSS_NEWTON;
        self.policy
            .factorize(
                self.problem,
                self.dynamics,
                trajectory,
                expansion,
                adjoint,
                regulator,
            )
            .map_err(|_| 0_usize)?;
        self.candidate.state_mut(0).copy_from_slice(&self.start);
        let pass = ForwardPass {
            problem: self.problem,
            dynamics: self.dynamics,
            constraints: &self.constraints,
            policy: &self.policy,
            old: &self.trajectory,
        };
        let costs = pass
            .closed_loop(0.0, true, &mut self.candidate)
            .ok_or(self.shape.steps())?;
        std::mem::swap(&mut self.trajectory, &mut self.candidate);
        self.progress.cost = costs.cost;
        self.progress.merit = costs.merit;
        Ok(())
    }
}
