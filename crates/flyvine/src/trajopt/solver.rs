//! The solver: augmented-Lagrangian differential dynamic programming.
//!
//! Newton's method on the augmented Lagrangian with second derivatives, so the last digits of violation and
//! stationarity come quadratically (superlinearly where the model does not give its own); a Riccati factorization is
//! used again while it still contracts.

use std::time::Instant;

use super::augmented_lagrangian::AugmentedLagrangian;
use super::ilqr::adjoint::Adjoint;
use super::ilqr::backward::{Convexification, Policy};
use super::ilqr::expansion::Expansion;
use super::ilqr::forward::{Accepted, ForwardPass};
use super::ilqr::rollout;
use super::ilqr::{Shape, Trajectory};
use super::{Dynamics, Options, Problem, ProblemError, Solution, Start, Status};

/// A factorization serves again if the last step reduced the stationarity at least to this share, …
const REUSE_CONTRACTION: f64 = 0.1;
/// … and if as many steps like it reach the tolerance: more rollouts would cost more than a factorization.
const REUSE_STEPS: i32 = 2;
/// Stationarity at which the multipliers are updated for the first time.
const FIRST_INNER_TOLERANCE: f64 = 1e-2;
/// Later, the stationarity is reduced to this share of the constraint residual.
const INNER_SHARE: f64 = 0.3;
/// A multiplier update that leaves more than this share of the residual calls for larger penalties.
const RESIDUAL_CONTRACTION: f64 = 0.25;
/// With all penalties at their maximum, an update that leaves more than this share is hopeless.
const HOPELESS_CONTRACTION: f64 = 0.9;

/// Rounding error of a cost per its size, and of a constrained entry per its unit, at the end of a rollout.
const ROUNDING: f64 = 1e-13;
/// Steps in a row whose decrease drowns in rounding, before the multipliers are updated or the search is given up.
const MAX_UNJUDGED_STEPS: usize = 20;

/// Solves one [`Problem`]; everything is allocated at construction, so [`Solver::solve`] can be repeated cheaply.
#[derive(Debug)]
pub struct Solver<'a, D: Dynamics + ?Sized> {
    pub(super) problem: &'a Problem,
    pub(super) dynamics: &'a D,
    pub(super) shape: Shape,
    /// State at knot 0: the problem's, unless replaced.
    pub(super) start: Vec<f64>,
    pub(super) constraints: AugmentedLagrangian,
    pub(super) trajectory: Trajectory,
    pub(super) candidate: Trajectory,
    pub(super) expansion: Expansion,
    pub(super) adjoint: Adjoint,
    pub(super) policy: Policy,
    pub(super) progress: Progress,
    pub(super) solution: Solution,
    options: Options,
}

/// What the solve loop knows about where it is.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    /// J plus multiplier terms of `trajectory`.
    pub merit: f64,
    /// Steps since the merit last decreased by more than its noise, or the multipliers changed.
    unjudged_steps: usize,
    /// J of `trajectory`.
    pub cost: f64,
    pub stationarity: f64,
    /// Stationarity at which the multipliers are updated.
    inner_tolerance: f64,
    /// Constraint residual at the last multiplier update.
    last_residual: f64,
    convexification: Convexification,
    /// Whether the last factorization may serve again.
    reusable: bool,
    pub iterations: usize,
    pub factorizations: usize,
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
            start: problem.start.clone(),
            constraints: AugmentedLagrangian::new(problem),
            trajectory: Trajectory::new(shape),
            candidate: Trajectory::new(shape),
            expansion: Expansion::new(shape, dynamics, &problem.start),
            adjoint: Adjoint::new(shape),
            policy: Policy::new(shape),
            progress: Progress::new(),
            solution: Solution::empty(shape.knots, shape.state, shape.command),
        })
    }

    /// Solves from the problem's command guess.
    pub fn solve(&mut self) -> &Solution {
        self.run(Start::Guess)
    }

    /// Solves from elsewhere: a warm start.
    ///
    /// # Errors
    /// Arrays of the wrong length, or not finite.
    pub fn solve_from(&mut self, start: Start<'_>) -> Result<&Solution, ProblemError> {
        start.validate(self.shape.knots, self.shape.state, self.shape.command)?;
        Ok(self.run(start))
    }

    /// The result of the last solve.
    pub fn solution(&self) -> &Solution {
        &self.solution
    }

    /// Follows these commands ((N−1) × m) as they are: their rollout, and the gains of the linear-quadratic regulator
    /// around it.
    ///
    /// # Errors
    /// As [`Self::solve_from`].
    pub fn regulate(&mut self, commands: &[f64]) -> Result<&Solution, ProblemError> {
        let start = Start::Commands(commands);
        start.validate(self.shape.knots, self.shape.state, self.shape.command)?;
        self.progress = Progress::new();
        self.constraints.reset(self.options.penalty_initial);
        let status = match self.initialize(start) {
            Ok(()) => {
                self.expand();
                self.sweep();
                Status::IterationLimit
            }
            Err(knot) => Status::GuessDiverges { knot },
        };
        self.report(status);
        Ok(&self.solution)
    }

    /// One Riccati factorization without curvature at the last solve's trajectory, and nothing else: what benchmarks
    /// time. False if it is not convex.
    pub fn sweep(&mut self) -> bool {
        self.progress.convexification = Convexification::GAUSS_NEWTON;
        self.factorize()
    }

    fn run(&mut self, start: Start<'_>) -> &Solution {
        let started = Instant::now();
        self.progress = Progress::new();
        if let Some(secant) = &mut self.expansion.secant {
            secant.reset();
        }
        if !matches!(start, Start::Previous) {
            self.constraints.reset(self.options.penalty_initial);
        }
        let status = match self.initialize(start) {
            Ok(()) => self.iterate(started),
            Err(knot) => Status::GuessDiverges { knot },
        };
        self.report(status);
        &self.solution
    }

    fn iterate(&mut self, started: Instant) -> Status {
        self.expand();
        loop {
            if self.progress.stationarity <= self.progress.inner_tolerance {
                match self.update_multipliers() {
                    Some(status) => return status,
                    None => continue,
                }
            }
            if let Some(status) = self.out_of_budget(started) {
                return status;
            }
            let before = self.progress.stationarity;
            if self.progress.unjudged_steps >= MAX_UNJUDGED_STEPS || !self.improve() {
                return self.stalled();
            }
            self.expand();
            self.learn_curvature();
            self.progress.reusable &= self.progress.contracts_enough(before);
        }
    }

    /// Derivatives and stationarity at the trajectory.
    fn expand(&mut self) {
        self.expansion
            .update(self.problem, &self.constraints, &self.trajectory);
        self.adjoint.sweep(&self.trajectory, &self.expansion);
        let norm = self.adjoint.projected_norm(self.problem, &self.trajectory);
        self.progress.stationarity = norm / (1.0 + self.progress.cost.abs());
    }

    /// Where the dynamics do not give their curvature, the last step tells of it; `candidate` is where it began.
    fn learn_curvature(&mut self) {
        if let Some(secant) = &mut self.expansion.secant
            && self.progress.iterations > 0
        {
            secant.update(&self.candidate, &self.trajectory, &self.adjoint);
        }
    }

    /// `y ← ŷ`, and larger penalties if that does not help enough; a status if the problem is solved or hopeless.
    fn update_multipliers(&mut self) -> Option<Status> {
        let residual = self
            .constraints
            .max_residual(|knot, index| self.trajectory.state(knot)[index]);
        self.constraints
            .update_multipliers(|knot, index| self.trajectory.state(knot)[index]);
        let Options {
            stationarity_tolerance,
            violation_tolerance,
            ..
        } = self.options;
        if residual <= violation_tolerance && self.progress.stationarity <= stationarity_tolerance {
            return Some(Status::Converged);
        }
        if residual > RESIDUAL_CONTRACTION * self.progress.last_residual {
            let grown = self
                .constraints
                .grow_penalties(self.options.penalty_growth, self.options.penalty_max);
            self.progress.reusable &= !grown;
            if !grown && residual > HOPELESS_CONTRACTION * self.progress.last_residual {
                return Some(Status::ProbablyInfeasible);
            }
        }
        self.progress.last_residual = residual;
        self.progress.unjudged_steps = 0;
        let wanted = (INNER_SHARE * residual).min(self.progress.inner_tolerance);
        self.progress.inner_tolerance = wanted.max(stationarity_tolerance);
        if self.constraints.is_empty() {
            return None; // neither merit nor derivatives have changed
        }
        self.progress.merit =
            self.progress.cost + rollout::multiplier_terms(&self.constraints, &self.trajectory);
        self.expand();
        self.learn_curvature();
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
    /// trusting of curvature and the more damped the longer none is found. False if there is none.
    fn improve(&mut self) -> bool {
        self.progress.iterations += 1;
        if self.progress.reusable && self.reuse_factorization() && self.search() {
            return true;
        }
        self.progress.convexification.curvature = true;
        while self.progress.convexification.damping <= Convexification::MAX_DAMPING {
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
        let convexification = self.progress.convexification;
        let (trajectory, expansion, adjoint) = (&self.trajectory, &self.expansion, &self.adjoint);
        self.policy
            .factorize(
                self.problem,
                self.dynamics,
                trajectory,
                expansion,
                adjoint,
                convexification,
            )
            .is_ok()
    }

    /// Moves along the policy as far as the merit decreases.
    fn search(&mut self) -> bool {
        let pass = ForwardPass {
            problem: self.problem,
            dynamics: self.dynamics,
            constraints: &self.constraints,
            policy: &self.policy,
            old: &self.trajectory,
        };
        let noise = self.merit_noise();
        let found = pass.line_search(self.progress.merit, noise, &mut self.candidate);
        let Some(Accepted {
            costs,
            step_length,
            decreased,
        }) = found
        else {
            return false;
        };
        self.progress.unjudged_steps = if decreased {
            0
        } else {
            self.progress.unjudged_steps + 1
        };
        std::mem::swap(&mut self.trajectory, &mut self.candidate);
        self.progress.cost = costs.cost;
        self.progress.merit = costs.merit;
        self.progress.reusable = step_length == 1.0;
        if step_length < 1.0 {
            // The line search linearizes along the full step only.
            self.trajectory.linearize(self.dynamics);
        }
        true
    }

    /// What rounding may have added to the merit: smaller changes say nothing.
    fn merit_noise(&self) -> f64 {
        let total_multiplier = self
            .constraints
            .total_multiplier(|knot, index| self.trajectory.state(knot)[index]);
        ROUNDING * (1.0 + self.progress.cost.abs() + total_multiplier)
    }

    /// No step decreases the merit any more: at the limit of floating point, which large penalties reach early.
    fn stalled(&self) -> Status {
        let violation = self
            .constraints
            .max_violation(|knot, index| self.trajectory.state(knot)[index]);
        let large_penalties = self.constraints.max_penalty() >= self.options.penalty_max;
        if violation > self.options.violation_tolerance && large_penalties {
            Status::ProbablyInfeasible
        } else {
            Status::Stalled
        }
    }
}

impl Progress {
    /// Whether the last factorization is worth using again, the stationarity having been `before` the last step.
    fn contracts_enough(&self, before: f64) -> bool {
        let contraction = self.stationarity / before;
        contraction <= REUSE_CONTRACTION
            && self.stationarity * contraction.powi(REUSE_STEPS) <= self.inner_tolerance
    }

    fn new() -> Self {
        Self {
            merit: f64::INFINITY,
            unjudged_steps: 0,
            cost: f64::INFINITY,
            stationarity: f64::INFINITY,
            inner_tolerance: FIRST_INNER_TOLERANCE,
            last_residual: f64::INFINITY,
            convexification: Convexification::NEWTON,
            reusable: false,
            iterations: 0,
            factorizations: 0,
        }
    }
}
