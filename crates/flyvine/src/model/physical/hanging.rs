//! The arm as it hangs: rigid massless links with point masses at their outer ends, elastic damped joints, air drag.
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

use super::arm::{ArmLength, base, base_offset, link_lengths, unit};
use super::joints::{angle_over_sine, damped};
use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::{LINKS, State};
use super::step::SUBSTEP_S;
use super::vector::{Attitude, Vector};
use crate::GRAVITY;

const GRAVITY_VECTOR: [f64; 3] = [0.0, 0.0, -GRAVITY];

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

/// What is pulled at, besides by tensions.
struct Loads<S> {
    /// Forces on the quadrotor (index 0) and the points (from 1), N / kg.
    forces: [Vector<S>; LINKS + 1],
    /// Torque on the quadrotor, world coordinates, N m / kg.
    torque: Vector<S>,
}

/// The arm below the quadrotor, as it hangs now.
pub struct Hanging<'a, S> {
    parameters: &'a Parameters<S>,
    state: &'a State<S>,
    /// The state's.
    rotation: &'a Attitude<S>,
    /// Velocity of the air, m/s.
    wind: &'a Vector<S>,
    links: [Link<S>; LINKS],
    /// Lengths and their rates.
    lengths: [(S, S); LINKS],
    /// What joint i bends link i away from: for i = 0 the body's down-axis.
    neighbours: [Vector<S>; LINKS],
    /// The base from the quadrotor's reference point, world coordinates, m.
    offset: Vector<S>,
    /// The rotational part of its acceleration, ω̇ × o + ω × (ω × o), world coordinates, m/s².
    base_rotational: Vector<S>,
    /// Acceleration of the quadrotor without the arm, m/s².
    quadrotor: Vector<S>,
}

impl<'a, S: Scalar> Hanging<'a, S> {
    #[inline(always)]
    pub fn new(
        parameters: &'a Parameters<S>,
        arm: ArmLength,
        state: &'a State<S>,
        rotation: &'a Attitude<S>,
        wind: &'a Vector<S>,
    ) -> Self {
        let p = parameters;
        let up = rotation.up();
        let lengths = link_lengths(p, arm);
        let mut inner = base(p, state, rotation);
        let mut link = |i: usize| {
            let outer = (state.points[i], state.point_velocities[i]);
            let (length, length_rate) = lengths[i];
            // Of unit length whatever an estimator's correction did to the link's.
            let direction = unit(&(outer.0 - inner.0));
            let relative_velocity = outer.1 - inner.1;
            inner = outer;
            Link {
                length,
                direction,
                direction_rate: (relative_velocity - direction * length_rate) * length.recip(),
                relative_velocity,
            }
        };
        let links = [link(0), link(1)];
        let (offset, rate) = (base_offset(p), &state.body_rate);
        let total_mass = p.joint_mass + p.tip_mass + 1.0;
        Hanging {
            parameters,
            state,
            rotation,
            wind,
            lengths,
            neighbours: [up.scale(-1.0), links[0].direction],
            links,
            offset: rotation.rotate(&offset),
            base_rotational: rotation
                .rotate(&(state.angular_acceleration.cross(&offset) + rate.cross(&rate.cross(&offset)))),
            quadrotor: up * (state.thrust * total_mass) - (state.velocity - *wind) * p.quadrotor_drag
                + Vector::constant(GRAVITY_VECTOR),
        }
    }

    /// Accelerations of quadrotor and arm under thrust, gravity, drag, bending and the links' tensions.
    #[inline(always)]
    pub fn accelerations(&self) -> ArmAccelerations<S> {
        let mut loads = self.drag();
        self.add_elastic(&mut loads);
        let slips = self.slips_under(&self.accelerations_under(&loads));
        for (i, torque) in damped(self.parameters, &self.lengths, slips)
            .into_iter()
            .enumerate()
        {
            self.bend(i, &torque.scale(-1.0), &torque, &mut loads);
        }
        self.accelerations_under(&loads)
    }

    /// Quadratic air drag of the points.
    #[inline(always)]
    fn drag(&self) -> Loads<S> {
        let mut loads = Loads {
            forces: [Vector::zero(); LINKS + 1],
            torque: Vector::zero(),
        };
        let drags = [self.parameters.joint_drag, self.parameters.tip_drag];
        for i in 0..LINKS {
            let velocity = self.state.point_velocities[i] - *self.wind;
            let speed = (velocity.norm_squared() + 1e-6).sqrt();
            loads.forces[i + 1] = loads.forces[i + 1] - velocity * (drags[i] * speed);
        }
        loads
    }

    #[inline(always)]
    fn add_elastic(&self, loads: &mut Loads<S>) {
        let stiffnesses = [self.parameters.base_stiffness, self.parameters.joint_stiffness];
        for i in 0..LINKS {
            let (direction, neighbour) = (self.links[i].direction, self.neighbours[i]);
            let half_versine = (S::from(1.0) - direction.dot(&neighbour)) * 0.5;
            let elastic = stiffnesses[i] * angle_over_sine(half_versine);
            self.bend(i, &(neighbour * elastic), &(direction * elastic), loads);
        }
    }

    /// How fast links and their neighbours slip by each other at the substep's end under these accelerations, 1/s.
    #[inline(always)]
    fn slips_under(&self, undamped: &ArmAccelerations<S>) -> [Vector<S>; LINKS] {
        let (p, rotation) = (self.parameters, self.rotation);
        let body_torque = rotation.rotate_back(&undamped.torque) * p.arm_torque_gain;
        let body_acceleration = self.state.angular_acceleration + body_torque;
        let later_rate = self.state.body_rate + body_acceleration.scale(SUBSTEP_S);
        let mut neighbour_rate = rotation.rotate(&later_rate).cross(&self.neighbours[0]);
        let mut inner =
            undamped.quadrotor + self.base_rotational + rotation.rotate(&body_torque.cross(&base_offset(p)));
        let mut slips = [Vector::zero(); LINKS];
        for (i, link) in self.links.iter().enumerate() {
            let rate_change = (undamped.points[i] - inner) * link.length.recip();
            let link_rate = link.direction_rate + rate_change.scale(SUBSTEP_S);
            slips[i] = link_rate - neighbour_rate;
            (inner, neighbour_rate) = (undamped.points[i], link_rate);
        }
        slips
    }

    /// Adds the torque at joint i that the pulls `on_link` and `on_neighbour` make at the tips of the unit vectors along
    /// its link and its neighbour: as couples of forces at the ends of links and as a torque on the body.
    #[inline(always)]
    fn bend(&self, i: usize, on_link: &Vector<S>, on_neighbour: &Vector<S>, loads: &mut Loads<S>) {
        let (link, neighbour) = (&self.links[i], &self.neighbours[i]);
        let forces = &mut loads.forces;
        let force = on_link.perpendicular_to(&link.direction) * link.length.recip();
        forces[i + 1] = forces[i + 1] + force;
        forces[i] = forces[i] - force;
        let reaction = on_neighbour.perpendicular_to(neighbour);
        if i == 0 {
            loads.torque = loads.torque + neighbour.cross(&reaction);
        } else {
            let force = reaction * self.links[i - 1].length.recip();
            forces[i] = forces[i] + force;
            forces[i - 1] = forces[i - 1] - force;
        }
    }

    /// What `loads` and the tensions that they leave do.
    #[inline(always)]
    fn accelerations_under(&self, loads: &Loads<S>) -> ArmAccelerations<S> {
        let inverse_masses = [self.parameters.joint_mass, self.parameters.tip_mass].map(Scalar::recip);
        let mut free = [self.quadrotor + loads.forces[0]; LINKS + 1];
        for i in 0..LINKS {
            free[i + 1] = loads.forces[i + 1] * inverse_masses[i] + Vector::constant(GRAVITY_VECTOR);
        }
        let tensions = self.tensions(&free, &inverse_masses);
        let mut points = [Vector::zero(); LINKS];
        for i in 0..LINKS {
            let mut pull = self.links[i].direction * -tensions[i];
            if i + 1 < LINKS {
                pull = pull + self.links[i + 1].direction * tensions[i + 1];
            }
            points[i] = free[i + 1] + pull * inverse_masses[i];
        }
        let pull = self.links[0].direction * tensions[0];
        ArmAccelerations {
            quadrotor: free[0] + pull,
            points,
            torque: loads.torque + self.offset.cross(&(loads.forces[0] + pull)),
        }
    }

    /// Solves the tridiagonal system for the tensions (N / kg), from the tip inwards; `free` are accelerations without them.
    #[inline(always)]
    fn tensions(&self, free: &[Vector<S>; LINKS + 1], inverse: &[S; LINKS]) -> [S; LINKS] {
        let mut diagonal = [S::from(0.0); LINKS];
        let mut right = [S::from(0.0); LINKS];
        let mut coupling = [S::from(0.0); LINKS];
        for i in 0..LINKS {
            let (length, length_rate) = self.lengths[i];
            let curvature =
                (length_rate * length_rate - self.links[i].relative_velocity.norm_squared()) / length;
            let mut relative = free[i + 1] - free[i];
            diagonal[i] = inverse[i] + 1.0;
            if i == 0 {
                relative = relative - self.base_rotational;
            } else {
                diagonal[i] = inverse[i] + inverse[i - 1];
                coupling[i] = -(inverse[i - 1] * self.links[i].direction.dot(&self.links[i - 1].direction));
            }
            right[i] = self.links[i].direction.dot(&relative) - curvature;
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::physical::joints::mobility;
    use crate::model::physical::parameters::PARAMETERS;
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
        let (p, mut state) = swinging();
        state.angular_acceleration = Vector([0.3, -0.2, 0.1]);
        let rotation = state.rotation();
        let arm = ArmLength::constant(0.8);
        let wind = Vector([1.1, -0.7, 0.2]);
        let result = Hanging::new(&p, arm, &state, &rotation, &wind).accelerations();
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
        let (p, mut state) = swinging();
        let body_acceleration = Vector([0.3, -0.2, 0.1]);
        state.angular_acceleration = body_acceleration;
        let rotation = state.rotation();
        let arm = ArmLength::constant(0.8);
        let wind = Vector([1.1, -0.7, 0.2]);
        let result = Hanging::new(&p, arm, &state, &rotation, &wind).accelerations();
        let offset = base_offset(&p);
        let rate = state.body_rate;
        let rotational = body_acceleration.cross(&offset) + rate.cross(&rate.cross(&offset));
        let (base, base_velocity) = base(&p, &state, &rotation);
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
    fn unit_torques_turn_the_joints_as_the_mobility_says() {
        let p = Parameters::defaults();
        let state = State::rest(&p, 0.8, [0.0, 0.0, 1.5]);
        let arm = ArmLength::constant(0.8);
        let zero = Vector::zero();
        let rotation = state.rotation();
        let hanging = Hanging::new(&p, arm, &state, &rotation, &zero);
        // Angular accelerations of the joints about y under a torque at one of them.
        let turned = |at: Option<usize>| {
            let mut loads = Loads {
                forces: [zero; LINKS + 1],
                torque: zero,
            };
            let pull = Vector([1.0, 0.0, 0.0]);
            if let Some(joint) = at {
                hanging.bend(joint, &pull, &pull.scale(-1.0), &mut loads);
            }
            let moved = hanging.accelerations_under(&loads);
            let body = (moved.torque * p.arm_torque_gain).0[1];
            let base = moved.quadrotor.0[0] - body * p.base_offset;
            let [(inner, _), (outer, _)] = hanging.lengths;
            let [x, tip] = moved.points.map(|point| point.0[0]);
            let (first, second) = ((x - base) / inner, (tip - x) / outer);
            [first + body, second - first]
        };
        let still = turned(None);
        let column = |joint: usize| {
            let turned = turned(Some(joint));
            [turned[0] - still[0], turned[1] - still[1]]
        };
        let [w00, w01, w11] = mobility(&p, &hanging.lengths);
        for (found, expected) in [(column(0), [w00, w01]), (column(1), [w01, w11])] {
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
            }
        }
    }

    #[test]
    fn the_stiffest_damping_of_the_lightest_joint_is_stable() {
        let bound = |name: &str, upper: bool| {
            let info = PARAMETERS.iter().find(|info| info.name == name).unwrap();
            if upper { info.upper } else { info.lower }
        };
        let p = Parameters {
            base_damping: bound("base_damping", true),
            joint_damping: bound("joint_damping", true),
            joint_mass: bound("joint_mass", false),
            joint_fraction: bound("joint_fraction", false),
            ..Parameters::defaults()
        };
        let mut state = State::rest(&p, 0.7, [0.0, 0.0, 1.5]);
        let home = state.points[LINKS - 1];
        for knot in 0..400 {
            let command = if knot < 40 {
                [0.5, -0.5, 1.5]
            } else {
                [0.0, 0.0, 1.5]
            };
            state = step(&p, ArmLength::constant(0.7), &state, &Vector(command));
        }
        let away = state.points[LINKS - 1] - home;
        assert!(away.norm_squared().sqrt() < 0.01, "{away:?}");
    }
}
