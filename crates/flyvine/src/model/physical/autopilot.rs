//! The autopilot's cascade: position P → velocity PID with limits → attitude P → rate loop, thrust lag.

use super::limits::{limit_from_above, limit_from_below, limit_length, limit_vector};
use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::State;
use super::vector::{Attitude, Vector};
use crate::GRAVITY;

/// The yaw error counts this much of a tilt error in the attitude loop.
const YAW_WEIGHT: f64 = 0.4;
/// Smallest collective thrust per total mass, m/s².
const THRUST_MINIMUM: f64 = 1.0;

/// Rounding of that limit, m/s².
const THRUST_ROUNDING: f64 = 0.4;

/// Rates of change of the autopilot's part of the state.
pub struct AutopilotRates<S> {
    /// d rate integrator / dt, rad/s³, body coordinates.
    pub rate_integrator: Vector<S>,
    /// d integrator / dt, m/s³.
    pub integrator: Vector<S>,
    /// d filtered velocity / dt, m/s²: the measured acceleration.
    pub filtered_velocity: Vector<S>,
    /// The thrust to which the lagged thrust tends, m/s².
    pub thrust_setpoint: S,
    /// The angular acceleration to which the lagged one tends, rad/s², body coordinates.
    pub angular_acceleration_setpoint: Vector<S>,
}

/// What the autopilot is told.
pub struct Setpoint<S> {
    /// m.
    pub position: Vector<S>,
    /// How fast that moved since the command before, m/s: the velocity that some autopilots are told, too.
    pub velocity: Vector<S>,
    /// How fast that velocity changed, m/s².
    pub acceleration: Vector<S>,
}

/// Evaluates the cascade for `setpoint`.
#[inline(always)]
pub fn autopilot<S: Scalar>(
    parameters: &Parameters<S>,
    state: &State<S>,
    rotation: &Attitude<S>,
    setpoint: &Setpoint<S>,
) -> AutopilotRates<S> {
    let p = parameters;
    let per_axis = |horizontal: S, vertical: S, v: &Vector<S>| {
        let [x, y, z] = v.0;
        Vector([x * horizontal, y * horizontal, z * vertical])
    };

    // Position loop and feed-forward: v_sp = K (u − p) + f u̇, with limited speeds.
    let [vx, vy, vz] = per_axis(
        p.position_gain_xy,
        p.position_gain_z,
        &(setpoint.position - state.position),
    )
    .0;
    let [vx, vy] = limit_length([vx, vy], p.horizontal_speed_limit);
    let [vz] = limit_length([vz], p.vertical_speed_limit);
    let velocity_error = Vector([vx, vy, vz]) + setpoint.velocity * p.velocity_feedforward - state.velocity;

    // Velocity loop and feed-forward: a = P e + I − D v̇ + f ü, v̇ by a first-order high-pass of the velocity.
    let acceleration = (state.velocity - state.filtered_velocity) * p.derivative_time_constant.recip();
    let wanted = per_axis(p.velocity_gain_xy, p.velocity_gain_z, &velocity_error) + state.integrator
        - per_axis(p.derivative_gain_xy, p.derivative_gain_z, &acceleration)
        + setpoint.acceleration * p.acceleration_feedforward;

    // Tilt limit: horizontal part at most g tan(limit); thrust along (a_x, a_y, g).
    let [ax, ay] = limit_length([wanted.0[0], wanted.0[1]], p.tilt_limit.tan() * GRAVITY);
    let direction = Vector([ax, ay, S::from(GRAVITY)]);
    let up_setpoint = direction * direction.norm_squared().sqrt().recip();
    let lifted = limit_from_below(
        (wanted.0[2] + GRAVITY) / up_setpoint.0[2],
        THRUST_MINIMUM,
        THRUST_ROUNDING,
    );
    let total_mass = p.joint_mass + p.tip_mass + 1.0;
    let thrust_setpoint = limit_from_above(lifted, p.thrust_maximum / total_mass);

    // Integrator, with what the tilt limit cut off fed back (tracking anti-windup, gain 2 / P).
    let excess = Vector([wanted.0[0] - ax, wanted.0[1] - ay, S::from(0.0)]);
    let integrator = per_axis(
        p.integral_gain_xy,
        p.integral_gain_z,
        &(velocity_error - excess * (p.velocity_gain_xy.recip() * 2.0)),
    );

    // Attitude and rate loops: ω_sp = 2 K vec(q* ⊗ q_sp), ω̇_sp = K_ω (ω_sp − ω) + ∫ K_I (ω_sp − ω).
    let [rx, ry, rz] = rotation.half_rotation_to(&Attitude::from_up(&up_setpoint)).0;
    let error = Vector([rx, ry, rz * YAW_WEIGHT]) * (p.attitude_gain * 2.0);
    let rate_error = limit_vector(error, p.rate_limit) - state.body_rate;
    AutopilotRates {
        rate_integrator: rate_error * p.rate_integral_gain,
        integrator,
        filtered_velocity: acceleration,
        thrust_setpoint,
        angular_acceleration_setpoint: rate_error * p.rate_gain + state.rate_integrator,
    }
}
