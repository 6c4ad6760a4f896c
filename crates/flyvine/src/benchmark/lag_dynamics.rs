//! Lagged dynamics with one quadratic row, mixed from a few models along a schedule.

use crate::kernel;
use crate::trajopt::Dynamics;

/// `f(w) = c + L w`, and `+ ½ wᵀ H w` in the last row, with `w = (z, u)`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HeightModel {
    pub offset: Vec<f64>,
    /// fresh × (n + m).
    pub linear: Vec<f64>,
    /// (n + m) × (n + m), symmetric.
    pub hessian: Vec<f64>,
}

/// Longest `w` times number of models.
const MAX_INPUTS: usize = 256;
const MAX_OUTPUTS: usize = 128;

/// Lagged models along a schedule.
#[derive(Debug, Clone)]
pub struct ScheduledLagDynamics {
    width: usize,
    fresh: usize,
    command: usize,
    models: Vec<HeightModel>,
    /// Weights of the models at every step.
    weights: Vec<f64>,
    /// For every model and input one row (Lᵀ | H), both padded.
    stacked: Vec<f64>,
}

impl ScheduledLagDynamics {
    pub(super) fn new(models: Vec<HeightModel>, weights: Vec<f64>, command: usize) -> Self {
        let fresh = models[0].offset.len();
        let width = models[0].linear.len() / fresh;
        let mut stacked = Vec::new();
        for model in &models {
            for input in 0..width {
                let start = stacked.len();
                stacked.extend((0..fresh).map(|row| model.linear[row * width + input]));
                stacked.resize(start + kernel::padded(fresh), 0.0);
                stacked.extend_from_slice(&model.hessian[input * width..][..width]);
                stacked.resize(start + kernel::padded(fresh) + kernel::padded(width), 0.0);
            }
        }
        Self {
            width,
            fresh,
            command,
            models,
            weights,
            stacked,
        }
    }

    fn weights(&self, knot: usize) -> &[f64] {
        let count = self.models.len();
        &self.weights[(knot * count).min(self.weights.len() - count)..][..count]
    }

    /// (L w | H w), padded, of the mixed model.
    fn products<'a>(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        outputs: &'a mut [f64; MAX_OUTPUTS],
    ) -> (&'a [f64], &'a [f64]) {
        let mut inputs = [0.0; MAX_INPUTS];
        let mut next = 0;
        for weight in self.weights(knot) {
            for w in state.iter().chain(command) {
                inputs[next] = weight * w;
                next += 1;
            }
        }
        let fresh = kernel::padded(self.fresh);
        let outputs = &mut outputs[..fresh + kernel::padded(self.width)];
        kernel::add_transpose_vector(&self.stacked, &inputs[..next], outputs);
        outputs.split_at(fresh)
    }
}

impl Dynamics for ScheduledLagDynamics {
    fn state_len(&self) -> usize {
        self.width - self.command
    }

    fn command_len(&self) -> usize {
        self.command
    }

    fn fresh_len(&self) -> usize {
        self.fresh
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let mut outputs = [0.0; MAX_OUTPUTS];
        let (linear, gradient) = self.products(knot, state, command, &mut outputs);
        fresh.copy_from_slice(&linear[..self.fresh]);
        for (weight, model) in self.weights(knot).iter().zip(&self.models) {
            for (entry, offset) in fresh.iter_mut().zip(&model.offset) {
                *entry += weight * offset;
            }
        }
        let quadratic: f64 = state
            .iter()
            .chain(command)
            .zip(gradient)
            .map(|(w, g)| w * g)
            .sum();
        fresh[self.fresh - 1] += 0.5 * quadratic;
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let mut outputs = [0.0; MAX_OUTPUTS];
        let (_, gradient) = self.products(knot, state, command, &mut outputs);
        jacobian.fill(0.0);
        for (weight, model) in self.weights(knot).iter().zip(&self.models) {
            for (entry, linear) in jacobian.iter_mut().zip(&model.linear) {
                *entry += weight * linear;
            }
        }
        let height = &mut jacobian[(self.fresh - 1) * self.width..];
        for (entry, g) in height.iter_mut().zip(gradient) {
            *entry += g;
        }
    }

    fn add_curvature(
        &self,
        knot: usize,
        _state: &[f64],
        _command: &[f64],
        adjoint: &[f64],
        scale: f64,
        hessian: &mut [f64],
    ) {
        for (weight, model) in self.weights(knot).iter().zip(&self.models) {
            let factor = scale * weight * adjoint[self.fresh - 1];
            for (sum, value) in hessian.iter_mut().zip(&model.hessian) {
                *sum += factor * value;
            }
        }
    }
}
