//! Time-varying dynamics: a bank along a schedule of configurations.

use super::commanded_velocity;
use super::error::ModelError;
use super::family::Model;
use super::lag::{CommandInputs, LagModel};
use super::noise::NoiseLevels;
use super::physical::Surroundings;
use crate::HOVER_HEIGHT_M;
use crate::flight::Configuration;
use crate::link::Feedforward;
use crate::trajopt::{Dynamics, linearize_and_spread};

/// A bank along a schedule of configurations: time-varying dynamics with precomputed coefficients.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScheduledModel {
    /// One model per change of configuration.
    models: Vec<Model>,
    /// Index into `models` per knot.
    model_of_knot: Vec<usize>,
    /// The bank's, if it has them.
    noise: Option<NoiseLevels>,
    /// What its flights are sent beside positions.
    feedforward: Feedforward,
}

impl ScheduledModel {
    /// Lag models of one structure, mixed anew at every step: `weights` holds one row per step with a weight for
    /// each model.
    ///
    /// # Errors
    /// No models, models of different structure, or weights that are no whole number of rows.
    pub fn mixture(models: &[LagModel], weights: &[f64]) -> Result<Self, ModelError> {
        let rows = weights.len() / models.len().max(1);
        if models.is_empty() || rows == 0 || weights.len() != rows * models.len() {
            return Err(ModelError::Shape {
                what: format!("weights for {} models", models.len()),
                found: weights.len(),
                expected: rows.max(1) * models.len().max(1),
            });
        }
        for model in models {
            if let Some(found) = models[0].structure_difference(model) {
                return Err(ModelError::Unsupported {
                    what: "mixture of models",
                    found,
                    expected: "models of one structure".into(),
                });
            }
        }
        let mix = |weights: &[f64]| {
            let parts: Vec<(f64, &LagModel)> = weights.iter().copied().zip(models).collect();
            Model::Lag(LagModel::combination(&parts))
        };
        let models: Vec<Model> = weights.chunks_exact(models.len()).map(mix).collect();
        Ok(Self {
            model_of_knot: (0..models.len()).collect(),
            models,
            noise: None,
            feedforward: Feedforward::None,
        })
    }

    /// The schedule of a bank with these noise levels.
    pub(crate) fn with_noise(noise: Option<NoiseLevels>) -> Self {
        Self {
            noise,
            ..Self::default()
        }
    }

    /// The same models for flights that are sent `feedforward`: lag models that take velocities then take positions alone,
    /// whose velocity it is, and their state ends with the command before (3 entries more).
    pub fn with_feedforward(self, feedforward: Feedforward) -> Self {
        Self { feedforward, ..self }
    }

    /// The lag model at `knot`, if it is given the velocity of the command.
    fn fed_forward(&self, knot: usize) -> Option<&LagModel> {
        match self.at_knot(knot) {
            Model::Lag(model)
                if self.feedforward == Feedforward::Velocity
                    && model.inputs() == CommandInputs::PositionAndVelocity =>
            {
                Some(model)
            }
            _ => None,
        }
    }

    /// The state at rest, hovering at (0, 0, 1.5) with the arm hanging straight.
    pub fn rest_state(&self, configuration: Configuration) -> Vec<f64> {
        self.rest_state_at(configuration, [0.0, 0.0, HOVER_HEIGHT_M])
    }

    /// The state at rest with the quadrotor at `position`, m.
    pub fn rest_state_at(&self, configuration: Configuration, position: [f64; 3]) -> Vec<f64> {
        let mut rest = self.at_knot(0).rest_state_at(configuration, position);
        if self.fed_forward(0).is_some() {
            rest.extend_from_within(..3);
        }
        rest
    }

    /// The noise levels that were identified with the models, or else the family's typical ones.
    pub fn noise(&self) -> &NoiseLevels {
        self.noise.as_ref().unwrap_or(match self.at_knot(0) {
            Model::Lag(_) => &NoiseLevels::LAG,
            Model::Physical(_) => &NoiseLevels::PHYSICAL,
        })
    }

    /// The noise levels that were identified with the models, if they were.
    pub fn identified_noise(&self) -> Option<&NoiseLevels> {
        self.noise.as_ref()
    }

    /// The next knot has another configuration, and this model.
    pub(crate) fn push(&mut self, model: Model) {
        self.models.push(model);
        self.repeat();
    }

    /// The next knot has the same model as the last.
    pub(crate) fn repeat(&mut self) {
        self.model_of_knot.push(self.models.len() - 1);
    }

    /// The model at `knot`.
    pub fn at_knot(&self, knot: usize) -> &Model {
        let last = self.model_of_knot.len() - 1;
        &self.models[self.model_of_knot[knot.min(last)]]
    }

    /// [`Dynamics::step`] in moving air and with a load at the tip; lag models know of neither.
    pub fn step_in(
        &self,
        knot: usize,
        around: &Surroundings,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
    ) {
        match self.at_knot(knot) {
            Model::Lag(_) => self.step(knot, state, command, fresh),
            Model::Physical(model) => model.step_in(around, state, command, fresh),
        }
    }

    /// [`Dynamics::linearize`] there, and the Jacobian by the surroundings
    /// (`fresh_len` × [`SURROUNDINGS_LEN`](super::physical::SURROUNDINGS_LEN)) for those who want it.
    #[allow(clippy::too_many_arguments)] // those of `linearize`, and two
    pub fn linearize_in(
        &self,
        knot: usize,
        around: &Surroundings,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
        by_surroundings: Option<&mut [f64]>,
    ) {
        match self.at_knot(knot) {
            Model::Lag(_) => {
                if let Some(entries) = by_surroundings {
                    entries.fill(0.0);
                }
                self.linearize(knot, state, command, fresh, jacobian);
            }
            Model::Physical(model) => {
                model.linearize_in(around, state, command, fresh, jacobian, by_surroundings);
            }
        }
    }
}

impl Dynamics for ScheduledModel {
    fn state_len(&self) -> usize {
        match self.fed_forward(0) {
            Some(model) => commanded_velocity::state_len(model),
            None => self.models[0].state_len(),
        }
    }

    fn command_len(&self) -> usize {
        match self.fed_forward(0) {
            Some(_) => 3,
            None => self.models[0].command_len(),
        }
    }

    fn fresh_len(&self) -> usize {
        match self.fed_forward(0) {
            Some(model) => commanded_velocity::state_len(model),
            None => self.models[0].fresh_len(),
        }
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        match self.fed_forward(knot) {
            Some(model) => commanded_velocity::step(model, state, command, fresh),
            None => self.at_knot(knot).step(knot, state, command, fresh),
        }
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        match self.fed_forward(knot) {
            Some(model) => commanded_velocity::linearize(model, z, u, fresh, jacobian),
            None => self.at_knot(knot).linearize(knot, z, u, fresh, jacobian),
        }
    }

    fn linearize_padded(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        fresh: &mut [f64],
        stride: usize,
        jacobian: &mut [f64],
    ) {
        match self.fed_forward(knot) {
            Some(_) => linearize_and_spread(self, knot, z, u, fresh, stride, jacobian),
            None => self
                .at_knot(knot)
                .linearize_padded(knot, z, u, fresh, stride, jacobian),
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
        match self.fed_forward(knot) {
            Some(model) => commanded_velocity::add_curvature(model, z, u, adjoint, stride, hessian),
            None => self
                .at_knot(knot)
                .add_curvature(knot, z, u, adjoint, stride, hessian),
        }
    }
}
