//! The receding horizon as a [`Controller`]: estimate, compensate the delay, solve, command.

use super::active_set::{Budget, QpReport};
use super::horizon::{Horizon, Start, Window};
use super::options::{MpcError, MpcOptions, limits, scale_for_wind};
use super::plan::LinearizedPlan;
use crate::control::estimator::{DOUBT, Estimator};
use crate::control::supervisor::Room;
use crate::control::{Controller, Proposal, Tick, Trajectory};
use crate::flight::{ControlStep, StepReport, StepStatus};
use crate::link::Observation;
use crate::model::ScheduledModel;
use crate::trajopt::Dynamics;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// [`Estimator::inconsistency`] up to which a model is trusted; at twice it, where every flight begins, not at all. Models of the vehicle that is flown were
/// seen to stay below 2, in sudden wind too; those of others reached 6 to 13 within 0.4 s.
const TRUSTED_INCONSISTENCY: f64 = DOUBT / 2.0;

/// Model-predictive control along a plan.
#[derive(Debug, Clone)]
pub struct ModelPredictive<'a> {
    plan: LinearizedPlan,
    estimator: Estimator<'a>,
    horizon: Horizon,
    /// Of the weights on commands.
    command_scales: Vec<f64>,
    /// See [`MpcOptions`].
    command_deviation_max_m: f64,
    trusted_error_m: f64,
    /// Time for one step's quadratic program, if it is limited.
    time_limit: Option<Duration>,
    /// Budgets of steps that were cut short in the recorded flight that is to be repeated.
    recorded_changes: BTreeMap<usize, usize>,
    /// z at the knot from which on the next command acts (n).
    state: Vec<f64>,
    /// What steady disturbances and gusts add to a step's fresh entries.
    push: Vec<f64>,
    gust: Vec<f64>,
    report: Option<StepReport>,
}

impl<'a> ModelPredictive<'a> {
    /// Prepares to fly `trajectory`, planned on `model`, with the tip at `end_effector` (one position per knot, m),
    /// commands within the trajectory's bounds, and everything inside `room`.
    ///
    /// # Errors
    /// Bad options, or a model that cannot be estimated or controlled.
    pub fn new(
        trajectory: &Trajectory,
        model: &'a ScheduledModel,
        end_effector: &[[f64; 3]],
        room: &Room,
        options: &MpcOptions,
    ) -> Result<Self, MpcError> {
        options.validate()?;
        if end_effector.len() != trajectory.knots() {
            return Err(MpcError::Reference {
                found: end_effector.len(),
                expected: trajectory.knots(),
            });
        }
        let noise = options.noise.unwrap_or(*model.noise());
        let start_command = trajectory.start().0;
        let estimator = Estimator::new(model, &noise, trajectory.state(0), start_command)?;
        let limits = limits(trajectory, room, options);
        let bounded: Vec<usize> = limits.states.iter().map(|bound| bound.index).collect();
        let weights = options.weights(model);
        let command_scales = options.command_scales(model);
        let plan = LinearizedPlan::new(
            trajectory,
            model,
            end_effector,
            &weights,
            &command_scales,
            options.stages,
            &bounded,
        )?;
        let fresh = model.fresh_len();
        Ok(Self {
            horizon: Horizon::new(plan.stage(), options.stages, weights, limits),
            plan,
            command_scales,
            estimator,
            command_deviation_max_m: options.command_deviation_max_m,
            trusted_error_m: options.trusted_error_m,
            time_limit: None,
            recorded_changes: BTreeMap::new(),
            state: trajectory.state(0).to_vec(),
            push: vec![0.0; fresh],
            gust: vec![0.0; fresh],
            report: None,
        })
    }

    /// Answers after `limit` at the latest, with the best commands found until then.
    pub fn with_time_limit(mut self, limit: Duration) -> Self {
        self.time_limit = Some(limit);
        self
    }

    /// Begins with the trust in the model that an earlier flight ended with: its [`Estimator::inconsistency`].
    pub fn with_inconsistency(mut self, inconsistency: f64) -> Self {
        self.estimator = self.estimator.with_inconsistency(inconsistency);
        self
    }

    /// Repeats a recorded flight: begins with the trust that it began with, and stops each quadratic program that was cut
    /// short in it after as many changes as there.
    pub fn with_recorded_steps(mut self, steps: &[ControlStep]) -> Self {
        if let Some(first) = steps.first().filter(|step| step.row == 0) {
            self = self.with_inconsistency(first.report.inconsistency);
        }
        let cut_short = steps
            .iter()
            .filter(|step| step.report.status == StepStatus::BudgetSpent);
        self.recorded_changes = cut_short.map(|step| (step.row, step.report.changes)).collect();
        self
    }

    /// The estimator.
    pub fn estimator(&self) -> &Estimator<'a> {
        &self.estimator
    }

    /// How far commands may be from the plan's: the less, the farther the end effector is from where it should be a knot
    /// later, and the worse the model has foreseen the poses lately. A model that is so wrong must not fly the vehicle, and
    /// the plan alone is stable.
    fn trusted_deviation(&self, window: Option<&Window<'_>>) -> f64 {
        let reference = window.map_or(&self.state[..], |window| window.state_reference);
        let error = |axis: usize| self.state[axis] - reference[axis];
        let error_m = (6..9).map(|axis| error(axis).powi(2)).sum::<f64>().sqrt();
        let shares = [
            2.0 - error_m / self.trusted_error_m,
            2.0 - self.estimator.inconsistency() / TRUSTED_INCONSISTENCY,
        ];
        // NaN is trusted with nothing.
        if shares.iter().all(|share| *share > 0.0) {
            self.command_deviation_max_m * shares[0].min(shares[1]).min(1.0)
        } else {
            0.0
        }
    }

    fn budget(&self, knot: usize) -> Budget {
        Budget {
            changes: self.recorded_changes.get(&knot).copied().unwrap_or(usize::MAX),
            deadline: self.time_limit.map(|limit| Instant::now() + limit),
        }
    }
}

impl Controller for ModelPredictive<'_> {
    fn prepare(&mut self, hovering: &Observation) {
        self.estimator.settle(hovering);
    }

    fn propose(&mut self, tick: &Tick) -> Proposal {
        let budget = self.budget(tick.knot);
        self.estimator.update(tick);
        let (delay, delay_deviation) = self.estimator.delay_knots();
        let lateness = self
            .estimator
            .foresee(tick.knot, &mut self.state, &mut self.push, &mut self.gust);
        let mut command = tick.held_command;
        let mut solved = QpReport {
            status: StepStatus::Optimal,
            changes: 0,
            active: 0,
            residual: 0.0,
        };
        let dynamics = self.estimator.surrounded(tick.knot);
        let scale = scale_for_wind(self.estimator.surroundings().wind_m_s, &self.command_scales);
        // Commands that would act after the plan's end no longer matter.
        let window = self.plan.window(tick.knot + lateness.whole, &dynamics, scale);
        let deviation_m = self.trusted_deviation(window.as_ref());
        if let Some(window) = &window {
            let start = Start {
                state: &self.state,
                held_command: &tick.held_command,
                disturbance: &self.push,
                gust: &self.gust,
                decay: self.estimator.gust_decay(),
                delay: lateness.fraction,
                command_deviation: deviation_m,
            };
            solved = self.horizon.solve(window, &start, budget);
            command.copy_from_slice(&self.horizon.commands()[..3]);
        }
        // The horizon kept its distance from the command that the plan has where this one begins to act; a wrong model is
        // wrong about that, too.
        for (entry, planned) in command.iter_mut().zip(self.plan.command(tick.knot)) {
            *entry = entry.clamp(planned - deviation_m, planned + deviation_m);
        }
        self.report = Some(StepReport {
            status: solved.status,
            changes: solved.changes,
            active: solved.active,
            residual: solved.residual,
            delay_knots: delay,
            delay_deviation_knots: delay_deviation,
            inconsistency: self.estimator.inconsistency(),
            surroundings: self.estimator.surroundings(),
        });
        Proposal::Command(command)
    }

    fn report(&self) -> Option<StepReport> {
        self.report
    }
}
