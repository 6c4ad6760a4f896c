//! Motion capture: poses with noise, dropouts and frozen frames.

use super::parameters::{Checker, ParameterError};
use super::wind::normal;
use crate::flight::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// Noise and faults of motion capture. The faults are off by default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MocapParameters {
    /// Standard deviation of a position, per axis, m.
    pub position_noise_m: f64,
    /// Standard deviation of an attitude, per axis, degrees.
    pub attitude_noise_deg: f64,
    /// Chance that a body is missed in a frame.
    pub dropout_probability: f64,
    /// Chance that a body's pose freezes at a frame; it then repeats exactly for `frozen_frames`.
    pub freeze_probability: f64,
    /// Length of a freeze, frames of 20 Hz.
    pub frozen_frames: u32,
}

impl Default for MocapParameters {
    fn default() -> Self {
        MocapParameters {
            position_noise_m: 3e-4,
            attitude_noise_deg: 0.1,
            dropout_probability: 0.0,
            freeze_probability: 0.0,
            frozen_frames: 3,
        }
    }
}

impl MocapParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("mocap");
        check.range("position_noise_m", self.position_noise_m, 0.0, 0.1, "m")?;
        check.range(
            "attitude_noise_deg",
            self.attitude_noise_deg,
            0.0,
            20.0,
            "degrees",
        )?;
        check.range("dropout_probability", self.dropout_probability, 0.0, 1.0, "")?;
        check.range("freeze_probability", self.freeze_probability, 0.0, 1.0, "")?;
        check.range(
            "frozen_frames",
            f64::from(self.frozen_frames),
            0.0,
            1000.0,
            "frames",
        )
    }
}

/// How many poses of either body the faults took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MocapFaults {
    /// Poses missed.
    pub dropped: usize,
    /// Poses repeated from an earlier frame.
    pub frozen: usize,
}

/// One tracked body: what it last showed, and for how many frames it will go on showing it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked<T> {
    last: Option<T>,
    frozen_for: u32,
}

impl<T> Default for Tracked<T> {
    fn default() -> Self {
        Tracked {
            last: None,
            frozen_for: 0,
        }
    }
}

impl<T: Copy> Tracked<T> {
    /// Passes `fresh` through the faults.
    fn observe(
        &mut self,
        parameters: &MocapParameters,
        fresh: T,
        faults: &mut MocapFaults,
        random: &mut impl Rng,
    ) -> Option<T> {
        // Both draws happen at every frame, so that one fault's rate does not change the other's stream.
        let dropped = random.random::<f64>() < parameters.dropout_probability;
        let freezes = random.random::<f64>() < parameters.freeze_probability;
        if self.frozen_for == 0 && freezes {
            self.frozen_for = parameters.frozen_frames;
        }
        let shown = match self.last {
            Some(last) if self.frozen_for > 0 => {
                self.frozen_for -= 1;
                faults.frozen += 1;
                last
            }
            _ => fresh,
        };
        self.last = Some(shown);
        if dropped {
            faults.dropped += 1;
            return None;
        }
        Some(shown)
    }
}

/// The motion-capture system watching the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mocap {
    quadrotor: Tracked<Pose>,
    end_effector: Tracked<[f64; 3]>,
    /// Faults since the start.
    pub faults: MocapFaults,
}

impl Mocap {
    /// One frame: quadrotor pose and end-effector position as measured.
    pub fn frame(
        &mut self,
        parameters: &MocapParameters,
        position: &Vector3<f64>,
        attitude: &UnitQuaternion<f64>,
        end_effector: &Vector3<f64>,
        random: &mut impl Rng,
    ) -> (Option<Pose>, Option<[f64; 3]>) {
        let position = position + parameters.position_noise_m * normal(random);
        let turn = parameters.attitude_noise_deg.to_radians() * normal(random);
        let tip = end_effector + parameters.position_noise_m * normal(random);
        let pose = pose(&position, &(UnitQuaternion::from_scaled_axis(turn) * attitude));
        (
            self.quadrotor.observe(parameters, pose, &mut self.faults, random),
            self.end_effector
                .observe(parameters, tip.into(), &mut self.faults, random),
        )
    }
}

/// A pose with the quaternion's sign chosen so that w ≥ 0.
pub(super) fn pose(position: &Vector3<f64>, attitude: &UnitQuaternion<f64>) -> Pose {
    let sign = if attitude.w < 0.0 { -1.0 } else { 1.0 };
    Pose {
        position: (*position).into(),
        attitude: [
            sign * attitude.w,
            sign * attitude.i,
            sign * attitude.j,
            sign * attitude.k,
        ],
    }
}
