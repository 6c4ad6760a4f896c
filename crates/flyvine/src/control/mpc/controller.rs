//! The receding horizon as a [`Controller`]: estimate, compensate the delay, solve, command.

use super::active_set::{Budget, QpReport};
use super::condensed::{CondensedError, TrackingWeights};
use super::horizon::{Horizon, HorizonLimits, SoftBound, Start, Window};
use super::plan::LinearizedPlan;
use crate::control::estimator::{Estimator, EstimatorError};
use crate::control::supervisor::Room;
use crate::control::{Controller, Proposal, Tick, Trajectory};
use crate::flight::{ControlStep, StepReport, StepStatus};
use crate::link::Observation;
use crate::model::{Model, NoiseLevels, ScheduledModel};
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Settings of the controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MpcOptions {
    /// Stages of the horizon.
    pub stages: usize,
    /// Weight on the squared distance of the end effector from its reference, 1/m².
    pub end_effector: f64,
    /// Weight on every other entry of the newest pose, from the plan's.
    pub pose: f64,
    /// Weight on the command's deviation from the plan's; without it 5 on lag models, 1 on physical ones, and on those
    /// whose noise was identified 0.1 to 100, by how well they foresee.
    pub command: Option<f64>,
    /// Weight on the change of that deviation from one knot to the next; without it 10, or 0.1 to 100 as
    /// above. Under light weights the horizon relies on the model's fast motions: an arm that bounces along its axis, which
    /// no model knows, has been seen to be shaken up by it.
    pub command_change: Option<f64>,
    /// Largest change of the command from one knot to the next, m.
    pub command_change_max_m: f64,
    /// Greatest distance of the command from the plan's, along each axis, m.
    pub command_deviation_max_m: f64,
    /// Error of the end effector up to which the command may be that far from the plan's, m. Beyond it less and less is
    /// allowed, at twice it nothing: a model that is so wrong must not fly the vehicle, and the plan alone is stable.
    pub trusted_error_m: f64,
    /// How far inside the room's walls the soft bounds are, m.
    pub room_margin_m: f64,
    /// Cost of leaving them, per m².
    pub room_penalty: f64,
    /// Noise levels of the estimator, instead of the bank's.
    pub noise: Option<NoiseLevels>,
}

impl Default for MpcOptions {
    fn default() -> Self {
        Self {
            stages: 25,
            end_effector: 100.0,
            pose: 0.1,
            command: None,
            command_change: None,
            command_change_max_m: 0.5,
            command_deviation_max_m: 0.5,
            trusted_error_m: 0.35,
            room_margin_m: 0.1,
            room_penalty: 1e4,
            noise: None,
        }
    }
}

/// A plan that cannot be flown by model-predictive control.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MpcError {
    /// The horizon is degenerate.
    #[error(transparent)]
    Condensed(#[from] CondensedError),
    /// The model or noise levels do not suit the estimator.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// A setting that is not a number in its range.
    #[error("MPC option {name}: found {found}, expected {expected}")]
    Option {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What would be accepted.
        expected: &'static str,
    },
    /// The reference does not belong to the trajectory.
    #[error("the end-effector reference has {found} knots; expected the trajectory's {expected}")]
    Reference {
        /// Knots of the reference.
        found: usize,
        /// Knots of the trajectory.
        expected: usize,
    },
}

impl MpcOptions {
    fn validate(&self) -> Result<(), MpcError> {
        let positive = [
            ("stages", self.stages as f64),
            ("command", self.command.unwrap_or(1.0)),
            ("command_change_max_m", self.command_change_max_m),
            ("command_deviation_max_m", self.command_deviation_max_m),
            ("trusted_error_m", self.trusted_error_m),
            ("room_penalty", self.room_penalty),
        ];
        let not_negative = [
            ("end_effector", self.end_effector),
            ("pose", self.pose),
            ("command_change", self.command_change.unwrap_or(0.0)),
            ("room_margin_m", self.room_margin_m),
        ];
        for (name, found) in positive {
            // Not `<=`: NaN must fail.
            if !(found > 0.0 && found.is_finite()) {
                let expected = "a positive number";
                return Err(MpcError::Option {
                    name,
                    found,
                    expected,
                });
            }
        }
        for (name, found) in not_negative {
            if !(found >= 0.0 && found.is_finite()) {
                let expected = "a number ≥ 0";
                return Err(MpcError::Option {
                    name,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    fn weights(&self, model: &ScheduledModel) -> TrackingWeights {
        let [command, command_change] = match model.at_knot(0) {
            Model::Lag(_) => [5.0, 10.0],
            Model::Physical(_) => physical_weights(model.identified_noise()),
        };
        let mut state = vec![0.0; model.state_len()];
        state[..6].fill(self.pose);
        state[6..9].fill(self.end_effector);
        TrackingWeights {
            state,
            command: vec![self.command.unwrap_or(command); 3],
            command_change: vec![self.command_change.unwrap_or(command_change); 3],
        }
    }
}

/// Weights on commands and on their changes where nothing says how well a physical model foresees.
const UNKNOWN: [f64; 2] = [1.0, 10.0];
/// Both for a model that foresees well …
const TRUSTING: f64 = 0.1;
/// … and for one that does not: little more than the plan is flown.
const CAUTIOUS: f64 = 100.0;

/// The weights on commands and on their changes that suit a physical model's identified noise: commands that rely on what
/// happens from one knot to the next can be no better than what is foreseen of it.
fn physical_weights(noise: Option<&NoiseLevels>) -> [f64; 2] {
    match noise {
        Some(noise) => [(TRUSTING / noise.trust().powi(2)).min(CAUTIOUS); 2],
        None => UNKNOWN,
    }
}

/// Model-predictive control along a plan.
#[derive(Debug, Clone)]
pub struct ModelPredictive<'a> {
    plan: LinearizedPlan,
    estimator: Estimator<'a>,
    horizon: Horizon,
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
        let plan = LinearizedPlan::new(
            trajectory,
            model,
            end_effector,
            &weights,
            options.stages,
            &bounded,
        )?;
        let fresh = model.fresh_len();
        Ok(Self {
            horizon: Horizon::new(plan.stage(), options.stages, weights, limits),
            plan,
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

    /// Stops each quadratic program that was cut short in a recorded flight after as many changes as there.
    pub fn with_recorded_steps(mut self, steps: &[ControlStep]) -> Self {
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

    /// How far commands may be from the plan's, given where the end effector is and where it should be a knot later.
    fn trusted_deviation(&self, window: &Window<'_>) -> f64 {
        let error = |axis: usize| self.state[axis] - window.state_reference[axis];
        let error_m = (6..9).map(|axis| error(axis).powi(2)).sum::<f64>().sqrt();
        let share = 2.0 - error_m / self.trusted_error_m;
        // NaN is trusted with nothing.
        if share > 0.0 {
            self.command_deviation_max_m * share.min(1.0)
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
        // Commands that would act after the plan's end no longer matter.
        if let Some(window) = self.plan.window(tick.knot + lateness.whole, &dynamics) {
            let start = Start {
                state: &self.state,
                held_command: &tick.held_command,
                disturbance: &self.push,
                gust: &self.gust,
                decay: self.estimator.gust_decay(),
                delay: lateness.fraction,
                command_deviation: self.trusted_deviation(&window),
            };
            solved = self.horizon.solve(&window, &start, budget);
            command.copy_from_slice(&self.horizon.commands()[..3]);
        }
        self.report = Some(StepReport {
            status: solved.status,
            changes: solved.changes,
            active: solved.active,
            residual: solved.residual,
            delay_knots: delay,
            delay_deviation_knots: delay_deviation,
        });
        Proposal::Command(command)
    }

    fn report(&self) -> Option<StepReport> {
        self.report
    }
}

/// The commands within the trajectory's bounds and the room; quadrotor and tip inside the room, softly.
fn limits(trajectory: &Trajectory, room: &Room, options: &MpcOptions) -> HorizonLimits {
    let walls = [room.x_m, room.y_m, room.quadrotor_z_m];
    let (lower, upper) = trajectory.command_bounds();
    let margin = options.room_margin_m;
    let mut states: Vec<SoftBound> = (0..3)
        .map(|axis| SoftBound {
            index: axis,
            lower: walls[axis][0] + margin,
            upper: walls[axis][1] - margin,
        })
        .collect();
    for (axis, wall) in [room.x_m, room.y_m].into_iter().enumerate() {
        states.push(SoftBound {
            index: 6 + axis,
            lower: wall[0] + margin,
            upper: wall[1] - margin,
        });
    }
    states.push(SoftBound {
        index: 8,
        lower: room.end_effector_z_min_m + margin,
        upper: f64::INFINITY,
    });
    HorizonLimits {
        command_lower: (0..3).map(|axis| lower[axis].max(walls[axis][0])).collect(),
        command_upper: (0..3).map(|axis| upper[axis].min(walls[axis][1])).collect(),
        command_change: Some(vec![options.command_change_max_m; 3]),
        states,
        penalty: options.room_penalty,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worse_a_model_foresees_the_dearer_are_commands() {
        let weights = |quadrotor_m: f64, end_effector_m: f64| {
            let mut noise = NoiseLevels::PHYSICAL;
            (noise.process.quadrotor_m, noise.process.end_effector_m) = (quadrotor_m, end_effector_m);
            physical_weights(Some(&noise))
        };
        assert_eq!(physical_weights(None), UNKNOWN);
        assert_eq!(weights(1.0, 4.0), [TRUSTING; 2]);
        assert!(weights(2.0, 8.0)[0] > 10.0 * TRUSTING);
        assert_eq!(weights(16.0, 16.0), [CAUTIOUS; 2]);
    }
}
