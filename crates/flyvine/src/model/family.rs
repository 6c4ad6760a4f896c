//! One predictor, of whichever family.

use super::error::ModelError;
use super::lag::{LagModel, STATE_LEN};
use super::physical::PhysicalModel;
use super::stability::spectral_radius;
use crate::HOVER_HEIGHT_M;
use crate::flight::Configuration;
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};

/// One predictor, of whichever family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "family", rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // a bank holds at most four
pub enum Model {
    /// Polynomial in lagged states and commands.
    Lag(LagModel),
    /// Reduced-order physics of quadrotor, autopilot and arm.
    Physical(Box<PhysicalModel>),
}

impl Model {
    /// Number of states x, newest first, that its state z begins with; whatever follows is hidden.
    pub fn lags(&self) -> usize {
        match self {
            Self::Lag(model) => model.lags(),
            Self::Physical(_) => 1,
        }
    }

    /// The state z at rest, hovering at (0, 0, 1.5) with the arm hanging straight.
    pub fn rest_state(&self, configuration: Configuration) -> Vec<f64> {
        self.rest_state_at(configuration, [0.0, 0.0, HOVER_HEIGHT_M])
    }

    /// The state at rest with the quadrotor at `position`, m.
    pub fn rest_state_at(&self, configuration: Configuration, position: [f64; 3]) -> Vec<f64> {
        match self {
            Self::Lag(model) => {
                let [x, y, z] = position;
                let rest = [x, y, z, 0.0, 0.0, 0.0, x, y, z - configuration.length_m];
                rest.repeat(model.lags())
            }
            Self::Physical(model) => model.rest_state(position),
        }
    }

    /// The model of the same configuration while the arm grows by `rate_m_s`. Only physics sees the difference.
    pub(crate) fn growing(mut self, rate_m_s: f64) -> Self {
        if let Self::Physical(model) = &mut self {
            model.arm.rate_m_s = rate_m_s;
        }
        self
    }

    /// The model between `parts` of one family, with weights that sum to one, at `configuration`. Weights of zero
    /// are left out, so that a corner's own model comes back to the last bit.
    pub(crate) fn between(parts: &[(f64, &Self)], configuration: Configuration) -> Self {
        let (mut lag, mut physical) = (Vec::new(), Vec::new());
        for (weight, part) in parts.iter().filter(|(weight, _)| *weight != 0.0) {
            match part {
                Self::Lag(model) => lag.push((*weight, model)),
                Self::Physical(model) => physical.push((*weight, model.as_ref())),
            }
        }
        if physical.is_empty() {
            Self::Lag(LagModel::combination(&lag))
        } else {
            Self::Physical(Box::new(PhysicalModel::between(
                &physical,
                configuration.length_m,
            )))
        }
    }

    /// Why the two cannot be interpolated, if so.
    pub(crate) fn structure_difference(&self, other: &Self) -> Option<String> {
        match (self, other) {
            (Self::Lag(first), Self::Lag(second)) => first.structure_difference(second),
            (Self::Physical(_), Self::Physical(_)) => None,
            _ => Some("one is a lag model, the other a physical one".into()),
        }
    }

    fn dynamics(&self) -> &dyn Dynamics {
        match self {
            Self::Lag(model) => model,
            Self::Physical(model) => model.as_ref(),
        }
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
        self.dynamics().state_len()
    }

    fn command_len(&self) -> usize {
        self.dynamics().command_len()
    }

    fn fresh_len(&self) -> usize {
        self.dynamics().fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.dynamics().step(knot, state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.dynamics().linearize(knot, z, u, fresh, jacobian);
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
        self.dynamics()
            .linearize_padded(knot, z, u, fresh, stride, jacobian);
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
        self.dynamics()
            .add_curvature(knot, z, u, adjoint, stride, hessian);
    }
}
