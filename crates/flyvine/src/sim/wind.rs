//! Moving air: a mean wind and gusts with the Dryden spectrum of first order, per axis
//! (MIL-F-8785C's longitudinal form `σ √(2τ) / (1 + τ s)` driven by white noise, with τ given directly, because
//! a hovering vehicle has no airspeed to turn a length scale into a time).

use super::parameters::{Checker, ParameterError};
use nalgebra::Vector3;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// Mean wind and gusts. Calm by default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WindParameters {
    /// Mean wind, world frame, m/s.
    pub mean_m_s: [f64; 3],
    /// Standard deviation of the gusts per axis, m/s.
    pub gust_m_s: f64,
    /// Correlation time of the gusts, s.
    pub gust_time_s: f64,
}

impl Default for WindParameters {
    fn default() -> Self {
        WindParameters {
            mean_m_s: [0.0; 3],
            gust_m_s: 0.0,
            gust_time_s: 1.0,
        }
    }
}

impl WindParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("wind");
        for component in self.mean_m_s {
            check.range("mean_m_s", component, -20.0, 20.0, "m/s")?;
        }
        check.range("gust_m_s", self.gust_m_s, 0.0, 20.0, "m/s")?;
        check.range("gust_time_s", self.gust_time_s, 1e-2, 1e3, "s")
    }

    /// True if the air stands still.
    pub fn is_calm(&self) -> bool {
        self.mean_m_s == [0.0; 3] && self.gust_m_s == 0.0
    }
}

/// The gust's current velocity, without the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gust(Vector3<f64>);

impl Gust {
    /// A draw from the stationary distribution.
    pub fn stationary(parameters: &WindParameters, random: &mut impl Rng) -> Gust {
        Gust(parameters.gust_m_s * normal(random))
    }

    /// Advances by `step` seconds, exactly in distribution, and returns the air's velocity, m/s.
    pub fn step(&mut self, parameters: &WindParameters, step: f64, random: &mut impl Rng) -> Vector3<f64> {
        let mean = Vector3::from(parameters.mean_m_s);
        if parameters.gust_m_s == 0.0 {
            return mean;
        }
        let keep = (-step / parameters.gust_time_s).exp();
        self.0 = keep * self.0 + parameters.gust_m_s * (1.0 - keep * keep).sqrt() * normal(random);
        mean + self.0
    }
}

/// Three independent standard normal numbers.
pub(super) fn normal(random: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(random))
}
