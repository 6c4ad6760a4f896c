//! Lagged dynamics with one quadratic row, one set of coefficients per step.

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

impl HeightModel {
    pub fn combination(weights: &[f64], models: &[Self]) -> Self {
        let mix = |array: fn(&Self) -> &Vec<f64>| {
            let sum = |i: usize| {
                weights
                    .iter()
                    .zip(models)
                    .map(|(weight, model)| weight * array(model)[i])
                    .sum()
            };
            (0..array(&models[0]).len()).map(sum).collect()
        };
        Self {
            offset: mix(|m| &m.offset),
            linear: mix(|m| &m.linear),
            hessian: mix(|m| &m.hessian),
        }
    }
}

/// Lagged models along a schedule.
#[derive(Debug, Clone)]
pub struct ScheduledLagDynamics {
    models: Vec<HeightModel>,
}

impl ScheduledLagDynamics {
    pub(super) fn constant(model: &HeightModel) -> Self {
        Self {
            models: vec![model.clone()],
        }
    }

    pub(super) fn scheduled(models: impl Iterator<Item = HeightModel>) -> Self {
        Self {
            models: models.collect(),
        }
    }

    fn at(&self, knot: usize) -> &HeightModel {
        &self.models[knot.min(self.models.len() - 1)]
    }

    fn width(&self) -> usize {
        self.models[0].linear.len() / self.fresh_len()
    }
}

impl Dynamics for ScheduledLagDynamics {
    fn state_len(&self) -> usize {
        self.width() - 3
    }

    fn command_len(&self) -> usize {
        3
    }

    fn fresh_len(&self) -> usize {
        self.models[0].offset.len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let model = self.at(knot);
        let (width, last) = (state.len() + command.len(), fresh.len() - 1);
        for (row, out) in fresh.iter_mut().enumerate() {
            *out = model.offset[row] + product(&model.linear[row * width..][..width], state, command);
        }
        for (i, &w) in state.iter().chain(command).enumerate() {
            fresh[last] += 0.5 * w * product(&model.hessian[i * width..][..width], state, command);
        }
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let model = self.at(knot);
        let width = state.len() + command.len();
        jacobian.copy_from_slice(&model.linear);
        let last = model.linear.len() - width;
        for i in 0..width {
            jacobian[last + i] += product(&model.hessian[i * width..][..width], state, command);
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
        let factor = scale * adjoint[adjoint.len() - 1];
        for (sum, value) in hessian.iter_mut().zip(&self.at(knot).hessian) {
            *sum += factor * value;
        }
    }
}

fn product(row: &[f64], state: &[f64], command: &[f64]) -> f64 {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    dot(&row[..state.len()], state) + dot(&row[state.len()..], command)
}
