//! Flight controller with the structure of PX4's multicopter cascade:
//! position P → velocity PID ([`position`]) → attitude P on quaternions ([`attitude`]) → rate PID ([`rate`]) →
//! mixer ([`mixer`]); and a second one of different structure ([`geometric`]). Frames are ENU and FLU instead of PX4's NED and FRD.

pub mod attitude;
pub mod geometric;
pub mod mixer;
pub mod position;
pub mod rate;

use super::history::History;
use super::parameters::{Checker, ParameterError};
use attitude::AttitudeParameters;
use geometric::{GeometricController, GeometricParameters};
use nalgebra::{UnitQuaternion, Vector3};
use position::{PositionCommand, PositionController, PositionParameters, Setpoint, ThrustModel};
use rate::{RateController, RateParameters};
use serde::{Deserialize, Serialize};

/// Which control law flies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Law {
    /// PX4's cascade.
    #[default]
    Cascade,
    /// Geometric tracking control.
    Geometric,
}

/// All gains and limits of the flight controller.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AutopilotParameters {
    /// Which control law flies; gains of the others are not used.
    pub law: Law,
    /// Delay from issuing a position command to the position controller seeing it, s.
    pub command_delay_s: f64,
    /// Chance that a command is lost on its way; the one before it stays in force.
    pub command_dropout_probability: f64,
    /// Age of the position and velocity that the position loop sees, s: motion capture, radio and estimator
    /// (what EKF2_EV_DELAY would have to make up for).
    pub estimate_delay_s: f64,
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
    /// Geometric control law.
    pub geometric: GeometricParameters,
    /// Drift of the heading estimate, degrees/s.
    pub yaw_drift_deg_s: f64,
}

impl Default for AutopilotParameters {
    fn default() -> Self {
        AutopilotParameters {
            law: Law::Cascade,
            command_delay_s: 0.05994,
            command_dropout_probability: 0.0,
            estimate_delay_s: 0.02207,
            rate_period_s: 0.0025,
            attitude_divider: 1,
            position_divider: 4,
            position: PositionParameters::default(),
            attitude: AttitudeParameters::default(),
            rate: RateParameters::default(),
            geometric: GeometricParameters::default(),
            yaw_drift_deg_s: 0.0,
        }
    }
}

impl AutopilotParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot");
        check.range("command_delay_s", self.command_delay_s, 0.0, 1.0, "s")?;
        check.range(
            "command_dropout_probability",
            self.command_dropout_probability,
            0.0,
            1.0,
            "",
        )?;
        check.range("estimate_delay_s", self.estimate_delay_s, 0.0, 0.5, "s")?;
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
        check.range("yaw_drift_deg_s", self.yaw_drift_deg_s, -10.0, 10.0, "degrees/s")?;
        self.geometric.validate()?;
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
    /// Positions and velocities, one per rate-loop period.
    history: History<(Vector3<f64>, Vector3<f64>)>,
    position: PositionController,
    rate: RateController,
    geometric: GeometricController,
    setpoint: Setpoint,
    rate_setpoint: Vector3<f64>,
    tick: u64,
}

impl Autopilot {
    /// Trimmed for hover with `hover_thrust_n`, at rest.
    pub fn hovering(parameters: &AutopilotParameters, hover_thrust_n: f64) -> Autopilot {
        Autopilot {
            history: History::new(
                parameters.estimate_delay_s,
                parameters.rate_period_s,
                (Vector3::zeros(), Vector3::zeros()),
            ),
            position: PositionController::new(),
            rate: RateController::new(),
            geometric: GeometricController::new(),
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
        command: &PositionCommand,
        estimate: &Estimate,
        thrust: &ThrustModel,
    ) -> (f64, Vector3<f64>) {
        let period = parameters.rate_period_s;
        if self.tick == 0 {
            self.history.fill((estimate.position, estimate.velocity));
        }
        self.history.push((estimate.position, estimate.velocity));
        let age = parameters.estimate_delay_s / period;
        let (new, old) = (
            self.history.back(age as usize),
            self.history.back(age as usize + 1),
        );
        let position = new.0.lerp(&old.0, age.fract());
        let velocity = new.1.lerp(&old.1, age.fract());
        let drift = parameters.yaw_drift_deg_s.to_radians() * self.tick as f64 * period;
        let attitude = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), drift) * estimate.attitude;
        let estimate = Estimate {
            position,
            velocity,
            attitude,
            rate: estimate.rate,
        };
        let tick = self.tick;
        self.tick += 1;
        match parameters.law {
            Law::Cascade => self.cascade(parameters, command, &estimate, thrust, tick),
            Law::Geometric => {
                self.geometric
                    .update(&parameters.geometric, command, &estimate, thrust, period)
            }
        }
    }

    fn cascade(
        &mut self,
        parameters: &AutopilotParameters,
        command: &PositionCommand,
        estimate: &Estimate,
        thrust: &ThrustModel,
        tick: u64,
    ) -> (f64, Vector3<f64>) {
        let period = parameters.rate_period_s;
        if tick.is_multiple_of(u64::from(parameters.position_divider)) {
            let period = period * f64::from(parameters.position_divider);
            self.setpoint = self
                .position
                .update(&parameters.position, command, estimate, thrust, period);
        }
        if tick.is_multiple_of(u64::from(parameters.attitude_divider)) {
            self.rate_setpoint =
                attitude::rate_setpoint(&parameters.attitude, &estimate.attitude, &self.setpoint.attitude);
        }
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
