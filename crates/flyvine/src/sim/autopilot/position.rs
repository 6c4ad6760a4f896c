//! Position P and velocity PID with thrust and tilt limits and tracking anti-windup, as PX4's
//! `PositionControl` does it.

use super::{Estimate, LowPass};
use crate::GRAVITY;
use crate::sim::parameters::{Checker, ParameterError};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Gains and limits of the position and velocity loops; PX4's names in brackets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PositionParameters {
    /// Horizontal position gain, 1/s (MPC_XY_P).
    pub xy_p: f64,
    /// Vertical position gain, 1/s (MPC_Z_P).
    pub z_p: f64,
    /// Horizontal velocity gain, 1/s (MPC_XY_VEL_P_ACC).
    pub xy_vel_p: f64,
    /// Horizontal velocity integral gain, 1/s² (MPC_XY_VEL_I_ACC).
    pub xy_vel_i: f64,
    /// Horizontal gain on the measured acceleration (MPC_XY_VEL_D_ACC).
    pub xy_vel_d: f64,
    /// Vertical velocity gain, 1/s (MPC_Z_VEL_P_ACC).
    pub z_vel_p: f64,
    /// Vertical velocity integral gain, 1/s² (MPC_Z_VEL_I_ACC).
    pub z_vel_i: f64,
    /// Vertical gain on the measured acceleration (MPC_Z_VEL_D_ACC).
    pub z_vel_d: f64,
    /// Cut-off of the low pass on the velocity's derivative, Hz (MPC_VELD_LP).
    pub velocity_derivative_cutoff_hz: f64,
    /// Greatest horizontal speed wanted, m/s (MPC_XY_VEL_MAX).
    pub xy_vel_max: f64,
    /// Greatest climb speed wanted, m/s (MPC_Z_VEL_MAX_UP).
    pub z_vel_max_up: f64,
    /// Greatest sink speed wanted, m/s (MPC_Z_VEL_MAX_DN).
    pub z_vel_max_down: f64,
    /// Greatest tilt wanted, degrees (MPC_TILTMAX_AIR).
    pub tilt_max_deg: f64,
    /// Smallest collective thrust as a share of the greatest (MPC_THR_MIN).
    pub thrust_min: f64,
    /// Greatest collective thrust as a share of the physical one (MPC_THR_MAX).
    pub thrust_max: f64,
    /// Share of thrust kept for horizontal control when the vertical axis saturates (MPC_THR_XY_MARG).
    pub thrust_xy_margin: f64,
}

impl Default for PositionParameters {
    fn default() -> Self {
        PositionParameters {
            xy_p: 1.54,
            z_p: 2.395,
            xy_vel_p: 3.694,
            xy_vel_i: 1.419,
            xy_vel_d: 1.208,
            z_vel_p: 6.199,
            z_vel_i: 7.145,
            z_vel_d: 0.0,
            velocity_derivative_cutoff_hz: 5.124,
            xy_vel_max: 12.0,
            z_vel_max_up: 3.0,
            z_vel_max_down: 1.5,
            tilt_max_deg: 45.0,
            thrust_min: 0.12,
            thrust_max: 1.0,
            thrust_xy_margin: 0.3,
        }
    }
}

impl PositionParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("autopilot.position");
        check.range("xy_p", self.xy_p, 0.0, 20.0, "1/s")?;
        check.range("z_p", self.z_p, 0.0, 20.0, "1/s")?;
        check.range("xy_vel_p", self.xy_vel_p, 0.01, 50.0, "1/s")?;
        check.range("xy_vel_i", self.xy_vel_i, 0.0, 50.0, "1/s²")?;
        check.range("xy_vel_d", self.xy_vel_d, 0.0, 5.0, "")?;
        check.range("z_vel_p", self.z_vel_p, 0.01, 50.0, "1/s")?;
        check.range("z_vel_i", self.z_vel_i, 0.0, 50.0, "1/s²")?;
        check.range("z_vel_d", self.z_vel_d, 0.0, 5.0, "")?;
        check.range(
            "velocity_derivative_cutoff_hz",
            self.velocity_derivative_cutoff_hz,
            0.1,
            1000.0,
            "Hz",
        )?;
        check.range("xy_vel_max", self.xy_vel_max, 0.1, 50.0, "m/s")?;
        check.range("z_vel_max_up", self.z_vel_max_up, 0.1, 50.0, "m/s")?;
        check.range("z_vel_max_down", self.z_vel_max_down, 0.1, 50.0, "m/s")?;
        check.range("tilt_max_deg", self.tilt_max_deg, 5.0, 80.0, "degrees")?;
        check.range("thrust_min", self.thrust_min, 0.0, 0.4, "")?;
        check.range("thrust_max", self.thrust_max, 0.5, 1.0, "")?;
        check.range("thrust_xy_margin", self.thrust_xy_margin, 0.0, 0.9, "")
    }
}

/// What the controller believes about thrust.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThrustModel {
    /// Thrust believed to hold the vehicle's weight, N (MPC_THR_HOVER).
    pub hover_n: f64,
    /// Thrust at full throttle, N.
    pub max_n: f64,
}

/// Where the vehicle shall be, and how fast it shall pass there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionCommand {
    /// Position, world frame, m.
    pub position: Vector3<f64>,
    /// Velocity fed forward, world frame, m/s; zero for a command of a position alone.
    pub velocity: Vector3<f64>,
}

impl PositionCommand {
    /// A position alone.
    pub fn at(position: Vector3<f64>) -> PositionCommand {
        PositionCommand {
            position,
            velocity: Vector3::zeros(),
        }
    }
}

/// Attitude and thrust wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// Attitude `world_from_body`, yaw zero.
    pub attitude: UnitQuaternion<f64>,
    /// Collective thrust, N.
    pub thrust_n: f64,
}

/// Position and velocity loops with their memory.
#[derive(Debug, Clone)]
pub struct PositionController {
    integral: Vector3<f64>,
    last_velocity: Option<Vector3<f64>>,
    derivative: LowPass,
}

impl PositionController {
    /// Nothing integrated.
    pub fn new() -> PositionController {
        PositionController {
            integral: Vector3::zeros(),
            last_velocity: None,
            derivative: LowPass::new(),
        }
    }

    /// One period of the position and velocity loops.
    pub fn update(
        &mut self,
        parameters: &PositionParameters,
        command: &PositionCommand,
        estimate: &Estimate,
        thrust: &ThrustModel,
        period: f64,
    ) -> Setpoint {
        let velocity_error = velocity_setpoint(parameters, command, &estimate.position) - estimate.velocity;
        let change = match self.last_velocity.replace(estimate.velocity) {
            Some(last) => (estimate.velocity - last) / period,
            None => Vector3::zeros(),
        };
        let measured = self
            .derivative
            .update(change, parameters.velocity_derivative_cutoff_hz, period);
        // a = P e + ∫I e − D v̇, the derivative on the measurement.
        let gain = |xy: f64, z: f64| Vector3::new(xy, xy, z);
        let acceleration = gain(parameters.xy_vel_p, parameters.z_vel_p).component_mul(&velocity_error)
            + self.integral
            - gain(parameters.xy_vel_d, parameters.z_vel_d).component_mul(&measured);

        let (force, mut error) = self.limit(parameters, &acceleration, velocity_error, thrust);
        // Tracking anti-windup: while saturated, the integrator moves towards what was produced.
        let produced = force.xy() * (GRAVITY / thrust.hover_n);
        if acceleration.xy().norm_squared() > produced.norm_squared() {
            let back = (2.0 / parameters.xy_vel_p) * (acceleration.xy() - produced);
            error.x -= back.x;
            error.y -= back.y;
        }
        self.integral += period * gain(parameters.xy_vel_i, parameters.z_vel_i).component_mul(&error);
        self.integral.z = self.integral.z.clamp(-GRAVITY, GRAVITY);
        Setpoint {
            attitude: attitude_from_thrust(&force),
            thrust_n: force.norm(),
        }
    }

    /// The thrust vector for an acceleration within tilt and thrust limits, and the velocity error with its
    /// vertical part stopped where more of it would only wind up the integrator.
    fn limit(
        &self,
        parameters: &PositionParameters,
        acceleration: &Vector3<f64>,
        mut error: Vector3<f64>,
        thrust: &ThrustModel,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let (lowest, highest) = (
            parameters.thrust_min * thrust.max_n,
            parameters.thrust_max * thrust.max_n,
        );
        // The direction assumes that gravity alone is held vertically; tilt is limited about the vertical.
        let horizontal = acceleration.xy();
        let slope = (horizontal.norm() / GRAVITY).min(parameters.tilt_max_deg.to_radians().tan());
        let direction = match horizontal.try_normalize(1e-12) {
            Some(heading) => Vector3::new(slope * heading.x, slope * heading.y, 1.0).normalize(),
            None => Vector3::z(),
        };
        // Vertical acceleration over the tilt's cosine.
        let collective = ((1.0 + acceleration.z / GRAVITY) * thrust.hover_n / direction.z).max(lowest);
        let mut force = collective * direction;
        if (force.z >= highest && error.z >= 0.0) || (collective <= lowest && error.z <= 0.0) {
            error.z = 0.0;
        }
        // Vertical first, but with a margin kept for the horizontal axes; those get what remains.
        let wanted = force.xy();
        let kept = wanted.norm().min(parameters.thrust_xy_margin * thrust.max_n);
        force.z = force.z.min((highest * highest - kept * kept).sqrt());
        let available = (highest * highest - force.z * force.z).max(0.0).sqrt();
        let scaled: Vector2<f64> = if wanted.norm() > available {
            wanted * (available / wanted.norm())
        } else {
            wanted
        };
        force.x = scaled.x;
        force.y = scaled.y;
        (force, error)
    }
}

impl Default for PositionController {
    fn default() -> Self {
        PositionController::new()
    }
}

/// `v = P (p_cmd − p) + v_cmd` within the speed limits: horizontally the position loop's part comes first and the
/// feed-forward gets what it leaves, as PX4's `PositionControl` has it.
fn velocity_setpoint(
    parameters: &PositionParameters,
    command: &PositionCommand,
    position: &Vector3<f64>,
) -> Vector3<f64> {
    let error = command.position - position;
    let horizontal = within(
        parameters.xy_p * error.xy(),
        command.velocity.xy(),
        parameters.xy_vel_max,
    );
    let vertical = (parameters.z_p * error.z + command.velocity.z)
        .clamp(-parameters.z_vel_max_down, parameters.z_vel_max_up);
    Vector3::new(horizontal.x, horizontal.y, vertical)
}

/// `first + s · second` with the greatest s ≤ 1 that keeps its length within `most`; `first` alone is cut.
fn within(first: Vector2<f64>, second: Vector2<f64>, most: f64) -> Vector2<f64> {
    let first = first.cap_magnitude(most);
    let squared = second.norm_squared();
    if squared == 0.0 || (first + second).norm() <= most {
        return first + second;
    }
    // |first + s second|² = most², the root that is not negative.
    let half = first.dot(&second);
    let share = ((half * half + squared * (most * most - first.norm_squared())).sqrt() - half) / squared;
    first + share * second
}

/// The attitude whose z axis points along the thrust, heading east (yaw zero).
pub(super) fn attitude_from_thrust(force: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = force.normalize();
    // x perpendicular to z in the vertical plane of the heading; the tilt limit keeps z away from it.
    let y = z.cross(&Vector3::x()).normalize();
    let x = y.cross(&z);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
        x, y, z,
    ])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feed_forward_gets_what_the_position_loop_leaves_of_the_speed() {
        let most = 5.0;
        let sum = within(Vector2::new(1.0, 0.5), Vector2::new(2.0, -1.0), most);
        assert_eq!(sum, Vector2::new(3.0, -0.5));
        for first in [Vector2::new(3.0, 1.0), Vector2::new(-3.0, 2.0), Vector2::zeros()] {
            let second = Vector2::new(9.0, 3.0);
            let sum = within(first, second, most);
            assert!((sum.norm() - most).abs() < 1e-12);
            let added = sum - first;
            assert!(added.dot(&second) >= 0.0 && (added.x * second.y - added.y * second.x).abs() < 1e-12);
        }
        let fast = within(Vector2::new(9.0, 0.0), Vector2::new(1.0, 0.0), most);
        assert!((fast - Vector2::new(most, 0.0)).norm() < 1e-12);
    }
}
