//! Flight controller with the structure of PX4's multicopter cascade:
//! position P → velocity PID ([`position`]) → attitude P on quaternions ([`attitude`]) → rate PID ([`rate`]) →
//! mixer ([`mixer`]). Frames are ENU and FLU instead of PX4's NED and FRD.

pub mod attitude;
pub mod mixer;
pub mod position;
pub mod rate;

use super::parameters::{Checker, ParameterError};
use attitude::AttitudeParameters;
use nalgebra::{UnitQuaternion, Vector3};
use position::{PositionController, PositionParameters, Setpoint};
use rate::{RateController, RateParameters};
use serde::{Deserialize, Serialize};

/// All gains and limits of the flight controller.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AutopilotParameters {
    /// Delay from issuing a position command to the position controller seeing it, s.
    pub command_delay_s: f64,
    /// Period of the rate loop, s. The command period of 0.05 s must be a multiple.
    pub rate_period_s: f64,
    /// The attitude loop runs at every so many rate loops.
    pub attitude_divider: u32,
    /// The position and velocity loops run at every so many rate loops.
    pub position_divider: u32,
    /// Position and velocity loops.
    pub position: PositionParameters,
    /// Attitude loop.
    pub attitude: AttitudeParameters,
    /// Rate loop.
    pub rate: RateParameters,
}

impl Default for AutopilotParameters {
    fn default() -> Self {
        AutopilotParameters {
            command_delay_s: 0.0437,
            rate_period_s: 0.0025,
            attitude_divider: 1,
            position_divider: 4,
            position: PositionParameters::default(),
            attitude: AttitudeParameters::default(),
            rate: RateParameters::default(),
        }
    }
}

impl AutopilotParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot");
        check.range("command_delay_s", self.command_delay_s, 0.0, 1.0, "s")?;
        check.range("rate_period_s", self.rate_period_s, 1e-4, 0.02, "s")?;
        check.range(
            "attitude_divider",
            f64::from(self.attitude_divider),
            1.0,
            100.0,
            "",
        )?;
        check.range(
            "position_divider",
            f64::from(self.position_divider),
            1.0,
            100.0,
            "",
        )?;
        let ticks = crate::DT / self.rate_period_s;
        if (ticks - ticks.round()).abs() > 1e-9 * ticks {
            return Err(ParameterError::Contradiction {
                what: format!(
                    "autopilot.rate_period_s = {}: must divide the command period of {} s",
                    self.rate_period_s,
                    crate::DT
                ),
            });
        }
        self.position.validate()?;
        self.attitude.validate()?;
        self.rate.validate()
    }
}

/// What the flight controller knows of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Position, world frame, m.
    pub position: Vector3<f64>,
    /// Velocity, world frame, m/s.
    pub velocity: Vector3<f64>,
    /// Attitude `world_from_body`.
    pub attitude: UnitQuaternion<f64>,
    /// Angular velocity, body axes, rad/s.
    pub rate: Vector3<f64>,
}

/// The cascade with its state.
#[derive(Debug, Clone)]
pub struct Autopilot {
    position: PositionController,
    rate: RateController,
    setpoint: Setpoint,
    rate_setpoint: Vector3<f64>,
    tick: u64,
}

impl Autopilot {
    /// Trimmed for hover with `hover_thrust_n`, at rest at `attitude` identity.
    pub fn hovering(hover_thrust_n: f64) -> Autopilot {
        Autopilot {
            position: PositionController::new(),
            rate: RateController::new(),
            setpoint: Setpoint {
                attitude: UnitQuaternion::identity(),
                thrust_n: hover_thrust_n,
            },
            rate_setpoint: Vector3::zeros(),
            tick: 0,
        }
    }

    /// The newest attitude and thrust setpoint.
    pub fn setpoint(&self) -> &Setpoint {
        &self.setpoint
    }

    /// One period of the rate loop: collective thrust (N) and angular acceleration (body axes, rad/s²) wanted.
    pub fn update(
        &mut self,
        parameters: &AutopilotParameters,
        command: &Vector3<f64>,
        estimate: &Estimate,
        mass: &position::ThrustModel,
    ) -> (f64, Vector3<f64>) {
        let period = parameters.rate_period_s;
        if self.tick.is_multiple_of(u64::from(parameters.position_divider)) {
            let period = period * f64::from(parameters.position_divider);
            self.setpoint = self
                .position
                .update(&parameters.position, command, estimate, mass, period);
        }
        if self.tick.is_multiple_of(u64::from(parameters.attitude_divider)) {
            self.rate_setpoint =
                attitude::rate_setpoint(&parameters.attitude, &estimate.attitude, &self.setpoint.attitude);
        }
        self.tick += 1;
        let angular = self
            .rate
            .update(&parameters.rate, &self.rate_setpoint, &estimate.rate, period);
        (self.setpoint.thrust_n, angular)
    }
}

/// First-order low-pass filter `y += (x − y) · h/(h + 1/(2πf))`, as PX4's alpha filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LowPass(Vector3<f64>);

impl LowPass {
    pub(super) fn new() -> LowPass {
        LowPass(Vector3::zeros())
    }

    pub(super) fn update(&mut self, input: Vector3<f64>, cutoff_hz: f64, period: f64) -> Vector3<f64> {
        let alpha = period / (period + 1.0 / (std::f64::consts::TAU * cutoff_hz));
        self.0 += alpha * (input - self.0);
        self.0
    }
}
