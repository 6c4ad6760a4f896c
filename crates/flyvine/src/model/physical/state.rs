//! The state of the physical model and its flat layout.

use super::arm::{ArmLength, base, link_lengths};
use super::parameters::Parameters;
use super::scalar::Scalar;
use super::vector::{Attitude, Vector};
use crate::GRAVITY;

/// Number of rigid links of the arm.
pub const LINKS: usize = 2;

/// Number of earlier commands that may still be in transport: the longest delay, in knots.
pub const COMMANDS: usize = 2;

/// Where the parts of the flat state begin.
pub mod offset {
    /// Position (3).
    pub const POSITION: usize = 0;
    /// Attitude (3).
    pub const ATTITUDE: usize = POSITION + 3;
    /// Tip (3), the last of the outputs.
    pub const TIP: usize = ATTITUDE + 3;
    /// Velocity (3).
    pub const VELOCITY: usize = TIP + 3;
    /// Body rate (3).
    pub const BODY_RATE: usize = VELOCITY + 3;
    /// Angular acceleration (3).
    pub const ANGULAR_ACCELERATION: usize = BODY_RATE + 3;
    /// Rate integrator (3).
    pub const RATE_INTEGRATOR: usize = ANGULAR_ACCELERATION + 3;
    /// Integrator (3).
    pub const INTEGRATOR: usize = RATE_INTEGRATOR + 3;
    /// Filtered velocity (3).
    pub const FILTERED_VELOCITY: usize = INTEGRATOR + 3;
    /// Thrust (1).
    pub const THRUST: usize = FILTERED_VELOCITY + 3;
    /// Commands in transport, the newest first (3 each).
    pub const COMMANDS: usize = THRUST + 1;
    /// Tip velocity (3).
    pub const TIP_VELOCITY: usize = COMMANDS + 3 * super::COMMANDS;
    /// Inner joints from the base outwards: position (3) and velocity (3) of each.
    pub const JOINTS: usize = TIP_VELOCITY + 3;
}

/// Length of the flat state: the nine outputs first, then what is hidden.
pub const STATE_LEN: usize = offset::JOINTS + 6 * (LINKS - 1);

/// Number of outputs `x ∈ R⁹`: quadrotor position, attitude vector part, end-effector position.
pub const OUTPUT_LEN: usize = 9;

/// State of quadrotor, autopilot and arm. World frame unless said otherwise. [`offset`] is its flat layout.
#[derive(Debug, Clone, Copy)]
pub struct State<S> {
    /// Quadrotor position, m.
    pub position: Vector<S>,
    /// Vector part of the attitude quaternion `world_from_body`.
    pub attitude: Vector<S>,
    /// Quadrotor velocity, m/s.
    pub velocity: Vector<S>,
    /// Angular velocity in body coordinates, rad/s.
    pub body_rate: Vector<S>,
    /// Angular acceleration that the motors produce, body coordinates, rad/s².
    pub angular_acceleration: Vector<S>,
    /// Integrator of the rate loop, body coordinates, rad/s².
    pub rate_integrator: Vector<S>,
    /// Integrator of the velocity loop, m/s².
    pub integrator: Vector<S>,
    /// Low-passed velocity, whose distance from the velocity gives the derivative term, m/s.
    pub filtered_velocity: Vector<S>,
    /// Collective thrust per total mass, m/s².
    pub thrust: S,
    /// The commands of the previous knots, still in transport, the newest first, m.
    pub commands: [Vector<S>; COMMANDS],
    /// Outer ends of the links from the base outwards, m; the last is the end effector.
    pub points: [Vector<S>; LINKS],
    /// Their velocities, m/s.
    pub point_velocities: [Vector<S>; LINKS],
}

impl<S: Scalar> State<S> {
    /// The state that poses suggest: the arm straight towards the end effector, velocities as given, and the
    /// autopilot as if the tilt were what it wants, so that its horizontal integrator is
    /// `I = a + D a − P (K (u − p) − v)` with `a = g tan(tilt)`. `command` is the command u in force.
    pub fn from_poses(
        parameters: &Parameters<S>,
        arm: ArmLength,
        outputs: &[f64; OUTPUT_LEN],
        velocity: [f64; 3],
        tip_velocity: [f64; 3],
        command: [f64; 3],
    ) -> Self {
        let [px, py, pz, ax, ay, az, tx, ty, tz] = *outputs;
        let velocity = Vector::constant(velocity);
        let swing = Vector::constant(tip_velocity) - velocity;
        let mut state = State {
            position: Vector::constant([px, py, pz]),
            attitude: Vector::constant([ax, ay, az]),
            velocity,
            body_rate: Vector::zero(),
            angular_acceleration: Vector::zero(),
            rate_integrator: Vector::zero(),
            integrator: Vector::zero(),
            filtered_velocity: velocity,
            thrust: S::from(GRAVITY),
            commands: [Vector::constant(command); COMMANDS],
            points: [Vector::zero(); LINKS],
            point_velocities: [velocity; LINKS],
        };
        let p = parameters;
        let up = state.rotation().up();
        for axis in 0..2 {
            let acceleration = up.0[axis] / up.0[2] * GRAVITY;
            let error =
                (state.commands[0].0[axis] - state.position.0[axis]) * p.position_gain_xy - velocity.0[axis];
            state.integrator.0[axis] =
                acceleration * (p.derivative_gain_xy + 1.0) - p.velocity_gain_xy * error;
            state.filtered_velocity.0[axis] = velocity.0[axis] - p.derivative_time_constant * acceleration;
        }
        let (base, _) = base(parameters, &state, &state.rotation());
        let span = Vector::constant([tx, ty, tz]) - base;
        let direction = span * span.norm_squared().sqrt().recip();
        let (mut reach, total) = (S::from(0.0), -parameters.base_offset + arm.length_m);
        for (i, (length, _)) in link_lengths(parameters, arm).into_iter().enumerate() {
            reach = reach + length;
            state.points[i] = base + direction * reach;
            state.point_velocities[i] = velocity + swing * (reach / total);
        }
        state
    }

    /// Hovering at rest at `position`, level, the arm straight down, commanded to stay.
    pub fn rest(parameters: &Parameters<S>, length_m: f64, position: [f64; 3]) -> Self {
        let [x, y, z] = position;
        let outputs = [x, y, z, 0.0, 0.0, 0.0, x, y, z - length_m];
        let arm = ArmLength::constant(length_m);
        Self::from_poses(parameters, arm, &outputs, [0.0; 3], [0.0; 3], position)
    }

    /// From the flat layout ([`STATE_LEN`] entries).
    pub fn from_flat(flat: &[S]) -> Self {
        let vector = |at: usize| Vector([flat[at], flat[at + 1], flat[at + 2]]);
        let mut points = [vector(offset::TIP); LINKS];
        let mut point_velocities = [vector(offset::TIP_VELOCITY); LINKS];
        for joint in 0..LINKS - 1 {
            points[joint] = vector(offset::JOINTS + 6 * joint);
            point_velocities[joint] = vector(offset::JOINTS + 6 * joint + 3);
        }
        State {
            position: vector(offset::POSITION),
            attitude: vector(offset::ATTITUDE),
            velocity: vector(offset::VELOCITY),
            body_rate: vector(offset::BODY_RATE),
            angular_acceleration: vector(offset::ANGULAR_ACCELERATION),
            rate_integrator: vector(offset::RATE_INTEGRATOR),
            integrator: vector(offset::INTEGRATOR),
            filtered_velocity: vector(offset::FILTERED_VELOCITY),
            thrust: flat[offset::THRUST],
            commands: std::array::from_fn(|knot| vector(offset::COMMANDS + 3 * knot)),
            points,
            point_velocities,
        }
    }

    /// Writes the flat layout into the first [`STATE_LEN`] entries of `flat`.
    pub fn write_flat(&self, flat: &mut [S]) {
        let mut put = |at: usize, vector: &Vector<S>| flat[at..at + 3].copy_from_slice(&vector.0);
        put(offset::POSITION, &self.position);
        put(offset::ATTITUDE, &self.attitude);
        put(offset::TIP, &self.points[LINKS - 1]);
        put(offset::VELOCITY, &self.velocity);
        put(offset::BODY_RATE, &self.body_rate);
        put(offset::ANGULAR_ACCELERATION, &self.angular_acceleration);
        put(offset::RATE_INTEGRATOR, &self.rate_integrator);
        put(offset::INTEGRATOR, &self.integrator);
        put(offset::FILTERED_VELOCITY, &self.filtered_velocity);
        for (knot, command) in self.commands.iter().enumerate() {
            put(offset::COMMANDS + 3 * knot, command);
        }
        put(offset::TIP_VELOCITY, &self.point_velocities[LINKS - 1]);
        for joint in 0..LINKS - 1 {
            put(offset::JOINTS + 6 * joint, &self.points[joint]);
            put(offset::JOINTS + 6 * joint + 3, &self.point_velocities[joint]);
        }
        flat[offset::THRUST] = self.thrust;
    }

    /// The outputs `x ∈ R⁹`.
    pub fn outputs(&self) -> [S; OUTPUT_LEN] {
        let ([a, b, c], [d, e, f]) = (self.position.0, self.attitude.0);
        let [x, y, z] = self.points[LINKS - 1].0;
        [a, b, c, d, e, f, x, y, z]
    }

    /// The attitude as a quaternion.
    #[inline(always)]
    pub fn rotation(&self) -> Attitude<S> {
        Attitude::from_vector_part(self.attitude)
    }
}
