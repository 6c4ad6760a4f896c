//! The solver: augmented-Lagrangian differential dynamic programming.

use std::time::Instant;

use super::augmented_lagrangian::AugmentedLagrangian;
use super::ilqr::adjoint::Adjoint;
use super::ilqr::backward::{Convexification, Policy, SweepFailure};
use super::ilqr::expansion::Expansion;
use super::ilqr::forward::{self, Accepted};
use super::ilqr::rollout;
use super::ilqr::{Shape, Trajectory};
use super::{Dynamics, Options, Problem, ProblemError, Solution, Status};

/// Solves one [`Problem`]; everything is allocated at construction, so [`Solver::solve`] can be repeated cheaply.
#[derive(Debug)]
pub struct Solver<'a, D: Dynamics + ?Sized> {
    problem: &'a Problem,
    dynamics: &'a D,
    options: Options,
    shape: Shape,
    constraints: AugmentedLagrangian,
    trajectory: Trajectory,
    candidate: Trajectory,
    expansion: Expansion,
    adjoint: Adjoint,
    policy: Policy,
    progress: Progress,
    solution: Solution,
}

/// What the solve loop knows about where it is.
#[derive(Debug, Clone)]
struct Progress {
    /// J plus multiplier terms of `trajectory`.
    merit: f64,
    cost: f64,
    stationarity: f64,
    /// Stationarity at which the multipliers are updated.
    inner_tolerance: f64,
    /// Constraint residual at the last multiplier update.
    previous_residual: f64,
    convexification: Convexification,
    /// Whether the last factorization may serve again.
    reusable: bool,
    iterations: usize,
    factorizations: usize,
}

impl<'a, D: Dynamics + ?Sized> Solver<'a, D> {
    /// Checks the problem and allocates all memory.
    ///
    /// # Errors
    /// See [`ProblemError`].
    pub fn new(problem: &'a Problem, dynamics: &'a D, options: Options) -> Result<Self, ProblemError> {
        problem.validate(dynamics)?;
        let shape = Shape::new(problem, dynamics);
        Ok(Self {
            problem,
            dynamics,
            options,
            shape,
            constraints: AugmentedLagrangian::new(problem),
            trajectory: Trajectory::new(shape),
            candidate: Trajectory::new(shape),
            expansion: Expansion::new(shape),
            adjoint: Adjoint::new(shape),
            policy: Policy::new(shape),
            progress: Progress::new(),
            solution: Solution::empty(shape.knots, shape.state, shape.command),
        })
    }

    /// Solves from the problem's command guess.
    pub fn solve(&mut self) -> &Solution {
        let started = Instant::now();
        self.constraints.reset(self.options.penalty_initial);
        self.progress = Progress::new();
        let status = match self.start_from_guess() {
            Ok(()) => self.iterate(started),
            Err(knot) => Status::GuessDiverges { knot },
        };
        self.report(status);
        &self.solution
    }

    /// The result of the last solve.
    pub fn solution(&self) -> &Solution {
        &self.solution
    }

    fn iterate(&mut self, started: Instant) -> Status {
        self.expand();
        loop {
            if std::env::var("TRACE").is_ok() {
                eprintln!(
                    "{:4} {:4} merit {:.9} J {:.9} stat {:.2e} res {:.2e} inner {:.1e} {:?} reuse {}",
                    self.progress.iterations,
                    self.progress.factorizations,
                    self.progress.merit,
                    self.progress.cost,
                    self.progress.stationarity,
                    self.residual(),
                    self.progress.inner_tolerance,
                    self.progress.convexification,
                    self.progress.reusable
                );
            }
            if self.progress.stationarity <= self.progress.inner_tolerance {
                if let Some(status) = self.update_multipliers() {
                    return status;
                }
                continue;
            }
            if let Some(status) = self.out_of_budget(started) {
                return status;
            }
            if !self.improve() {
                return Status::Stalled;
            }
            let before = self.progress.stationarity;
            self.expand();
            self.progress.reusable &= self.progress.stationarity <= REUSE_CONTRACTION * before;
        }
    }

    fn start_from_guess(&mut self) -> Result<(), usize> {
        let m = self.shape.command;
        self.trajectory.state_mut(0).copy_from_slice(&self.problem.start);
        for knot in 0..self.shape.steps() {
            for j in 0..m {
                let guess = self.problem.command_guess[knot * m + j];
                self.trajectory.command_mut(knot)[j] =
                    guess.clamp(self.problem.command_lower[j], self.problem.command_upper[j]);
            }
        }
        rollout::rollout(self.dynamics, &mut self.trajectory)?;
        self.progress.merit = rollout::merit(self.problem, &self.constraints, &self.trajectory);
        if self.progress.merit.is_finite() {
            Ok(())
        } else {
            Err(self.shape.steps())
        }
    }

    /// Derivatives and stationarity at the trajectory.
    fn expand(&mut self) {
        self.expansion
            .update(self.problem, &self.constraints, &self.trajectory);
        self.adjoint.sweep(&self.trajectory, &self.expansion);
        self.progress.cost = rollout::cost(self.problem, &self.trajectory);
        let norm = self.adjoint.projected_norm(self.problem, &self.trajectory);
        self.progress.stationarity = norm / (1.0 + self.progress.cost.abs());
    }

    fn residual(&self) -> f64 {
        self.constraints
            .max_residual(|knot, index| self.trajectory.state(knot)[index])
    }

    /// `y ← ŷ`, larger penalties if that does not help enough; a status if the problem is solved or hopeless.
    fn update_multipliers(&mut self) -> Option<Status> {
        let residual = self.residual();
        let converged = residual <= self.options.violation_tolerance;
        if converged && self.progress.stationarity <= self.options.stationarity_tolerance {
            self.constraints
                .update_multipliers(|knot, index| self.trajectory.state(knot)[index]);
            return Some(Status::Converged);
        }
        self.constraints
            .update_multipliers(|knot, index| self.trajectory.state(knot)[index]);
        if residual > 0.25 * self.progress.previous_residual {
            let grown = self
                .constraints
                .grow_penalties(self.options.penalty_growth, self.options.penalty_max);
            self.progress.reusable = false;
            if !grown && residual > 0.9 * self.progress.previous_residual {
                return Some(Status::ProbablyInfeasible);
            }
        }
        self.progress.previous_residual = residual;
        self.progress.inner_tolerance = (INNER_SHARE * residual)
            .clamp(self.options.stationarity_tolerance, self.progress.inner_tolerance);
        self.progress.merit = rollout::merit(self.problem, &self.constraints, &self.trajectory);
        self.expand();
        None
    }

    fn out_of_budget(&self, started: Instant) -> Option<Status> {
        if self.progress.iterations >= self.options.max_iterations {
            return Some(Status::IterationLimit);
        }
        match self.options.time_limit {
            Some(limit) if started.elapsed() >= limit => Some(Status::TimeLimit),
            _ => None,
        }
    }

    /// One step that decreases the merit: with the old factorization if it serves, else with a new one, the less
    /// trusting of curvature and the more damped the longer none is found.
    fn improve(&mut self) -> bool {
        self.progress.iterations += 1;
        if self.progress.reusable && self.reuse_factorization() && self.search() {
            return true;
        }
        self.progress.convexification.curvature = true;
        while self.progress.convexification.damping <= MAX_DAMPING {
            if self.factorize() && self.search() {
                self.progress.convexification.relax();
                return true;
            }
            self.progress.convexification.tighten();
        }
        false
    }

    fn reuse_factorization(&mut self) -> bool {
        self.policy
            .reuse(self.problem, &self.trajectory, &self.adjoint)
            .is_ok()
    }

    fn factorize(&mut self) -> bool {
        self.progress.factorizations += 1;
        let outcome = self.policy.factorize(
            self.problem,
            self.dynamics,
            &self.trajectory,
            &self.expansion,
            &self.adjoint,
            self.progress.convexification,
        );
        !matches!(outcome, Err(SweepFailure::NotPositiveDefinite))
    }

    fn search(&mut self) -> bool {
        let found = forward::line_search(
            self.problem,
            self.dynamics,
            &self.constraints,
            &self.policy,
            &self.trajectory,
            self.progress.merit,
            &mut self.candidate,
        );
        let Some(Accepted { merit, step_length }) = found else {
            self.progress.reusable = false;
            return false;
        };
        std::mem::swap(&mut self.trajectory, &mut self.candidate);
        self.progress.merit = merit;
        if step_length < 1.0 {
            // The line search linearizes along the full step only.
            self.trajectory.linearize(self.dynamics);
        }
        self.progress.reusable = step_length == 1.0;
        true
    }

    fn report(&mut self, status: Status) {
        let Shape {
            knots,
            state: n,
            command: m,
            ..
        } = self.shape;
        let solution = &mut self.solution;
        solution.status = status;
        solution.iterations = self.progress.iterations;
        solution.factorizations = self.progress.factorizations;
        solution.cost = rollout::cost(self.problem, &self.trajectory);
        solution.stationarity = self.progress.stationarity;
        solution.max_violation = self
            .constraints
            .max_violation(|knot, index| self.trajectory.state(knot)[index]);
        self.constraints.report(
            |knot, index| self.trajectory.state(knot)[index],
            &mut solution.multipliers,
        );
        for knot in 0..knots {
            solution.states[knot * n..][..n].copy_from_slice(self.trajectory.state(knot));
        }
        for knot in 0..knots - 1 {
            let command = self.trajectory.command(knot);
            solution.commands[knot * m..][..m].copy_from_slice(command);
            for j in 0..m {
                let row = (knot * m + j) * n;
                solution.gains[row..row + n]
                    .copy_from_slice(&self.policy.gain(knot)[j * self.shape.stride..][..n]);
                let on_bound = command[j] <= self.problem.command_lower[j]
                    || command[j] >= self.problem.command_upper[j];
                solution.command_multipliers[knot * m + j] = if on_bound {
                    -self.adjoint.gradient(knot)[j]
                } else {
                    0.0
                };
            }
        }
    }
}

/// A factorization serves again if the last step reduced the stationarity at least to this share.
const REUSE_CONTRACTION: f64 = 0.1;
/// Between multiplier updates the stationarity is reduced to this share of the constraint residual.
const INNER_SHARE: f64 = 0.1;
/// Damping beyond which the solve has stalled.
const MAX_DAMPING: f64 = 1e8;
/// Smallest damping other than none.
const MIN_DAMPING: f64 = 1e-3;

impl Convexification {
    /// After a failure: first without curvature, then with ever more damping.
    fn tighten(&mut self) {
        if self.curvature {
            self.curvature = false;
        } else {
            self.damping = (10.0 * self.damping).max(MIN_DAMPING);
        }
    }

    /// After a success.
    fn relax(&mut self) {
        self.damping = if self.damping <= MIN_DAMPING {
            0.0
        } else {
            0.1 * self.damping
        };
    }
}

impl Progress {
    fn new() -> Self {
        Self {
            merit: f64::INFINITY,
            cost: f64::INFINITY,
            stationarity: f64::INFINITY,
            inner_tolerance: 1e-2,
            previous_residual: f64::INFINITY,
            convexification: Convexification {
                curvature: true,
                damping: 0.0,
            },
            reusable: false,
            iterations: 0,
            factorizations: 0,
        }
    }
}
