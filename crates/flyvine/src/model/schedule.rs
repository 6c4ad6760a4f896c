//! Time-varying dynamics: a bank along a schedule of configurations.

use super::error::ModelError;
use super::family::Model;
use super::lag::LagModel;
use super::noise::NoiseLevels;
use super::physical::Surroundings;
use crate::trajopt::Dynamics;

/// A bank along a schedule of configurations: time-varying dynamics with precomputed coefficients.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScheduledModel {
    /// One model per change of configuration.
    models: Vec<Model>,
    /// Index into `models` per knot.
    model_of_knot: Vec<usize>,
    /// The bank's, if it has them.
    noise: Option<NoiseLevels>,
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
        })
    }

    /// The schedule of a bank with these noise levels.
    pub(crate) fn with_noise(noise: Option<NoiseLevels>) -> Self {
        Self {
            noise,
            ..Self::default()
        }
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
            Model::Lag(model) => model.step(knot, state, command, fresh),
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
            Model::Lag(model) => {
                if let Some(entries) = by_surroundings {
                    entries.fill(0.0);
                }
                model.linearize(knot, state, command, fresh, jacobian);
            }
            Model::Physical(model) => {
                model.linearize_in(around, state, command, fresh, jacobian, by_surroundings);
            }
        }
    }
}

impl Dynamics for ScheduledModel {
    fn state_len(&self) -> usize {
        self.models[0].state_len()
    }

    fn command_len(&self) -> usize {
        self.models[0].command_len()
    }

    fn fresh_len(&self) -> usize {
        self.models[0].fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.at_knot(knot).step(knot, state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.at_knot(knot).linearize(knot, z, u, fresh, jacobian);
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
        self.at_knot(knot)
            .add_curvature(knot, z, u, adjoint, stride, hessian);
    }
}
