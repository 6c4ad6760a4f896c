//! A plan flown with one of the control laws.

use std::ops::ControlFlow;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::estimator::EstimatorError;
use super::mpc::{ModelPredictive, MpcError, MpcOptions};
use super::supervisor::{Limits, SupervisorError};
use super::{
    Controller, FlightOutcome, FlownRow, OpenLoop, Replanning, ReplanningError, Tracking, Trajectory,
    TrajectoryError, fly_watched,
};
use crate::flight::ControlStep;
use crate::link::Vehicle;
use crate::model::{ModelError, ScheduledModel};
use crate::task::{Plan, PlanError};

/// The control laws that a plan can be flown with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlLaw {
    /// The plan's commands as they are.
    #[default]
    OpenLoop,
    /// The plan's commands, corrected by a time-varying regulator behind an estimator.
    Tracking,
    /// Model-predictive control along the plan, behind an estimator of disturbances and delay.
    Mpc,
    /// The rest of the task planned again at every knot, for swings.
    Replan,
}

impl ControlLaw {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::OpenLoop, Self::Tracking, Self::Mpc, Self::Replan];

    /// Its name, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenLoop => "open-loop",
            Self::Tracking => "tracking",
            Self::Mpc => "mpc",
            Self::Replan => "replan",
        }
    }

    /// The law called `name`, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|law| law.name() == name)
    }
}

/// How a plan is flown.
#[derive(Debug, Clone, Default)]
pub struct Flying {
    /// The control law.
    pub law: ControlLaw,
    /// Settings of model-predictive control.
    pub mpc: MpcOptions,
    /// Time for one step of a controller that optimizes; without it, every step is solved to the end.
    pub step_limit: Option<Duration>,
    /// Reports of the recorded flight that is to be repeated.
    pub recorded: Vec<ControlStep>,
    /// Inconsistency of the model with which an earlier flight of the same vehicle ended; without it, trust in the model has to
    /// be earned anew.
    pub inconsistency: Option<f64>,
    /// Where the tip shall be, if not on the plan's own reference (m, per knot).
    pub reference: Option<Vec<[f64; 3]>>,
}

/// Why a plan cannot be flown.
#[derive(Debug, thiserror::Error)]
pub enum FlyingError {
    /// The plan's arrays make no trajectory.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// The plan's bank does not cover its configurations.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The plan's problem cannot be posed again.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The model does not suit the estimator.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// The plan does not suit model-predictive control.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// The plan does not suit replanning.
    #[error(transparent)]
    Replanning(#[from] ReplanningError),
    /// The limits are bad, or the plan starts outside the room.
    #[error(transparent)]
    Supervisor(#[from] SupervisorError),
    /// The law feeds poses back to commands whose velocities the plan sends.
    #[error(
        "feedforward: found a plan that sends velocities and --controller {}, expected open-loop or mpc: the velocities \
         of commands that follow every pose shake the vehicle",
        .law.name()
    )]
    Feedforward {
        /// The law.
        law: ControlLaw,
    },
}

/// The controller that `flying` asks for, on the `trajectory` of `plan` and the `model` that it was planned on.
///
/// # Errors
/// The plan does not suit the law.
pub fn controller<'a>(
    plan: &Plan,
    trajectory: &'a Trajectory,
    model: &'a ScheduledModel,
    flying: &Flying,
    limits: &Limits,
) -> Result<Box<dyn Controller + Send + 'a>, FlyingError> {
    let follows_every_pose = matches!(flying.law, ControlLaw::Tracking | ControlLaw::Replan);
    if follows_every_pose && !trajectory.feedforward().is_none() {
        return Err(FlyingError::Feedforward { law: flying.law });
    }
    Ok(match flying.law {
        ControlLaw::OpenLoop => Box::new(OpenLoop::new(trajectory)),
        ControlLaw::Tracking => Box::new(Tracking::new(trajectory, model)?),
        ControlLaw::Mpc => {
            let reference = flying.reference.as_ref().unwrap_or(&plan.reference);
            let mut mpc = ModelPredictive::new(trajectory, model, reference, &limits.room, &flying.mpc)?;
            if let Some(limit) = flying.step_limit {
                mpc = mpc.with_time_limit(limit);
            }
            if let Some(inconsistency) = flying.inconsistency {
                mpc = mpc.with_inconsistency(inconsistency);
            }
            Box::new(mpc.with_recorded_steps(&flying.recorded))
        }
        ControlLaw::Replan => {
            let mut replanning = Replanning::new(trajectory, model, plan.problem()?)?
                .with_command_change(plan.task.command_change)
                .with_constraints(plan.constraints()?);
            if let Some(limit) = flying.step_limit {
                replanning = replanning.with_time_limit(limit);
            }
            Box::new(replanning)
        }
    })
}

/// Flies a plan with its task's command bounds, as [`fly()`](super::fly()).
///
/// # Errors
/// Nothing was flown: the plan does not suit the law, the limits are bad, or the plan starts outside the room.
pub fn fly_plan(
    plan: &Plan,
    flying: &Flying,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<FlightOutcome, FlyingError> {
    fly_plan_watched(plan, flying, limits, vehicle, seed, progress, &mut |_| ())
}

/// [`fly_plan`], with `watch` told of every row, as [`fly_watched`].
///
/// # Errors
/// As [`fly_plan`].
pub fn fly_plan_watched(
    plan: &Plan,
    flying: &Flying,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    watch: &mut dyn FnMut(&FlownRow),
) -> Result<FlightOutcome, FlyingError> {
    let trajectory = Trajectory::of_plan(plan)?;
    let model = plan.model()?;
    let mut controller = controller(plan, &trajectory, &model, flying, &limits)?;
    let controller = controller.as_mut();
    let mut outcome = fly_watched(&trajectory, controller, limits, vehicle, seed, progress, watch)?;
    outcome.flight.name.clone_from(&plan.task.name);
    Ok(outcome)
}
