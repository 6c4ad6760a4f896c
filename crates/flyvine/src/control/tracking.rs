//! Feedback on the gains of a time-varying regulator along the plan.

use super::estimator::{Estimator, EstimatorError};
use super::mpc::{Stage, TrackingWeights, jacobians_along, regulate};
use super::{Controller, Proposal, Tick, Trajectory};
use crate::link::Observation;
use crate::model::ScheduledModel;
use crate::trajopt::Dynamics;
use nalgebra::DMatrix;

/// Weights of the regulator. A plan's own gains answer to weights under which a command costs as little as a pose is
/// worth: on a real vehicle, which the model does not match in its fast motions, they oscillate.
const END_EFFECTOR_WEIGHT: f64 = 20.0;
const POSE_WEIGHT: f64 = 1.0;
const COMMAND_WEIGHT: f64 = 20.0;

/// u_k = clip(u*_k + K_k (ẑ_k − z*_k)), with ẑ_k from the estimator, at the knot where the command begins to act.
#[derive(Debug, Clone)]
pub struct Tracking<'a> {
    trajectory: &'a Trajectory,
    estimator: Estimator<'a>,
    gains: Vec<DMatrix<f64>>,
    /// ẑ (n), and what the world adds to a step's fresh entries.
    state: Vec<f64>,
    steady: Vec<f64>,
    gust: Vec<f64>,
}

impl<'a> Tracking<'a> {
    /// Tracks `trajectory`; `model` is the one that it was planned on.
    ///
    /// # Errors
    /// The model is not the trajectory's, or does not take a position for its command.
    pub fn new(trajectory: &'a Trajectory, model: &'a ScheduledModel) -> Result<Self, EstimatorError> {
        let noise = *model.noise();
        let estimator = Estimator::new(model, &noise, trajectory.state(0), trajectory.start().0)?;
        let mut state = vec![0.0; model.state_len()];
        state[..6].fill(POSE_WEIGHT);
        state[6..9].fill(END_EFFECTOR_WEIGHT);
        let weights = TrackingWeights {
            state,
            command: vec![COMMAND_WEIGHT; 3],
            command_change: vec![0.0; 3],
        };
        let regulator = regulate(&Stage::of(model), &jacobians_along(trajectory, model), &weights);
        Ok(Self {
            trajectory,
            estimator,
            gains: regulator.gains,
            state: trajectory.state(0).to_vec(),
            steady: vec![0.0; model.fresh_len()],
            gust: vec![0.0; model.fresh_len()],
        })
    }
}

impl Controller for Tracking<'_> {
    fn prepare(&mut self, hovering: &Observation) {
        self.estimator.settle(hovering);
    }

    fn propose(&mut self, tick: &Tick) -> Proposal {
        self.estimator.update(tick);
        let lateness = self
            .estimator
            .foresee(tick.knot, &mut self.state, &mut self.steady, &mut self.gust);
        // Commands that would act after the plan's end no longer matter.
        let knot = (tick.knot + lateness.whole).min(self.gains.len() - 1);
        let planned = self.trajectory.state(knot);
        let mut command = self.trajectory.command(knot);
        for (entry, gains) in command.iter_mut().zip(self.gains[knot].row_iter()) {
            let errors = self.state.iter().zip(planned).map(|(z, planned)| z - planned);
            *entry += gains.iter().zip(errors).map(|(k, e)| k * e).sum::<f64>();
        }
        Proposal::Command(self.trajectory.clip(command))
    }
}
