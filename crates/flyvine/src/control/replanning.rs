//! Shrinking-horizon replanning for tasks that must be somewhere at one instant: at every knot the constrained problem
//! from the estimated state to the task's end is solved again.

use super::estimator::{Estimator, EstimatorError, Surrounded};
use super::{Controller, Proposal, Tick, Trajectory};
use crate::flight::{StepReport, StepStatus};
use crate::link::Observation;
use crate::model::ScheduledModel;
use crate::task::{CommandChange, Constraints};
use crate::trajopt::{
    Dynamics, Options, Problem, ProblemError, Solver, StateBound, Status, WithCommandChange,
};
use std::time::Duration;

/// Iterations of one replanning: it starts from the last answer.
const ITERATIONS_MAX: usize = 40;
/// Violation up to which a new answer is flown even if the solver would like to go on, m.
const VIOLATION_ACCEPTED_M: f64 = 0.01;
/// By how much bounds on positions are narrowed, m: an answer that may violate them a little, and flies a little otherwise
/// than foreseen, still keeps the task's own. Half as much again as is accepted, since a gust moves a vehicle by millimetres
/// before the next answer acts.
const MARGIN_M: f64 = 1.5 * VIOLATION_ACCEPTED_M;
const VIOLATION_TOLERANCE_M: f64 = 1e-4;
const STATIONARITY_TOLERANCE: f64 = 1e-3;

/// A plan that cannot be replanned in flight.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReplanningError {
    /// The problem does not fit the model.
    #[error(transparent)]
    Problem(#[from] ProblemError),
    /// The model does not suit the estimator.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
}

/// Replans the rest of `problem` at every knot. The commands flown are those of the last answer that kept its
/// constraints; where none is found in time, the one before goes on.
#[derive(Debug, Clone)]
pub struct Replanning<'a> {
    trajectory: &'a Trajectory,
    model: &'a ScheduledModel,
    problem: Problem,
    estimator: Estimator<'a>,
    change: Option<CommandChange>,
    constraints: Constraints,
    time_limit: Option<Duration>,
    /// Commands from the knot on at which the next one acts (flat).
    commands: Vec<f64>,
    /// Knot of the first of them.
    first: usize,
    push: Vec<f64>,
    gust: Vec<f64>,
    report: Option<StepReport>,
}

impl<'a> Replanning<'a> {
    /// Prepares to fly `trajectory`, the solution of `problem` on `model`.
    ///
    /// # Errors
    /// The problem, the trajectory and the model do not belong together.
    pub fn new(
        trajectory: &'a Trajectory,
        model: &'a ScheduledModel,
        mut problem: Problem,
    ) -> Result<Self, ReplanningError> {
        problem.validate(model)?;
        problem.state_bounds.iter_mut().for_each(narrow);
        let noise = *model.noise();
        let estimator = Estimator::new(model, &noise, trajectory.state(0), trajectory.start().0)?;
        let steps = trajectory.knots() - 1;
        Ok(Self {
            trajectory,
            model,
            problem,
            estimator,
            change: None,
            constraints: Constraints::default(),
            time_limit: None,
            commands: (0..steps).flat_map(|knot| trajectory.command(knot)).collect(),
            first: 0,
            push: vec![0.0; model.fresh_len()],
            gust: vec![0.0; model.fresh_len()],
            report: None,
        })
    }

    /// With the cost and the limit of the task on changes of the command.
    pub fn with_command_change(mut self, change: Option<CommandChange>) -> Self {
        self.change = change;
        self
    }

    /// With what the task demands of the whole motion.
    pub(crate) fn with_constraints(mut self, constraints: Constraints) -> Self {
        self.constraints = constraints;
        self
    }

    /// Answers after `limit` at the latest.
    pub fn with_time_limit(mut self, limit: Duration) -> Self {
        self.time_limit = Some(limit);
        self
    }

    /// What is left of the problem from `knot` on, starting from `state`; bounds on a start that is as it is go.
    fn rest_of_problem(&self, knot: usize, state: Vec<f64>) -> Problem {
        let (n, m) = (state.len(), 3);
        let mut rest = Problem {
            knots: self.problem.knots - knot,
            start: state,
            state_reference: self.problem.state_reference[knot * n..].to_vec(),
            command_reference: self.problem.command_reference[knot * m..].to_vec(),
            command_guess: self.commands[(knot - self.first) * m..].to_vec(),
            ..self.problem.clone()
        };
        StateBound::keep_from(&mut rest.state_bounds, knot);
        rest.equalities.retain(|equality| equality.knot > knot);
        for equality in &mut rest.equalities {
            equality.knot -= knot;
        }
        rest
    }

    /// Solves the rest of the problem; false if it is none.
    fn replan(
        &mut self,
        model: Surrounded<'_>,
        knot: usize,
        state: Vec<f64>,
        held_command: [f64; 3],
    ) -> bool {
        let rest = self.rest_of_problem(knot, state);
        self.commands.clone_from(&rest.command_guess);
        self.first = knot;
        let pushed = Pushed {
            model,
            first: knot,
            push: &self.push,
        };
        let options = Options {
            max_iterations: ITERATIONS_MAX,
            violation_tolerance: VIOLATION_TOLERANCE_M,
            stationarity_tolerance: STATIONARITY_TOLERANCE,
            time_limit: self.time_limit,
            ..Options::default()
        };
        let constraints = self.constraints.rest_from(knot);
        let watched = constraints.watch(&pushed);
        let (rest, dynamics): (Problem, &dyn Dynamics) = if constraints.is_empty() {
            (rest, &pushed)
        } else {
            (constraints.pose(&watched, &rest), &watched)
        };
        let joined = WithCommandChange::new(dynamics);
        let (rest, dynamics): (Problem, &dyn Dynamics) = match self.change {
            None => (rest, dynamics),
            Some(CommandChange { weight, max_m }) => {
                let largest = max_m.unwrap_or(f64::INFINITY);
                (joined.pose(&rest, &held_command, weight, largest), &joined)
            }
        };
        let Ok(mut solver) = Solver::new(&rest, dynamics, options) else {
            return false; // the estimate is not finite
        };
        let solution = solver.solve();
        let finite = solution.commands.iter().all(|command| command.is_finite());
        if finite && solution.max_violation <= VIOLATION_ACCEPTED_M {
            self.commands.clone_from(&solution.commands);
        }
        self.report = Some(StepReport {
            status: match solution.status {
                Status::Converged => StepStatus::Optimal,
                Status::IterationLimit | Status::TimeLimit | Status::Stalled => StepStatus::BudgetSpent,
                Status::ProbablyInfeasible | Status::GuessDiverges { .. } => StepStatus::Infeasible,
            },
            changes: solution.iterations,
            active: 0,
            residual: solution.max_violation.max(solution.stationarity),
            delay_knots: self.estimator.delay_knots().0,
            delay_deviation_knots: self.estimator.delay_knots().1,
            inconsistency: self.estimator.inconsistency(),
            surroundings: self.estimator.surroundings(),
        });
        true
    }
}

/// Narrows a bound on a position by [`MARGIN_M`], if it is wide enough for that.
fn narrow(bound: &mut StateBound) {
    let is_position = matches!(bound.index, 0..3 | 6..9); // the quadrotor's, the end effector's
    if is_position && bound.upper - bound.lower > 4.0 * MARGIN_M {
        bound.lower += MARGIN_M;
        bound.upper -= MARGIN_M;
    }
}

impl Controller for Replanning<'_> {
    fn prepare(&mut self, hovering: &Observation) {
        self.estimator.settle(hovering);
    }

    fn propose(&mut self, tick: &Tick) -> Proposal {
        self.estimator.update(tick);
        let mut state = vec![0.0; self.model.state_len()];
        let lateness = self
            .estimator
            .foresee(tick.knot, &mut state, &mut self.push, &mut self.gust);
        // Commands that would act after the plan's end no longer matter.
        let knot = tick.knot + lateness.whole;
        if knot + 1 >= self.trajectory.knots() {
            return Proposal::Command(tick.held_command);
        }
        let model = self.estimator.surrounded(tick.knot);
        if !self.replan(model, knot, state, tick.held_command) {
            return Proposal::Failed;
        }
        let command = std::array::from_fn(|axis| self.commands[axis]);
        Proposal::Command(self.trajectory.clip(command))
    }

    fn report(&self) -> Option<StepReport> {
        self.report
    }
}

/// The model from knot `first` on, with a constant push on its fresh entries.
struct Pushed<'a> {
    model: Surrounded<'a>,
    first: usize,
    push: &'a [f64],
}

impl Dynamics for Pushed<'_> {
    fn state_len(&self) -> usize {
        self.model.state_len()
    }

    fn command_len(&self) -> usize {
        self.model.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.model.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.model.step(self.first + knot, state, command, fresh);
        for (entry, push) in fresh.iter_mut().zip(self.push) {
            *entry += push;
        }
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.model.linearize(self.first + knot, z, u, fresh, jacobian);
        for (entry, push) in fresh.iter_mut().zip(self.push) {
            *entry += push;
        }
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        self.model
            .add_curvature(self.first + knot, z, u, adjoint, stride, hessian);
    }
}
