//! The multibody system: a rigid base (or a fixed clamp) and a chain of rigid links on ball joints.
//!
//! # Coordinates
//!
//! Reduced: base position and attitude, one quaternion `world_from_link` per link, and the angular
//! velocity of each in the world frame. A link's axis is `d = R (0, 0, −1)`, so at rest the arm hangs.
//! Joint positions, link velocities and accelerations follow from the base outwards:
//!
//! ```text
//! p_{i+1} = p_i + l_i d_i
//! a_{i+1} = a_i + α_i × l d_i + ω_i × (ω_i × l d_i) + 2 l̇ ω_i × d_i + l̈ d_i
//! ```
//!
//! # Forces
//!
//! Joint i pulls link i towards link i−1 with the torque `−k φ s(|φ|) − c ω_rel`, where φ is the rotation
//! vector from parent to child and `s = 1 / sqrt(1 + (k|φ|/M)²)` softens the spring where an inflated beam
//! wrinkles (collapse moment M), and where there is hysteresis, that of its [`ElastoSlip`]. The tip may slide along the last link's axis against a spring. Links and tip
//! feel quadratic air drag, the base a linear one.

use super::hysteresis::ElastoSlip;
use super::rotation::{axis, bend};
use super::state::ChainState;
use nalgebra::{UnitQuaternion, Vector3};

/// One rigid, axisymmetric link, hanging from its joint along its axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Distance from this link's joint to the next one, m.
    pub length_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Distance from the joint to the centre of mass along the axis, m.
    pub center_m: f64,
    /// Moment of inertia about an axis through the centre of mass across the link, kg m².
    pub inertia_transverse_kg_m2: f64,
    /// Moment of inertia about the link's axis, kg m².
    pub inertia_axial_kg_m2: f64,
    /// Drag force per squared air speed across the link, N/(m/s)².
    pub drag_normal: f64,
    /// Drag force per squared air speed along the link, N/(m/s)².
    pub drag_tangential: f64,
}

/// Elastic ball joint at the upper end of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Stiffness k, N m/rad.
    pub stiffness: f64,
    /// Damping c, N m s/rad.
    pub damping: f64,
    /// Moment M at which the spring saturates, N m; infinite for a linear spring.
    pub collapse_moment: f64,
    /// Hysteresis beside the spring; `None` for none.
    pub hysteresis: Option<ElastoSlip>,
}

/// Rigid body at the lower end of the last link, turning with it; it may slide along the link's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Distance from the end of the last link to the body's centre (the end effector), m.
    pub offset_m: f64,
    /// Moment of inertia about an axis through the centre across the arm, kg m².
    pub inertia_transverse_kg_m2: f64,
    /// Moment of inertia about the arm's axis, kg m².
    pub inertia_axial_kg_m2: f64,
    /// Drag force per squared air speed, N/(m/s)².
    pub drag: f64,
    /// How the tip slides along the arm's axis; `None` if it is fixed to the last link.
    pub slider: Option<Slider>,
}

/// Axial give of the tube, gathered at the tip: limp fabric folds and the coil inside pulls when the tension
/// falls below the tip's weight; both stretch when it rises above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slider {
    /// Tension at zero extension, N.
    pub rest_force: f64,
    /// Stiffness where shortened, N/m.
    pub slack_stiffness: f64,
    /// Stiffness where stretched, N/m.
    pub stretch_stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
}

impl Slider {
    /// Stiffness at an extension, N/m.
    pub(super) fn stiffness(&self, extension: f64) -> f64 {
        if extension < 0.0 {
            self.slack_stiffness
        } else {
            self.stretch_stiffness
        }
    }

    /// Force on the tip along the arm's axis, away from the clamp positive, N.
    pub(super) fn force(&self, extension: f64, rate: f64) -> f64 {
        -self.rest_force - self.stiffness(extension) * extension - self.damping * rate
    }
}

/// The free rigid body that carries the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Base {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Principal moments of inertia, body axes, kg m².
    pub inertia_kg_m2: [f64; 3],
    /// Distance from the centre of mass down to the first joint, body −z, m.
    pub clamp_offset_m: f64,
    /// Linear drag per body axis, N/(m/s).
    pub drag: [f64; 3],
}

/// Growth at the tip: all links lengthen alike, and the nodes slide along wall material that stands still.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Growth {
    /// l̇ of one link, m/s.
    pub link_rate: f64,
    /// l̈ of one link, m/s².
    pub link_acceleration: f64,
    /// Mass of the tube per length, kg/m.
    pub linear_density: f64,
}

/// The whole multibody system; immutable while it is integrated over a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// The flying body, or `None` for an arm clamped to the world's origin.
    pub base: Option<Base>,
    /// Links from the clamp outwards.
    pub links: Vec<Link>,
    /// Joints, one above each link.
    pub joints: Vec<Joint>,
    /// Body at the end.
    pub tip: Tip,
    /// Change of length.
    pub growth: Growth,
    /// Gravity, m/s², downwards positive.
    pub gravity: f64,
}

/// What acts on the chain from outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Thrust along the base's +z axis, N.
    pub thrust: f64,
    /// Torque on the base, body axes, N m.
    pub torque: Vector3<f64>,
    /// Velocity of the air, world frame, m/s.
    pub wind: Vector3<f64>,
    /// Force on the tip body's centre, world frame, N.
    pub tip_force: Vector3<f64>,
}

impl Default for Load {
    fn default() -> Self {
        Load {
            thrust: 0.0,
            torque: Vector3::zeros(),
            wind: Vector3::zeros(),
            tip_force: Vector3::zeros(),
        }
    }
}

impl Chain {
    /// Position of the first joint, m.
    pub fn clamp(&self, state: &ChainState) -> Vector3<f64> {
        match &self.base {
            Some(base) => state.position + base.clamp_offset_m * axis(&state.attitude),
            None => Vector3::zeros(),
        }
    }

    /// Calls `visit` with every joint's position and finally the end of the last link, m.
    pub fn for_each_node(&self, state: &ChainState, mut visit: impl FnMut(Vector3<f64>)) {
        let mut node = self.clamp(state);
        visit(node);
        for (link, q) in self.links.iter().zip(&state.links) {
            node += link.length_m * axis(q);
            visit(node);
        }
    }

    /// Position of the tip body's centre, the end effector, m.
    pub fn end_effector(&self, state: &ChainState) -> Vector3<f64> {
        let mut end = self.clamp(state);
        self.for_each_node(state, |node| end = node);
        end + (self.tip.offset_m + state.extension) * state.links.last().map_or(Vector3::zeros(), axis)
    }

    /// Position (m) and velocity (m/s) of the end effector.
    pub fn end_effector_motion(&self, state: &ChainState) -> (Vector3<f64>, Vector3<f64>) {
        let mut velocity =
            state.motion.linear + state.motion.angular.cross(&(self.clamp(state) - state.position));
        for (link, (q, rate)) in self.links.iter().zip(state.links.iter().zip(&state.motion.links)) {
            velocity += rate.cross(&(link.length_m * axis(q))) + self.growth.link_rate * axis(q);
        }
        if let (Some(q), Some(rate)) = (state.links.last(), state.motion.links.last()) {
            velocity += rate.cross(&((self.tip.offset_m + state.extension) * axis(q)))
                + state.motion.extension * axis(q);
        }
        (self.end_effector(state), velocity)
    }

    /// Kinetic and potential energy, J (potential zero at height 0 with straight joints). Growth terms,
    /// of the order of the growth rate squared, are left out.
    pub fn energy(&self, state: &ChainState) -> (f64, f64) {
        let (mut kinetic, mut potential) = (0.0, 0.0);
        let mut velocity = Vector3::zeros();
        let mut parent = UnitQuaternion::identity();
        if let Some(base) = &self.base {
            let rate = state.attitude.inverse() * state.motion.angular;
            let inertia = Vector3::from(base.inertia_kg_m2);
            kinetic += 0.5 * base.mass_kg * state.motion.linear.norm_squared()
                + 0.5 * inertia.component_mul(&rate).dot(&rate);
            potential += base.mass_kg * self.gravity * state.position.z;
            velocity = state.motion.linear
                + state
                    .motion
                    .angular
                    .cross(&(base.clamp_offset_m * axis(&state.attitude)));
            parent = state.attitude;
        }
        let mut node = self.clamp(state);
        let mut add = |mass: f64,
                       transverse: f64,
                       axial: f64,
                       center: Vector3<f64>,
                       v: Vector3<f64>,
                       spin: f64,
                       w2: f64| {
            kinetic +=
                0.5 * (mass * v.norm_squared() + transverse * (w2 - spin * spin) + axial * spin * spin);
            potential += mass * self.gravity * center.z;
        };
        let mut elastic = 0.0;
        for (i, (link, joint)) in self.links.iter().zip(&self.joints).enumerate() {
            let (d, rate) = (axis(&state.links[i]), state.motion.links[i]);
            let spin = rate.dot(&d);
            let across = rate.cross(&d);
            add(
                link.mass_kg,
                link.inertia_transverse_kg_m2,
                link.inertia_axial_kg_m2,
                node + link.center_m * d,
                velocity + link.center_m * across,
                spin,
                rate.norm_squared(),
            );
            let bend = bend(&parent, &state.links[i]);
            elastic += joint.energy(bend.norm());
            if let Some(hysteresis) = &joint.hysteresis {
                let bend = parent.inverse_transform_vector(&bend);
                elastic += hysteresis.energy(&bend, &state.sliders[i]);
            }
            parent = state.links[i];
            node += link.length_m * d;
            velocity += link.length_m * across;
            if i + 1 == self.links.len() {
                let t = &self.tip;
                add(
                    t.mass_kg,
                    t.inertia_transverse_kg_m2,
                    t.inertia_axial_kg_m2,
                    node + (t.offset_m + state.extension) * d,
                    velocity + (t.offset_m + state.extension) * across + state.motion.extension * d,
                    spin,
                    rate.norm_squared(),
                );
            }
        }
        if let Some(slider) = &self.tip.slider {
            let extension = state.extension;
            elastic += (slider.rest_force + 0.5 * slider.stiffness(extension) * extension) * extension;
        }
        (kinetic, potential + elastic)
    }
}

impl Chain {
    /// Moves the sliders of the joints' hysteresis to where the end of a step leaves them.
    pub(super) fn settle_sliders(&self, state: &mut ChainState) {
        let mut parent = match &self.base {
            Some(_) => state.attitude,
            None => UnitQuaternion::identity(),
        };
        for ((joint, child), slider) in self.joints.iter().zip(&state.links).zip(&mut state.sliders) {
            if let Some(hysteresis) = &joint.hysteresis {
                let bend = parent.inverse_transform_vector(&bend(&parent, child));
                *slider = hysteresis.settled(&bend, slider);
            }
            parent = *child;
        }
    }
}

impl Joint {
    /// Elastic torque on the child, world frame, N m, at a bend φ (world frame) with the hysteresis' slider (parent's
    /// axes).
    pub(super) fn spring(
        &self,
        bend: &Vector3<f64>,
        parent: &UnitQuaternion<f64>,
        slider: &Vector3<f64>,
    ) -> Vector3<f64> {
        let relative = self.stiffness / self.collapse_moment;
        let elastic = -self.stiffness / (1.0 + relative * relative * bend.norm_squared()).sqrt() * bend;
        match &self.hysteresis {
            None => elastic,
            Some(hysteresis) => {
                let torque = hysteresis.torque(&parent.inverse_transform_vector(bend), slider);
                elastic + parent.transform_vector(&torque)
            }
        }
    }

    /// Greatest stiffness, N m/rad: straight, and sticking.
    pub(super) fn greatest_stiffness(&self) -> f64 {
        self.stiffness + self.hysteresis.map_or(0.0, |hysteresis| hysteresis.stiffness)
    }

    /// Elastic energy at the bend angle, J: the integral of the softened spring.
    fn energy(&self, angle: f64) -> f64 {
        let x = (self.stiffness * angle / self.collapse_moment).powi(2);
        // (M²/k)(sqrt(1 + x) − 1) written without cancellation.
        self.stiffness * angle * angle / ((1.0 + x).sqrt() + 1.0)
    }
}
