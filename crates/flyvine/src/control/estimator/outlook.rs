//! What the estimator expects of air and load, and a bank's model in it.

use crate::model::ScheduledModel;
use crate::model::physical::{STATE_LEN, SURROUNDINGS_LEN, Surroundings};
use crate::trajopt::Dynamics;

/// Air and load as they are expected from a knot on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlook {
    /// The knot.
    pub knot: usize,
    /// What stays.
    pub steady: Surroundings,
    /// What a gust adds to the wind there, m/s …
    pub gust_m_s: [f64; 3],
    /// … of which this share is left at each further knot.
    pub gust_decay: f64,
}

impl Outlook {
    /// The surroundings at `knot`.
    pub fn at(&self, knot: usize) -> Surroundings {
        let left = self.gust_decay.powi(knot.saturating_sub(self.knot) as i32);
        let mut around = self.steady;
        for (wind, gust) in around.wind_m_s.iter_mut().zip(self.gust_m_s) {
            *wind += left * gust;
        }
        around
    }
}

/// A bank's model in the surroundings that are expected.
#[derive(Debug, Clone, Copy)]
pub struct Surrounded<'a> {
    /// The model.
    pub model: &'a ScheduledModel,
    /// The surroundings.
    pub outlook: Outlook,
}

impl Dynamics for Surrounded<'_> {
    fn state_len(&self) -> usize {
        self.model.state_len()
    }

    fn command_len(&self) -> usize {
        self.model.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.model.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.model
            .step_in(knot, &self.outlook.at(knot), state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        let mut by_surroundings = [0.0; STATE_LEN * SURROUNDINGS_LEN];
        self.model.linearize_in(
            knot,
            &self.outlook.at(knot),
            z,
            u,
            fresh,
            jacobian,
            &mut by_surroundings[..fresh.len() * SURROUNDINGS_LEN],
        );
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
        self.model.add_curvature(knot, z, u, adjoint, stride, hessian);
    }
}
