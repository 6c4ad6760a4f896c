//! Attitude control on quaternions with reduced yaw authority (Brescianini, Hehn, D'Andrea, "Nonlinear
//! Quadrocopter Attitude Control", ETH Zurich, 2013), as in PX4's `AttitudeControl`.

use crate::sim::parameters::{Checker, ParameterError};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Gains and limits of the attitude loop; PX4's names in brackets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeParameters {
    /// Roll and pitch gain, 1/s (MC_ROLL_P, MC_PITCH_P).
    pub tilt_p: f64,
    /// Yaw gain, 1/s (MC_YAW_P).
    pub yaw_p: f64,
    /// Weight of yaw against tilt, 0 to 1 (MC_YAW_WEIGHT).
    pub yaw_weight: f64,
    /// Greatest roll and pitch rate wanted, degrees/s (MC_ROLLRATE_MAX, MC_PITCHRATE_MAX).
    pub tilt_rate_max_deg_s: f64,
    /// Greatest yaw rate wanted, degrees/s (MC_YAWRATE_MAX).
    pub yaw_rate_max_deg_s: f64,
}

impl Default for AttitudeParameters {
    fn default() -> Self {
        AttitudeParameters {
            tilt_p: 6.153,
            yaw_p: 2.8,
            yaw_weight: 0.4,
            tilt_rate_max_deg_s: 400.0,
            yaw_rate_max_deg_s: 200.0,
        }
    }
}

impl AttitudeParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot.attitude");
        check.range("tilt_p", self.tilt_p, 0.1, 50.0, "1/s")?;
        check.range("yaw_p", self.yaw_p, 0.0, 50.0, "1/s")?;
        check.range("yaw_weight", self.yaw_weight, 0.0, 1.0, "")?;
        check.range(
            "tilt_rate_max_deg_s",
            self.tilt_rate_max_deg_s,
            1.0,
            3000.0,
            "degrees/s",
        )?;
        check.range(
            "yaw_rate_max_deg_s",
            self.yaw_rate_max_deg_s,
            1.0,
            3000.0,
            "degrees/s",
        )
    }
}

/// Angular velocity (body axes, rad/s) that turns `attitude` towards `setpoint`.
pub fn rate_setpoint(
    parameters: &AttitudeParameters,
    attitude: &UnitQuaternion<f64>,
    setpoint: &UnitQuaternion<f64>,
) -> Vector3<f64> {
    // The shortest turn that brings the body's z axis onto the wanted one, without caring about yaw …
    let (now, wanted) = (attitude * Vector3::z(), setpoint * Vector3::z());
    let reduced = match UnitQuaternion::rotation_between(&now, &wanted) {
        Some(turn) => turn * attitude,
        None => *setpoint, // exactly upside down: any turn is as good
    };
    // … then a weighted share of the remaining yaw.
    let remaining = reduced.inverse() * setpoint;
    let yaw = 2.0 * remaining.k.atan2(remaining.w);
    let yaw = yaw - std::f64::consts::TAU * (yaw / std::f64::consts::TAU).round();
    let target = reduced * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), parameters.yaw_weight * yaw);

    // ω = P · 2 sgn(w) vec(q_e); the yaw gain makes up for the weight.
    let error = attitude.inverse() * target;
    let sign = if error.w < 0.0 { -2.0 } else { 2.0 };
    let yaw_p = if parameters.yaw_weight > 1e-4 {
        parameters.yaw_p / parameters.yaw_weight
    } else {
        0.0
    };
    let rate = sign
        * error
            .imag()
            .component_mul(&Vector3::new(parameters.tilt_p, parameters.tilt_p, yaw_p));
    let tilt = parameters.tilt_rate_max_deg_s.to_radians();
    let yaw = parameters.yaw_rate_max_deg_s.to_radians();
    Vector3::new(
        rate.x.clamp(-tilt, tilt),
        rate.y.clamp(-tilt, tilt),
        rate.z.clamp(-yaw, yaw),
    )
}
