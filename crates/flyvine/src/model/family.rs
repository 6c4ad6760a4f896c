//! One predictor, of whichever family.

use super::error::ModelError;
use super::lag::{LagModel, STATE_LEN};
use super::stability::spectral_radius;
use crate::flight::Configuration;
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};

/// Height at which every flight starts and its state rests, m.
const HOVER_HEIGHT_M: f64 = 1.5;

/// One predictor, of whichever family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "family", rename_all = "snake_case")]
pub enum Model {
    /// Polynomial in lagged states and commands.
    Lag(LagModel),
}

impl Model {
    /// Number of past states that its state z holds.
    pub fn lags(&self) -> usize {
        let Self::Lag(model) = self;
        model.lags()
    }

    /// The state z at rest: copies of hovering at (0, 0, 1.5) with the arm hanging straight.
    pub fn rest_state(&self, configuration: Configuration) -> Vec<f64> {
        rest_state(configuration, self.lags())
    }

    /// Spectral radius of the transition matrix linearized at rest; above 1 predictions run away.
    ///
    /// # Errors
    /// The eigenvalue iteration did not converge.
    pub fn spectral_radius(&self, configuration: Configuration) -> Result<f64, ModelError> {
        let mut command = vec![0.0; self.command_len()];
        command[2] = HOVER_HEIGHT_M;
        spectral_radius(self, &self.rest_state(configuration), &command).ok_or(ModelError::Factorization {
            what: "eigenvalues at rest",
            configuration,
        })
    }
}

/// `lags` copies of x at rest: hovering at (0, 0, 1.5), level, the arm hanging straight down.
pub fn rest_state(configuration: Configuration, lags: usize) -> Vec<f64> {
    let tip = HOVER_HEIGHT_M - configuration.length_m;
    let rest: [f64; STATE_LEN] = [0.0, 0.0, HOVER_HEIGHT_M, 0.0, 0.0, 0.0, 0.0, 0.0, tip];
    rest.repeat(lags)
}

impl Dynamics for Model {
    fn state_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.state_len()
    }

    fn command_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.command_len()
    }

    fn fresh_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let Self::Lag(model) = self;
        model.step(knot, state, command, fresh);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let Self::Lag(model) = self;
        model.jacobian(knot, state, command, jacobian);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        let Self::Lag(model) = self;
        model.linearize(knot, z, u, fresh, jacobian);
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        scale: f64,
        hessian: &mut [f64],
    ) {
        let Self::Lag(model) = self;
        model.add_curvature(knot, z, u, adjoint, scale, hessian);
    }
}
