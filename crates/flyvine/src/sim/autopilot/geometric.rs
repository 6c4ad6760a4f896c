//! A second flight controller, built differently from the cascade: geometric tracking control on SE(3)
//! (Lee, Leok, McClamroch, "Geometric Tracking Control of a Quadrotor UAV on SE(3)", CDC 2010) with integral
//! action. One force law from position and velocity errors, thrust projected on the actual body axis, one
//! torque law from the rotation error; no velocity setpoint, no rate loop. Controllers and planners that must
//! not assume PX4's structure can be tried on it.

use super::Estimate;
use super::position::{PositionCommand, ThrustModel, attitude_from_thrust};
use crate::GRAVITY;
use crate::sim::parameters::{Checker, ParameterError};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Gains and limits of the geometric controller.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GeometricParameters {
    /// Position gain, 1/s².
    pub position_gain: f64,
    /// Velocity gain, 1/s.
    pub velocity_gain: f64,
    /// Gain on the integral of the position error, 1/s³.
    pub integral_gain: f64,
    /// Longest position error that counts, m.
    pub max_error_m: f64,
    /// Greatest tilt wanted, degrees.
    pub tilt_max_deg: f64,
    /// Attitude gain, 1/s².
    pub attitude_gain: f64,
    /// Angular-velocity gain, 1/s.
    pub rate_gain: f64,
}

impl Default for GeometricParameters {
    fn default() -> Self {
        GeometricParameters {
            position_gain: 3.0,
            velocity_gain: 3.0,
            integral_gain: 0.4,
            max_error_m: 1.0,
            tilt_max_deg: 45.0,
            attitude_gain: 120.0,
            rate_gain: 20.0,
        }
    }
}

impl GeometricParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot.geometric");
        check.range("position_gain", self.position_gain, 0.01, 100.0, "1/s²")?;
        check.range("velocity_gain", self.velocity_gain, 0.01, 100.0, "1/s")?;
        check.range("integral_gain", self.integral_gain, 0.0, 100.0, "1/s³")?;
        check.range("max_error_m", self.max_error_m, 0.01, 10.0, "m")?;
        check.range("tilt_max_deg", self.tilt_max_deg, 5.0, 80.0, "degrees")?;
        check.range("attitude_gain", self.attitude_gain, 0.1, 5000.0, "1/s²")?;
        check.range("rate_gain", self.rate_gain, 0.1, 500.0, "1/s")
    }
}

/// The controller's memory.
#[derive(Debug, Clone)]
pub struct GeometricController {
    integral: Vector3<f64>,
}

impl GeometricController {
    /// Nothing integrated.
    pub fn new() -> GeometricController {
        GeometricController {
            integral: Vector3::zeros(),
        }
    }

    /// One period: collective thrust (N) and angular acceleration (body axes, rad/s²) wanted.
    pub fn update(
        &mut self,
        parameters: &GeometricParameters,
        command: &PositionCommand,
        estimate: &Estimate,
        thrust: &ThrustModel,
        period: f64,
    ) -> (f64, Vector3<f64>) {
        let error = (command.position - estimate.position).cap_magnitude(parameters.max_error_m);
        let mut acceleration = parameters.position_gain * error
            + parameters.velocity_gain * (command.velocity - estimate.velocity)
            + self.integral
            + Vector3::new(0.0, 0.0, GRAVITY);
        acceleration.z = acceleration.z.max(0.3 * GRAVITY);
        let steepest = parameters.tilt_max_deg.to_radians().tan() * acceleration.z;
        let horizontal = acceleration.xy();
        if horizontal.norm() > steepest {
            // Saturated: hold the integral, keep the direction.
            let scaled = horizontal * (steepest / horizontal.norm());
            acceleration.x = scaled.x;
            acceleration.y = scaled.y;
        } else {
            self.integral += period * parameters.integral_gain * error;
        }
        let force = acceleration * (thrust.hover_n / GRAVITY);

        let rotation = estimate.attitude.to_rotation_matrix().into_inner();
        let wanted = attitude_from_thrust(&force).to_rotation_matrix().into_inner();
        // e_R = ½ (R_dᵀ R − Rᵀ R_d)^∨
        let skew: Matrix3<f64> = wanted.tr_mul(&rotation) - rotation.tr_mul(&wanted);
        let rotation_error = 0.5 * Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
        let collective = force.dot(&rotation.column(2)).clamp(0.0, thrust.max_n);
        (
            collective,
            -parameters.attitude_gain * rotation_error - parameters.rate_gain * estimate.rate,
        )
    }
}

impl Default for GeometricController {
    fn default() -> Self {
        GeometricController::new()
    }
}
