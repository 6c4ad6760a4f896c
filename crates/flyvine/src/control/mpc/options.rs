//! Settings of model-predictive control, and the weights and limits that follow from them.

use super::condensed::{CondensedError, TrackingWeights};
use super::horizon::{HorizonLimits, SoftBound};
use crate::control::Trajectory;
use crate::control::estimator::EstimatorError;
use crate::control::supervisor::Room;
use crate::model::{Model, NoiseLevels, ScheduledModel};
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};

/// Settings of the controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MpcOptions {
    /// Stages of the horizon.
    pub stages: usize,
    /// Weight on the squared distance of the end effector from its reference, 1/m².
    pub end_effector: f64,
    /// Weight on every other entry of the newest pose, from the plan's.
    pub pose: f64,
    /// Weight on the command's deviation from the plan's; without it 5 on lag models, 1 on physical ones, and on those
    /// whose noise was identified 0.1 to 100, by how well they foresee and how hard the wind blows.
    pub command: Option<f64>,
    /// Weight on the change of that deviation from one knot to the next; without it 10, or 0.1 to 100 as above. With either
    /// weight given, both stay what they are, whatever the wind. Under light weights the horizon relies on the model's fast motions: an arm that bounces along its axis, which
    /// no model knows, has been seen to be shaken up by it.
    pub command_change: Option<f64>,
    /// Largest change of the command from one knot to the next, m.
    pub command_change_max_m: f64,
    /// Greatest distance of the command from the plan's, along each axis, m.
    pub command_deviation_max_m: f64,
    /// Error of the end effector up to which the command may be that far from the plan's, m. Beyond it less and less is
    /// allowed, at twice it nothing: a model that is so wrong must not fly the vehicle, and the plan alone is stable.
    pub trusted_error_m: f64,
    /// How far inside the room's walls the soft bounds are, m.
    pub room_margin_m: f64,
    /// Cost of leaving them, per m².
    pub room_penalty: f64,
    /// Noise levels of the estimator, instead of the bank's.
    pub noise: Option<NoiseLevels>,
}

impl Default for MpcOptions {
    fn default() -> Self {
        Self {
            stages: 25,
            end_effector: 100.0,
            pose: 0.1,
            command: None,
            command_change: None,
            command_change_max_m: 0.5,
            command_deviation_max_m: 0.5,
            trusted_error_m: 0.35,
            room_margin_m: 0.1,
            room_penalty: 1e4,
            noise: None,
        }
    }
}

/// A plan that cannot be flown by model-predictive control.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MpcError {
    /// The horizon is degenerate.
    #[error(transparent)]
    Condensed(#[from] CondensedError),
    /// The model or noise levels do not suit the estimator.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// A setting that is not a number in its range.
    #[error("MPC option {name}: found {found}, expected {expected}")]
    Option {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What would be accepted.
        expected: &'static str,
    },
    /// The reference does not belong to the trajectory.
    #[error("the end-effector reference has {found} knots; expected the trajectory's {expected}")]
    Reference {
        /// Knots of the reference.
        found: usize,
        /// Knots of the trajectory.
        expected: usize,
    },
}

impl MpcOptions {
    pub(super) fn validate(&self) -> Result<(), MpcError> {
        let positive = [
            ("stages", self.stages as f64),
            ("command", self.command.unwrap_or(1.0)),
            ("command_change_max_m", self.command_change_max_m),
            ("command_deviation_max_m", self.command_deviation_max_m),
            ("trusted_error_m", self.trusted_error_m),
            ("room_penalty", self.room_penalty),
        ];
        let not_negative = [
            ("end_effector", self.end_effector),
            ("pose", self.pose),
            ("command_change", self.command_change.unwrap_or(0.0)),
            ("room_margin_m", self.room_margin_m),
        ];
        for (name, found) in positive {
            // Not `<=`: NaN must fail.
            if !(found > 0.0 && found.is_finite()) {
                let expected = "a positive number";
                return Err(MpcError::Option {
                    name,
                    found,
                    expected,
                });
            }
        }
        for (name, found) in not_negative {
            if !(found >= 0.0 && found.is_finite()) {
                let expected = "a number ≥ 0";
                return Err(MpcError::Option {
                    name,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// The weights, those on commands as light as they may become.
    pub(super) fn weights(&self, model: &ScheduledModel) -> TrackingWeights {
        let [command, command_change] = match model.at_knot(0) {
            Model::Lag(_) => [5.0, 10.0],
            Model::Physical(_) => physical_weights(model.identified_noise()),
        };
        let mut state = vec![0.0; model.state_len()];
        state[..6].fill(self.pose);
        state[6..9].fill(self.end_effector);
        TrackingWeights {
            state,
            command: vec![self.command.unwrap_or(command); 3],
            command_change: vec![self.command_change.unwrap_or(command_change); 3],
        }
    }

    /// The scales of the weights on commands between which the wind chooses, the lightest first.
    pub(super) fn command_scales(&self, model: &ScheduledModel) -> Vec<f64> {
        let weight = self.weights(model).command[0];
        let chosen = self.command.is_some() || self.command_change.is_some();
        match model.at_knot(0) {
            Model::Physical(_) if !chosen && model.identified_noise().is_some() => GUST_SCALES
                .into_iter()
                .filter(|scale| *scale == 1.0 || scale * weight <= CAUTIOUS)
                .collect(),
            _ => vec![1.0],
        }
    }
}

/// Weights on commands and on their changes where nothing says how well a physical model foresees.
const UNKNOWN: [f64; 2] = [1.0, 10.0];
/// Both for a model that foresees well, in strong gusts …
const TRUSTING: f64 = 0.1;
/// … and for one that does not: little more than the plan is flown.
const CAUTIOUS: f64 = 100.0;
/// By how much heavier they are where gusts are weaker.
const GUST_SCALES: [f64; 3] = [1.0, 3.0, 10.0];
/// Standard deviation of the gusts from which on the weights are lightest, m/s.
const STRONG_GUST_M_S: f64 = 0.3;
/// Standard deviation of gusts by the mean speed of the wind: 0.2 near the ground in the Dryden model (MIL-F-8785C, low
/// altitudes), 0.2 to 0.5 at these speeds in that of IEC 61400-1. The mean speed is known after a hover, and within a second of a
/// wind that gets up later; innovations say far less, as over a knot a gust moves nothing by more than the model's errors do.
const TURBULENCE_INTENSITY: f64 = 0.3;

/// The weights on commands and on their changes that suit a physical model's identified noise: commands that rely on what
/// happens from one knot to the next can be no better than what is foreseen of it.
fn physical_weights(noise: Option<&NoiseLevels>) -> [f64; 2] {
    match noise {
        Some(noise) => [(TRUSTING / noise.trust().powi(2)).min(CAUTIOUS); 2],
        None => UNKNOWN,
    }
}

/// Which of the `scales` suits a steady wind of this velocity, m/s. Its gusts have a standard deviation of a share of its
/// speed. What light weights gain is in proportion to the variance of the gusts that they fight; what they cost (of the
/// model's errors, which they feed back) is there in calm air, too: the scale is in inverse proportion to that variance, to
/// the nearest one as to factors.
pub(super) fn scale_for_wind([x, y]: [f64; 2], scales: &[f64]) -> usize {
    let wanted = (STRONG_GUST_M_S / (TURBULENCE_INTENSITY * x.hypot(y))).powi(2);
    scales
        .windows(2)
        .take_while(|pair| wanted * wanted > pair[0] * pair[1])
        .count()
}

/// The commands within the trajectory's bounds and the room; quadrotor and tip inside the room, softly.
pub(super) fn limits(trajectory: &Trajectory, room: &Room, options: &MpcOptions) -> HorizonLimits {
    let walls = [room.x_m, room.y_m, room.quadrotor_z_m];
    let (lower, upper) = trajectory.command_bounds();
    let margin = options.room_margin_m;
    let mut states: Vec<SoftBound> = (0..3)
        .map(|axis| SoftBound {
            index: axis,
            lower: walls[axis][0] + margin,
            upper: walls[axis][1] - margin,
        })
        .collect();
    for (axis, wall) in [room.x_m, room.y_m].into_iter().enumerate() {
        states.push(SoftBound {
            index: 6 + axis,
            lower: wall[0] + margin,
            upper: wall[1] - margin,
        });
    }
    states.push(SoftBound {
        index: 8,
        lower: room.end_effector_z_min_m + margin,
        upper: f64::INFINITY,
    });
    HorizonLimits {
        command_lower: (0..3).map(|axis| lower[axis].max(walls[axis][0])).collect(),
        command_upper: (0..3).map(|axis| upper[axis].min(walls[axis][1])).collect(),
        command_change: Some(vec![options.command_change_max_m; 3]),
        states,
        penalty: options.room_penalty,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worse_a_model_foresees_the_dearer_are_commands() {
        let weights = |quadrotor_m: f64, end_effector_m: f64| {
            let mut noise = NoiseLevels::PHYSICAL;
            (noise.process.quadrotor_m, noise.process.end_effector_m) = (quadrotor_m, end_effector_m);
            physical_weights(Some(&noise))
        };
        assert_eq!(physical_weights(None), UNKNOWN);
        assert_eq!(weights(1.0, 4.0), [TRUSTING; 2]);
        assert_eq!(weights(2.0, 4.0), [TRUSTING; 2]);
        assert!(weights(4.0, 8.0)[0] > 10.0 * TRUSTING);
        assert_eq!(weights(16.0, 16.0), [CAUTIOUS; 2]);
    }

    #[test]
    fn the_weaker_the_wind_the_dearer_are_commands() {
        let scale =
            |speed_m_s| GUST_SCALES[scale_for_wind([0.6 * speed_m_s, -0.8 * speed_m_s], &GUST_SCALES)];
        assert_eq!([3.0, 1.0, 0.8].map(scale), [1.0; 3]);
        assert_eq!(scale(0.5), 3.0);
        assert_eq!([0.35, 0.03, 0.0].map(scale), [10.0; 3]);
        assert_eq!(scale(f64::NAN), 1.0);
        // Where there is nothing to choose from, nothing is chosen.
        assert_eq!(scale_for_wind([0.0; 2], &[1.0]), 0);
    }
}
