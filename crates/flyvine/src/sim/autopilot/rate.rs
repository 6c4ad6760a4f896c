//! Angular-rate PID. Gains are in physical units: PX4's dimensionless gain times the angular acceleration of
//! a full-scale torque.

use super::LowPass;
use crate::sim::parameters::{Checker, ParameterError};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Gains and limits of the rate loop; PX4's names in brackets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RateParameters {
    /// Roll and pitch gain, 1/s (MC_ROLLRATE_P, MC_PITCHRATE_P).
    pub tilt_p: f64,
    /// Roll and pitch integral gain, 1/s² (MC_ROLLRATE_I, MC_PITCHRATE_I).
    pub tilt_i: f64,
    /// Roll and pitch gain on the angular acceleration (MC_ROLLRATE_D, MC_PITCHRATE_D).
    pub tilt_d: f64,
    /// Yaw gain, 1/s (MC_YAWRATE_P).
    pub yaw_p: f64,
    /// Yaw integral gain, 1/s² (MC_YAWRATE_I).
    pub yaw_i: f64,
    /// Cut-off of the low pass on the angular acceleration, Hz (IMU_DGYRO_CUTOFF).
    pub derivative_cutoff_hz: f64,
    /// Greatest integral, rad/s² (MC_RR_INT_LIM, MC_PR_INT_LIM, MC_YR_INT_LIM).
    pub integral_limit: f64,
}

impl Default for RateParameters {
    fn default() -> Self {
        RateParameters {
            tilt_p: 14.97,
            tilt_i: 30.0,
            tilt_d: 0.2,
            yaw_p: 8.0,
            yaw_i: 4.0,
            derivative_cutoff_hz: 30.0,
            integral_limit: 30.0,
        }
    }
}

impl RateParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot.rate");
        check.range("tilt_p", self.tilt_p, 0.1, 200.0, "1/s")?;
        check.range("tilt_i", self.tilt_i, 0.0, 2000.0, "1/s²")?;
        check.range("tilt_d", self.tilt_d, 0.0, 5.0, "")?;
        check.range("yaw_p", self.yaw_p, 0.0, 200.0, "1/s")?;
        check.range("yaw_i", self.yaw_i, 0.0, 2000.0, "1/s²")?;
        check.range(
            "derivative_cutoff_hz",
            self.derivative_cutoff_hz,
            0.1,
            1000.0,
            "Hz",
        )?;
        check.range("integral_limit", self.integral_limit, 0.0, 1000.0, "rad/s²")
    }
}

/// The rate loop's memory.
#[derive(Debug, Clone)]
pub struct RateController {
    integral: Vector3<f64>,
    last_rate: Option<Vector3<f64>>,
    derivative: LowPass,
}

impl RateController {
    /// Nothing integrated.
    pub fn new() -> RateController {
        RateController {
            integral: Vector3::zeros(),
            last_rate: None,
            derivative: LowPass::new(),
        }
    }

    /// Angular acceleration wanted (body axes, rad/s²): `P e + ∫I e − D ω̇`.
    pub fn update(
        &mut self,
        parameters: &RateParameters,
        setpoint: &Vector3<f64>,
        rate: &Vector3<f64>,
        period: f64,
    ) -> Vector3<f64> {
        let error = setpoint - rate;
        let change = match self.last_rate.replace(*rate) {
            Some(last) => (rate - last) / period,
            None => Vector3::zeros(),
        };
        let measured = self
            .derivative
            .update(change, parameters.derivative_cutoff_hz, period);
        let axes = |tilt: f64, yaw: f64| Vector3::new(tilt, tilt, yaw);
        let demand = axes(parameters.tilt_p, parameters.yaw_p).component_mul(&error) + self.integral
            - axes(parameters.tilt_d, 0.0).component_mul(&measured);
        let limit = parameters.integral_limit;
        self.integral = (self.integral
            + period * axes(parameters.tilt_i, parameters.yaw_i).component_mul(&error))
        .map(|x| x.clamp(-limit, limit));
        demand
    }
}

impl Default for RateController {
    fn default() -> Self {
        RateController::new()
    }
}
