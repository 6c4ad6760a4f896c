//! How uncertain measurements, models and the world are: what an estimator on a model needs to know beside it.

use crate::flight::SIGNALS;
use serde::{Deserialize, Serialize};

/// One standard deviation per kind of entry.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyNoise {
    /// Quadrotor position, m.
    pub quadrotor_m: f64,
    /// Attitude, vector part of the quaternion.
    pub attitude: f64,
    /// End-effector position, m.
    pub end_effector_m: f64,
}

impl BodyNoise {
    /// Spread over the nine entries of x.
    pub(crate) fn entries(&self) -> [f64; SIGNALS.len()] {
        std::array::from_fn(|i| [self.quadrotor_m, self.attitude, self.end_effector_m][i / 3])
    }
}

/// How far the surroundings may be from those of the fit, standard deviations; 0 for what shall not be estimated. Only
/// the physical family knows them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SurroundingsNoise {
    /// Of a steady wind, along each horizontal axis, m/s.
    pub wind_m_s: f64,
    /// Of its gusts, m/s.
    pub gust_m_s: f64,
    /// Of the share by which the tip is heavier.
    pub tip_load: f64,
}

impl Default for SurroundingsNoise {
    fn default() -> Self {
        Self::TYPICAL
    }
}

impl SurroundingsNoise {
    /// A light breeze with gusts as strong; what a light gripper carries. On an independent simulator predictive control was
    /// as good in calm air with gusts of 0.3 as with 0.7 m/s, and off by 4 % less in gusts of 0.7 m/s with the latter.
    pub const TYPICAL: Self = Self {
        wind_m_s: 0.7,
        gust_m_s: 0.7,
        tip_load: 0.3,
    };
}

/// Noise levels of the filter, standard deviations; those of disturbances and process are per knot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseLevels {
    /// Of measured poses.
    pub measured: BodyNoise,
    /// What a step of the model misses: in the pose that it predicts (lag family), or as a share of the levels that
    /// the physical family's hidden states move by (1 is typical).
    pub process: BodyNoise,
    /// How far the steady disturbances wander.
    pub disturbance: BodyNoise,
    /// How strong the gusts are.
    pub gust: BodyNoise,
    /// Of wind and load.
    #[serde(default)]
    pub surroundings: SurroundingsNoise,
    /// How long a gust lasts, s: its correlation time.
    pub gust_s: f64,
    /// How far the delay wanders, knots.
    pub delay: f64,
    /// How uncertain the delay is at the start, knots.
    pub delay_initial: f64,
}

impl NoiseLevels {
    /// For the lag family, where nothing was identified.
    pub const LAG: Self = Self {
        measured: BodyNoise {
            quadrotor_m: 3e-4,
            attitude: 1e-3,
            end_effector_m: 3e-4,
        },
        process: BodyNoise {
            quadrotor_m: 5e-4,
            attitude: 4e-3,
            end_effector_m: 1e-3,
        },
        disturbance: BodyNoise {
            quadrotor_m: 5e-5,
            attitude: 1e-4,
            end_effector_m: 1e-4,
        },
        gust: BodyNoise {
            quadrotor_m: 5e-4,
            attitude: 1e-3,
            end_effector_m: 1e-3,
        },
        surroundings: SurroundingsNoise::TYPICAL,
        gust_s: 1.0,
        delay: 2e-3,
        delay_initial: 1.0,
    };

    /// For the physical family, where nothing was identified.
    pub const PHYSICAL: Self = Self {
        measured: BodyNoise {
            quadrotor_m: 3e-4,
            attitude: 1e-3,
            end_effector_m: 3e-4,
        },
        process: BodyNoise {
            quadrotor_m: 1.0,
            attitude: 1.0,
            end_effector_m: 4.0,
        },
        disturbance: BodyNoise {
            quadrotor_m: 2e-4,
            attitude: 1e-5,
            end_effector_m: 5e-4,
        },
        gust: BodyNoise {
            quadrotor_m: 1e-2,
            attitude: 1e-5,
            end_effector_m: 1e-2,
        },
        surroundings: SurroundingsNoise::TYPICAL,
        gust_s: 1.0,
        delay: 2e-3,
        delay_initial: 1.0,
    };

    /// How far the physical family's fast motions may be relied on, 0 to 1: the shares of process noise of quadrotor and
    /// end effector say by how much recorded flights went otherwise than their models foresaw from one knot to the next.
    pub(crate) fn trust(&self) -> f64 {
        let shares = self.process.quadrotor_m * self.process.end_effector_m;
        (Self::TRUSTED_SHARES / shares).min(1.0)
    }

    /// Their product where a model foresees well: what is typical, or one of them twice that, for levels are identified to
    /// a factor of two.
    const TRUSTED_SHARES: f64 =
        2.0 * Self::PHYSICAL.process.quadrotor_m * Self::PHYSICAL.process.end_effector_m;

    /// Refuses a level that is out of its range.
    pub(crate) fn validate(&self) -> Result<(), NoiseLevelError> {
        let bodies = [
            ("measured", self.measured),
            ("process", self.process),
            ("disturbance", self.disturbance),
            ("gust", self.gust),
        ];
        let positive = bodies
            .into_iter()
            .flat_map(|(name, body)| body.entries().map(|level| (name, level)))
            .chain([
                ("gust_s", self.gust_s),
                ("delay", self.delay),
                ("delay_initial", self.delay_initial),
            ]);
        let SurroundingsNoise {
            wind_m_s,
            gust_m_s,
            tip_load,
        } = self.surroundings;
        let not_negative = [
            ("surroundings.wind_m_s", wind_m_s),
            ("surroundings.gust_m_s", gust_m_s),
            ("surroundings.tip_load", tip_load),
        ];
        // Not `<=` and `<`: NaN must be found.
        let bad_positive = positive
            .filter(|(_, level)| !(*level > 0.0 && level.is_finite()))
            .map(|level| (level, "a positive number"));
        let bad_not_negative = not_negative
            .into_iter()
            .filter(|(_, level)| !(*level >= 0.0 && level.is_finite()))
            .map(|level| (level, "a number ≥ 0"));
        match bad_positive.chain(bad_not_negative).next() {
            None => Ok(()),
            Some(((name, found), expected)) => Err(NoiseLevelError {
                name,
                found,
                expected,
            }),
        }
    }
}

/// A noise level that is out of its range, or not a number.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("noise level {name}: found {found}, expected {expected}")]
pub struct NoiseLevelError {
    /// Which.
    pub name: &'static str,
    /// Its value.
    pub found: f64,
    /// What would be accepted.
    pub expected: &'static str,
}
