//! The arm: rigid massless links with point masses at their outer ends, elastic damped joints, air drag.
//!
//! With link directions `d_i`, tensions `T_i`, masses `μ_i` (μ_0 = 1: the quadrotor) and all other forces per
//! mass in `A_i`, the accelerations are `a_i = A_i − (T_i d_i − T_{i+1} d_{i+1}) / μ_i`, and constant (or
//! growing) link lengths ask for
//!
//! ```text
//! d_i · (a_i − a_{i−1}) = κ_i = (l̇_i² − |ρ̇_i|²) / l_i,     ρ_i = r_i − r_{i−1}
//! ```
//!
//! which is a symmetric tridiagonal system for the tensions. The base `r_0` rides on the quadrotor, below
//! its reference point.

use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::{LINKS, State};
use super::vector::{Attitude, Vector};
use crate::GRAVITY;
use serde::{Deserialize, Serialize};

/// Length of the arm and how fast it grows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmLength {
    /// Rest distance from the quadrotor to the end effector, m.
    pub length_m: f64,
    /// Its rate of change, m/s.
    pub rate_m_s: f64,
}

impl ArmLength {
    /// An arm that does not grow.
    pub fn constant(length_m: f64) -> Self {
        ArmLength {
            length_m,
            rate_m_s: 0.0,
        }
    }
}

/// What the arm and gravity do to the vehicle.
pub struct ArmAccelerations<S> {
    /// Acceleration of the quadrotor, m/s².
    pub quadrotor: Vector<S>,
    /// Accelerations of the links' outer ends, m/s².
    pub points: [Vector<S>; LINKS],
    /// Torque of the arm on the quadrotor about its reference point, world coordinates, N m / kg.
    pub torque: Vector<S>,
}

/// One link as it hangs now.
#[derive(Clone, Copy)]
struct Link<S> {
    length: S,
    /// Unit vector outwards.
    direction: Vector<S>,
    /// Time derivative of the direction, 1/s.
    direction_rate: Vector<S>,
    /// Velocity of the outer end relative to the inner one, m/s.
    relative_velocity: Vector<S>,
}

/// Link lengths and their rates from the base outwards.
pub fn link_lengths<S: Scalar>(parameters: &Parameters<S>, arm: ArmLength) -> [(S, S); LINKS] {
    let length = -parameters.base_offset + arm.length_m;
    let outer = -parameters.joint_fraction + 1.0;
    [parameters.joint_fraction, outer].map(|share| (length * share, share * arm.rate_m_s))
}

/// Position and velocity of the arm's base, which rides on the quadrotor.
pub fn base<S: Scalar>(parameters: &Parameters<S>, state: &State<S>) -> (Vector<S>, Vector<S>) {
    let rotation = state.rotation();
    let offset = base_offset(parameters);
    (
        state.position + rotation.rotate(&offset),
        state.velocity + rotation.rotate(&state.body_rate.cross(&offset)),
    )
}

/// The base in body coordinates.
fn base_offset<S: Scalar>(parameters: &Parameters<S>) -> Vector<S> {
    Vector([S::from(0.0), S::from(0.0), -parameters.base_offset])
}

/// `θ / sin θ` as a function of `u = (1 − cos θ)/2`: the series `Σ (2ⁿ n!)² uⁿ / (2n + 1)!`, cut after u⁶,
/// so that a linear bending torque `k θ` stays smooth at any angle (4 % soft at 120°).
fn angle_over_sine<S: Scalar>(u: S) -> S {
    const SERIES: [f64; 7] = [
        1.0,
        2.0 / 3.0,
        8.0 / 15.0,
        16.0 / 35.0,
        128.0 / 315.0,
        256.0 / 693.0,
        1024.0 / 3003.0,
    ];
    let mut sum = S::from(SERIES[6]);
    for coefficient in SERIES[..6].iter().rev() {
        sum = sum * u + *coefficient;
    }
    sum
}

/// Accelerations of quadrotor and arm under thrust, gravity, drag in air that moves with `wind` (m/s), bending and the
/// links' tensions.
pub fn accelerations<S: Scalar>(
    parameters: &Parameters<S>,
    arm: ArmLength,
    state: &State<S>,
    rotation: &Attitude<S>,
    body_acceleration: &Vector<S>,
    wind: &Vector<S>,
) -> ArmAccelerations<S> {
    let p = parameters;
    let up = rotation.up();
    let masses = [p.joint_mass, p.tip_mass];
    let drags = [p.joint_drag, p.tip_drag];
    let stiffnesses = [p.base_stiffness, p.joint_stiffness];
    let dampings = [p.base_damping, p.joint_damping];

    // The base, and the rotational part of its acceleration, ω̇ × o + ω × (ω × o).
    let offset = base_offset(p);
    let rate = &state.body_rate;
    let base_rotational =
        rotation.rotate(&(body_acceleration.cross(&offset) + rate.cross(&rate.cross(&offset))));

    let lengths = link_lengths(p, arm);
    let mut inner = base(p, state);
    let links: [Link<S>; LINKS] = std::array::from_fn(|i| {
        let outer = (state.points[i], state.point_velocities[i]);
        let (length, length_rate) = lengths[i];
        let direction = (outer.0 - inner.0) * length.recip();
        let relative_velocity = outer.1 - inner.1;
        inner = outer;
        Link {
            length,
            direction,
            direction_rate: (relative_velocity - direction * length_rate) * length.recip(),
            relative_velocity,
        }
    });

    // The arm's forces other than tensions, on the quadrotor (index 0) and the points (from 1).
    let mut forces = [Vector::zero(); LINKS + 1];
    for i in 0..LINKS {
        let velocity = state.point_velocities[i] - *wind;
        let speed = (velocity.norm_squared() + 1e-6).sqrt();
        forces[i + 1] = forces[i + 1] - velocity * (drags[i] * speed);
    }

    // Bending: joint i turns link i towards its inner neighbour (for i = 0 the body's down-axis) and the
    // neighbour towards link i, with torque k θ, less damping.
    let mut torque = Vector::zero();
    for i in 0..LINKS {
        let link = &links[i];
        let (neighbour, neighbour_rate) = if i == 0 {
            let down = up.scale(-1.0);
            (down, rotation.rotate(rate).cross(&down))
        } else {
            (links[i - 1].direction, links[i - 1].direction_rate)
        };
        let half_versine = (S::from(1.0) - link.direction.dot(&neighbour)) * 0.5;
        let elastic = stiffnesses[i] * angle_over_sine(half_versine);
        let slip = (link.direction_rate - neighbour_rate) * dampings[i];
        // Torque on this link about the joint: d × (k n − c (ḋ − ṅ)); as a couple of forces at its ends.
        let pull = (neighbour * elastic - slip).perpendicular_to(&link.direction);
        let force = pull * link.length.recip();
        forces[i + 1] = forces[i + 1] + force;
        forces[i] = forces[i] - force;
        let reaction = (link.direction * elastic + slip).perpendicular_to(&neighbour);
        if i == 0 {
            torque = neighbour.cross(&reaction);
        } else {
            let force = reaction * links[i - 1].length.recip();
            forces[i] = forces[i] + force;
            forces[i - 1] = forces[i - 1] - force;
        }
    }

    // Accelerations without tensions.
    let total_mass = p.joint_mass + p.tip_mass + 1.0;
    let gravity = Vector::constant([0.0, 0.0, -GRAVITY]);
    let thrust = up * (state.thrust * total_mass) - (state.velocity - *wind) * p.quadrotor_drag;
    let mut free = [thrust + forces[0] + gravity; LINKS + 1];
    for i in 0..LINKS {
        free[i + 1] = forces[i + 1] * masses[i].recip() + gravity;
    }

    let tensions = tensions(&links, &lengths, &free, &masses, &base_rotational);
    let mut points = [Vector::zero(); LINKS];
    for i in 0..LINKS {
        let mut pull = links[i].direction * -tensions[i];
        if i + 1 < LINKS {
            pull = pull + links[i + 1].direction * tensions[i + 1];
        }
        points[i] = free[i + 1] + pull * masses[i].recip();
    }
    let pull = links[0].direction * tensions[0];
    ArmAccelerations {
        quadrotor: free[0] + pull,
        points,
        torque: torque + rotation.rotate(&offset).cross(&(forces[0] + pull)),
    }
}

/// Solves the tridiagonal system for the tensions (N / kg), from the tip inwards.
fn tensions<S: Scalar>(
    links: &[Link<S>; LINKS],
    lengths: &[(S, S); LINKS],
    free: &[Vector<S>; LINKS + 1],
    masses: &[S; LINKS],
    base_rotational: &Vector<S>,
) -> [S; LINKS] {
    let inverse: [S; LINKS] = masses.map(Scalar::recip);
    let mut diagonal = [S::from(0.0); LINKS];
    let mut right = [S::from(0.0); LINKS];
    let mut coupling = [S::from(0.0); LINKS];
    for i in 0..LINKS {
        let (length, length_rate) = lengths[i];
        let curvature = (length_rate * length_rate - links[i].relative_velocity.norm_squared()) / length;
        let mut relative = free[i + 1] - free[i];
        diagonal[i] = inverse[i] + 1.0;
        if i == 0 {
            relative = relative - *base_rotational;
        } else {
            diagonal[i] = inverse[i] + inverse[i - 1];
            coupling[i] = -(inverse[i - 1] * links[i].direction.dot(&links[i - 1].direction));
        }
        right[i] = links[i].direction.dot(&relative) - curvature;
    }
    for i in (1..LINKS).rev() {
        let factor = coupling[i] / diagonal[i];
        diagonal[i - 1] = diagonal[i - 1] - factor * coupling[i];
        right[i - 1] = right[i - 1] - factor * right[i];
    }
    let mut tensions = [S::from(0.0); LINKS];
    for i in 0..LINKS {
        let known = if i == 0 {
            right[i]
        } else {
            right[i] - coupling[i] * tensions[i - 1]
        };
        tensions[i] = known / diagonal[i];
    }
    tensions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::physical::step::step;

    fn swinging() -> (Parameters<f64>, State<f64>) {
        let parameters = Parameters::defaults();
        let mut state = State::rest(&parameters, 0.8, [0.0, 0.0, 1.5]);
        let command = Vector([1.0, -0.6, 1.6]);
        for _ in 0..12 {
            state = step(&parameters, ArmLength::constant(0.8), &state, &command);
        }
        (parameters, state)
    }

    /// Newton's third law: bending and tensions are internal, so the centre of mass feels thrust, gravity and
    /// drag alone.
    #[test]
    fn internal_forces_cancel() {
        let (p, state) = swinging();
        let rotation = state.rotation();
        let arm = ArmLength::constant(0.8);
        let wind = Vector([1.1, -0.7, 0.2]);
        let result = accelerations(&p, arm, &state, &rotation, &Vector([0.3, -0.2, 0.1]), &wind);
        let mut expected = rotation.up() * (state.thrust * (1.0 + p.joint_mass + p.tip_mass))
            - (state.velocity - wind) * p.quadrotor_drag;
        let mut momentum = result.quadrotor;
        let gravity = Vector([0.0, 0.0, -GRAVITY]);
        expected = expected + gravity;
        for (i, (mass, drag)) in [(p.joint_mass, p.joint_drag), (p.tip_mass, p.tip_drag)]
            .into_iter()
            .enumerate()
        {
            let velocity = state.point_velocities[i] - wind;
            let speed = (velocity.norm_squared() + 1e-6).sqrt();
            momentum = momentum + result.points[i] * mass;
            expected = expected + gravity * mass - velocity * (drag * speed);
        }
        for (found, expected) in momentum.0.iter().zip(expected.0) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn tensions_keep_the_links_lengths() {
        let (p, state) = swinging();
        let rotation = state.rotation();
        let body_acceleration = Vector([0.3, -0.2, 0.1]);
        let result = accelerations(
            &p,
            ArmLength::constant(0.8),
            &state,
            &rotation,
            &body_acceleration,
            &Vector([1.1, -0.7, 0.2]),
        );
        let offset = base_offset(&p);
        let rate = state.body_rate;
        let rotational = body_acceleration.cross(&offset) + rate.cross(&rate.cross(&offset));
        let (base, base_velocity) = base(&p, &state);
        let mut inner = (
            base,
            base_velocity,
            result.quadrotor + rotation.rotate(&rotational),
        );
        for i in 0..LINKS {
            let outer = (state.points[i], state.point_velocities[i], result.points[i]);
            let (span, velocity) = (outer.0 - inner.0, outer.1 - inner.1);
            // d²/dt² |ρ|² / 2 = |ρ̇|² + ρ · ρ̈ = 0
            let curvature = velocity.norm_squared() + span.dot(&(outer.2 - inner.2));
            assert!(curvature.abs() < 1e-9, "link {i}: {curvature}");
            inner = outer;
        }
    }

    #[test]
    fn bending_torque_is_linear_in_the_angle() {
        for degrees in [1.0_f64, 30.0, 60.0, 90.0] {
            let angle = degrees.to_radians();
            let torque = angle_over_sine((1.0 - angle.cos()) / 2.0) * angle.sin();
            assert!((torque / angle - 1.0).abs() < 0.01, "{degrees}°: {torque}");
        }
    }
}
