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
//! wrinkles (collapse moment M). Links and tip feel quadratic air drag, the base a linear one.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

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
}

/// Rigid body at the lower end of the last link, moving as one with it.
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

/// Positions and velocities, all in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainState {
    /// Position of the base's centre of mass, m.
    pub position: Vector3<f64>,
    /// Attitude `world_from_body` of the base.
    pub attitude: UnitQuaternion<f64>,
    /// Attitudes `world_from_link`.
    pub links: Vec<UnitQuaternion<f64>>,
    /// Velocities.
    pub motion: Motion,
}

/// Velocities or accelerations of the coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Linear part of the base, m/s or m/s².
    pub linear: Vector3<f64>,
    /// Angular part of the base, rad/s or rad/s².
    pub angular: Vector3<f64>,
    /// Angular part of each link, rad/s or rad/s².
    pub links: Vec<Vector3<f64>>,
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

impl Motion {
    /// At rest, for `links` links.
    pub fn zeros(links: usize) -> Motion {
        Motion {
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
            links: vec![Vector3::zeros(); links],
        }
    }

    /// Copies `other`, of the same number of links, without allocating.
    pub fn copy_from(&mut self, other: &Motion) {
        self.linear = other.linear;
        self.angular = other.angular;
        self.links.copy_from_slice(&other.links);
    }

    /// `self += factor · other`.
    pub fn add_scaled(&mut self, factor: f64, other: &Motion) {
        self.linear += factor * other.linear;
        self.angular += factor * other.angular;
        for (a, b) in self.links.iter_mut().zip(&other.links) {
            *a += factor * b;
        }
    }
}

impl ChainState {
    /// At rest with the base at `position` and the arm hanging straight down.
    pub fn hanging(position: Vector3<f64>, links: usize) -> ChainState {
        ChainState {
            position,
            attitude: UnitQuaternion::identity(),
            links: vec![UnitQuaternion::identity(); links],
            motion: Motion::zeros(links),
        }
    }

    /// Copies `other`, of the same number of links, without allocating.
    pub fn copy_from(&mut self, other: &ChainState) {
        self.position = other.position;
        self.attitude = other.attitude;
        self.links.copy_from_slice(&other.links);
        self.motion.copy_from(&other.motion);
    }

    /// Moves the coordinates of `from` along `motion` for `duration`: `p + h v`, `exp(h ω) q`.
    pub fn advance(&mut self, from: &ChainState, duration: f64, motion: &Motion) {
        self.position = from.position + duration * motion.linear;
        self.attitude = rotate(duration * motion.angular, &from.attitude);
        for ((link, start), rate) in self.links.iter_mut().zip(&from.links).zip(&motion.links) {
            *link = rotate(duration * rate, start);
        }
    }

    /// True if every coordinate and velocity is finite.
    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        finite(&self.position)
            && finite(&self.motion.linear)
            && finite(&self.motion.angular)
            && self.motion.links.iter().all(finite)
            && self.attitude.coords.iter().all(|x| x.is_finite())
            && self.links.iter().all(|q| q.coords.iter().all(|x| x.is_finite()))
    }
}

/// `exp(rotation) q`, renormalized by one Newton step (the error per step is of the rounding's order).
fn rotate(rotation: Vector3<f64>, q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let squared = 0.25 * rotation.norm_squared();
    // sin(h)/h and cos(h) of the half angle h: series to double precision for h < 0.25, else closed form.
    let (cosine, sinc) = if squared < 0.0625 {
        (
            1.0 - squared / 2.0
                * (1.0
                    - squared / 12.0
                        * (1.0 - squared / 30.0 * (1.0 - squared / 56.0 * (1.0 - squared / 90.0)))),
            1.0 - squared / 6.0
                * (1.0
                    - squared / 20.0
                        * (1.0 - squared / 42.0 * (1.0 - squared / 72.0 * (1.0 - squared / 110.0)))),
        )
    } else {
        let half = squared.sqrt();
        (half.cos(), half.sin() / half)
    };
    let v = 0.5 * sinc * rotation;
    let product = nalgebra::Quaternion::new(cosine, v.x, v.y, v.z) * q.quaternion();
    UnitQuaternion::new_unchecked(product * (1.5 - 0.5 * product.norm_squared()))
}

/// Rotation vector of `child parent⁻¹`, world frame, rad: the bend of a joint.
pub(super) fn bend(parent: &UnitQuaternion<f64>, child: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = child.quaternion() * parent.quaternion().conjugate();
    let (w, v) = if q.w < 0.0 {
        (-q.w, -q.imag())
    } else {
        (q.w, q.imag())
    };
    let squared = v.norm_squared();
    // 2 asin(s)/s of the half angle's sine s: series to double precision for s < 0.1, else closed form.
    let scale = if squared < 0.01 {
        2.0 + squared
            * (1.0 / 3.0
                + squared
                    * (3.0 / 20.0
                        + squared
                            * (5.0 / 56.0
                                + squared
                                    * (35.0 / 576.0
                                        + squared * (63.0 / 1408.0 + squared * (231.0 / 6656.0))))))
    } else {
        let sine = squared.sqrt();
        2.0 * sine.atan2(w) / sine
    };
    scale * v
}

/// The link's axis d, pointing away from the clamp, world frame: `R (0, 0, −1)`.
pub(super) fn axis(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    Vector3::new(
        -2.0 * (x * z + w * y),
        -2.0 * (y * z - w * x),
        -1.0 + 2.0 * (x * x + y * y),
    )
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
        end + self.tip.offset_m * state.links.last().map_or(Vector3::zeros(), axis)
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
            elastic += joint.energy(bend(&parent, &state.links[i]).norm());
            parent = state.links[i];
            node += link.length_m * d;
            velocity += link.length_m * across;
            if i + 1 == self.links.len() {
                let t = &self.tip;
                add(
                    t.mass_kg,
                    t.inertia_transverse_kg_m2,
                    t.inertia_axial_kg_m2,
                    node + t.offset_m * d,
                    velocity + t.offset_m * across,
                    spin,
                    rate.norm_squared(),
                );
            }
        }
        (kinetic, potential + elastic)
    }
}

impl Joint {
    /// Elastic torque on the child for a bend φ, N m.
    fn spring(&self, bend: &Vector3<f64>) -> Vector3<f64> {
        let relative = self.stiffness / self.collapse_moment;
        -self.stiffness / (1.0 + relative * relative * bend.norm_squared()).sqrt() * bend
    }

    /// Elastic energy at the bend angle, J: the integral of the softened spring.
    fn energy(&self, angle: f64) -> f64 {
        let x = (self.stiffness * angle / self.collapse_moment).powi(2);
        // (M²/k)(sqrt(1 + x) − 1) written without cancellation.
        self.stiffness * angle * angle / ((1.0 + x).sqrt() + 1.0)
    }
}

/// Articulated inertia and bias of a subtree, as felt at a point: `n = J α + H a + n₀`, `f = Hᵀ α + M a + f₀`.
#[derive(Debug, Clone, Copy)]
struct Articulated {
    rotational: Matrix3<f64>,
    coupling: Matrix3<f64>,
    linear: Matrix3<f64>,
    torque: Vector3<f64>,
    force: Vector3<f64>,
}

impl Articulated {
    fn zeros() -> Articulated {
        Articulated {
            rotational: Matrix3::zeros(),
            coupling: Matrix3::zeros(),
            linear: Matrix3::zeros(),
            torque: Vector3::zeros(),
            force: Vector3::zeros(),
        }
    }
}

/// What the outward pass keeps of one joint for the last pass.
#[derive(Debug, Clone, Copy)]
struct JointPass {
    /// Link axis d.
    axis: Vector3<f64>,
    /// Velocity of the joint.
    velocity: Vector3<f64>,
    /// Velocity-dependent acceleration of the next joint relative to this one.
    bias: Vector3<f64>,
    /// Joint torque at the predicted accelerations, with the implicit term's share of the prediction.
    torque: Vector3<f64>,
    /// Implicit joint inertia γ.
    implicit: f64,
    /// D⁻¹ = (J + γ)⁻¹.
    inverse: Matrix3<f64>,
    /// D⁻¹ H.
    gain: Matrix3<f64>,
    /// D⁻¹ (τ − n₀).
    offset: Vector3<f64>,
}

/// Scratch memory of the articulated-body algorithm, for a fixed number of links.
#[derive(Debug, Clone)]
pub struct Workspace {
    joints: Vec<JointPass>,
}

impl Workspace {
    /// Scratch for `links` links.
    pub fn new(links: usize) -> Workspace {
        let zero = Vector3::zeros();
        let pass = JointPass {
            axis: zero,
            velocity: zero,
            bias: zero,
            torque: zero,
            implicit: 0.0,
            inverse: Matrix3::zeros(),
            gain: Matrix3::zeros(),
            offset: zero,
        };
        Workspace {
            joints: vec![pass; links],
        }
    }

    /// Accelerations of `chain` at `state` under `load`, by the articulated-body algorithm (Featherstone,
    /// "Rigid Body Dynamics Algorithms", 2008, ch. 7) written in world-aligned coordinates at the joints,
    /// where a ball joint's elimination needs one 3 × 3 inverse. O(links).
    ///
    /// With `implicit_step` η > 0 the joint forces are taken at the end of an implicit stage: linearized
    /// about `state`, which must have been reached with the accelerations `predicted`, they change by
    /// `−(η c + η² k)(α_rel − α̂_rel)`, which acts as extra joint inertia γ = η c + η² k. With η = 0 the
    /// result is the plain forward dynamics and `predicted` is not used.
    pub fn accelerations(
        &mut self,
        chain: &Chain,
        state: &ChainState,
        load: &Load,
        implicit_step: f64,
        predicted: &Motion,
        result: &mut Motion,
    ) {
        self.outward(chain, state, implicit_step, predicted);
        let root = self.inward(chain, state, load);
        let (angular, linear) = match &chain.base {
            Some(base) => base_acceleration(base, state, load, root),
            None => (Vector3::zeros(), Vector3::zeros()),
        };
        // Everything below the base is computed in a frame falling with gravity: a − g.
        let gravity = Vector3::new(0.0, 0.0, -chain.gravity);
        let mut joint_acceleration = match &chain.base {
            Some(base) => {
                let arm = base.clamp_offset_m * axis(&state.attitude);
                let rate = state.motion.angular;
                linear + angular.cross(&arm) + rate.cross(&rate.cross(&arm))
            }
            None => -gravity,
        };
        result.angular = angular;
        result.linear = if chain.base.is_some() {
            linear + gravity
        } else {
            linear
        };
        let mut parent = angular;
        for ((pass, link), alpha) in self.joints.iter().zip(&chain.links).zip(&mut result.links) {
            *alpha = pass.offset + pass.implicit * (pass.inverse * parent) - pass.gain * joint_acceleration;
            joint_acceleration += alpha.cross(&(link.length_m * pass.axis)) + pass.bias;
            parent = *alpha;
        }
    }

    /// Velocities, velocity-dependent accelerations and joint torques from the base outwards.
    fn outward(&mut self, chain: &Chain, state: &ChainState, implicit_step: f64, predicted: &Motion) {
        let growth = chain.growth;
        let (mut parent_attitude, mut parent_rate, mut parent_predicted) =
            (UnitQuaternion::identity(), Vector3::zeros(), Vector3::zeros());
        let mut velocity = Vector3::zeros();
        if let Some(base) = &chain.base {
            parent_attitude = state.attitude;
            parent_rate = state.motion.angular;
            parent_predicted = predicted.angular;
            velocity =
                state.motion.linear + parent_rate.cross(&(base.clamp_offset_m * axis(&state.attitude)));
        }
        for (i, pass) in self.joints.iter_mut().enumerate() {
            let (link, joint) = (&chain.links[i], &chain.joints[i]);
            let rate = state.motion.links[i];
            let d = axis(&state.links[i]);
            let across = rate.cross(&d);
            pass.axis = d;
            pass.velocity = velocity;
            pass.bias = link.length_m * rate.cross(&across)
                + 2.0 * growth.link_rate * across
                + growth.link_acceleration * d;
            velocity += link.length_m * across + growth.link_rate * d;

            pass.implicit = implicit_step * (joint.damping + implicit_step * joint.stiffness);
            pass.torque = joint.spring(&bend(&parent_attitude, &state.links[i]))
                - joint.damping * (rate - parent_rate)
                + pass.implicit * (predicted.links[i] - parent_predicted);
            parent_attitude = state.links[i];
            parent_rate = rate;
            parent_predicted = predicted.links[i];
        }
    }

    /// Articulated inertias from the tip inwards; returns what the base feels at the first joint.
    fn inward(&mut self, chain: &Chain, state: &ChainState, load: &Load) -> Articulated {
        let mut subtree = Articulated::zeros();
        for i in (0..self.joints.len()).rev() {
            let link = &chain.links[i];
            let pass = self.joints[i];
            let rate = state.motion.links[i];
            if i + 1 < self.joints.len() {
                subtree.shift(link.length_m * pass.axis, pass.bias);
            } else {
                let tip = &chain.tip;
                let reach = link.length_m + tip.offset_m;
                let velocity =
                    pass.velocity + reach * rate.cross(&pass.axis) + chain.growth.link_rate * pass.axis;
                let air = load.wind - velocity;
                // Relative to the link's own end the tip moves with the growth.
                let growth = 2.0 * chain.growth.link_rate * rate.cross(&pass.axis)
                    + chain.growth.link_acceleration * pass.axis;
                subtree.add_body(
                    &Body {
                        mass: tip.mass_kg,
                        center: reach,
                        transverse: tip.inertia_transverse_kg_m2,
                        axial: tip.inertia_axial_kg_m2,
                    },
                    pass.axis,
                    rate,
                    growth,
                );
                subtree.push(reach * pass.axis, tip.drag * air.norm() * air + load.tip_force);
            }
            // Wall material of link i slides back along the grid: its frame accelerates by −2 i l̇ ω × d − i l̈ d.
            let nodes = i as f64;
            let across = rate.cross(&pass.axis);
            let slide =
                -nodes * (2.0 * chain.growth.link_rate * across + chain.growth.link_acceleration * pass.axis);
            subtree.add_body(
                &Body {
                    mass: link.mass_kg,
                    center: link.center_m,
                    transverse: link.inertia_transverse_kg_m2,
                    axial: link.inertia_axial_kg_m2,
                },
                pass.axis,
                rate,
                slide,
            );
            let air = load.wind
                - (pass.velocity + link.center_m * across - nodes * chain.growth.link_rate * pass.axis);
            let along = air.dot(&pass.axis) * pass.axis;
            let normal = air - along;
            let drag =
                link.drag_normal * normal.norm() * normal + link.drag_tangential * along.norm() * along;
            subtree.push(link.center_m * pass.axis, drag);
            subtree.push(Vector3::zeros(), chain.material_flux(i, &self.joints));
            self.joints[i].eliminate(&mut subtree);
        }
        subtree
    }
}

impl Chain {
    /// Force at joint i from wall material that turns as it passes the kink, and at the last link also the
    /// reaction of the material laid down at the tip: `λ w² (d_i − d_{i−1})`, w the sliding speed, N.
    fn material_flux(&self, i: usize, joints: &[JointPass]) -> Vector3<f64> {
        let speed = |nodes: usize| nodes as f64 * self.growth.link_rate;
        let mut force = Vector3::zeros();
        if i > 0 {
            force += self.growth.linear_density * speed(i).powi(2) * (joints[i].axis - joints[i - 1].axis);
        }
        if i + 1 == joints.len() {
            force += self.growth.linear_density * speed(i + 1).powi(2) * joints[i].axis;
        }
        force
    }
}

/// An axisymmetric rigid body on a link's axis.
struct Body {
    mass: f64,
    center: f64,
    transverse: f64,
    axial: f64,
}

impl Articulated {
    /// Adds a body on the axis d through the reference point, turning at `rate`, whose frame accelerates by
    /// `extra` beyond the reference point.
    fn add_body(&mut self, body: &Body, d: Vector3<f64>, rate: Vector3<f64>, extra: Vector3<f64>) {
        let first_moment = body.mass * body.center;
        let transverse = body.transverse + first_moment * body.center;
        let difference = body.axial - transverse;
        let lever = first_moment * d;
        let across = rate.cross(&d);
        self.rotational += Matrix3::from_diagonal_element(transverse) + difference * d * d.transpose();
        self.coupling += lever.cross_matrix();
        self.linear += Matrix3::from_diagonal_element(body.mass);
        // ω × J ω with J = J_t + (J_a − J_t) d dᵀ.
        self.torque += difference * rate.dot(&d) * across + lever.cross(&extra);
        self.force += first_moment * rate.cross(&across) + body.mass * extra;
    }

    /// Adds an external force at `arm` from the reference point.
    fn push(&mut self, arm: Vector3<f64>, force: Vector3<f64>) {
        self.torque -= arm.cross(&force);
        self.force -= force;
    }

    /// Moves the reference point by −`arm` on the parent link, with `a_child = a + α × arm + bias`.
    fn shift(&mut self, arm: Vector3<f64>, bias: Vector3<f64>) {
        let cross = arm.cross_matrix();
        self.force += self.linear * bias;
        self.torque += self.coupling * bias + arm.cross(&self.force);
        let coupling = self.coupling + cross * self.linear;
        self.rotational += cross * coupling.transpose() - self.coupling * cross;
        self.coupling = coupling;
    }
}

impl JointPass {
    /// Eliminates the joint's acceleration: `subtree` becomes what the parent feels at the joint.
    fn eliminate(&mut self, subtree: &mut Articulated) {
        let gamma = self.implicit;
        self.inverse = inverse_symmetric(&(subtree.rotational + Matrix3::from_diagonal_element(gamma)));
        self.gain = self.inverse * subtree.coupling;
        self.offset = self.inverse * (self.torque - subtree.torque);
        subtree.force += subtree.coupling.tr_mul(&self.offset);
        subtree.linear -= subtree.coupling.tr_mul(&self.gain);
        subtree.torque = self.torque - gamma * self.offset;
        // γ − γ² D⁻¹ = γ J D⁻¹, without cancellation where γ is large.
        subtree.rotational = gamma * (subtree.rotational * self.inverse);
        subtree.coupling = gamma * self.gain;
    }
}

/// Inverse of a symmetric positive-definite 3 × 3 matrix by cofactors.
fn inverse_symmetric(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (m.m11, m.m12, m.m13);
    let (d, e, f) = (m.m22, m.m23, m.m33);
    let (p, q, r) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let scale = 1.0 / (a * p + b * q + c * r);
    let (s, t, u) = (a * f - c * c, b * c - a * e, a * d - b * b);
    scale * Matrix3::new(p, q, r, q, s, t, r, t, u)
}

/// Angular and linear (gravity-free) acceleration of the base that carries `arm`.
fn base_acceleration(
    base: &Base,
    state: &ChainState,
    load: &Load,
    arm: Articulated,
) -> (Vector3<f64>, Vector3<f64>) {
    let rotation = state.attitude.to_rotation_matrix();
    let rotation = rotation.matrix();
    let rate = state.motion.angular;
    let mut total = arm;
    let lever = base.clamp_offset_m * axis(&state.attitude);
    total.shift(lever, rate.cross(&rate.cross(&lever)));
    let inertia =
        rotation * Matrix3::from_diagonal(&Vector3::from(base.inertia_kg_m2)) * rotation.transpose();
    total.rotational += inertia;
    total.linear += Matrix3::from_diagonal_element(base.mass_kg);
    total.torque += rate.cross(&(inertia * rate)) - rotation * load.torque;
    let air = rotation.tr_mul(&(load.wind - state.motion.linear));
    let drag = rotation * air.component_mul(&Vector3::from(base.drag));
    total.force -= load.thrust * rotation.column(2) + drag;

    // [J H; Hᵀ M] [α; a] = −[n₀; f₀], by eliminating a.
    let inverse = inverse_symmetric(&total.linear);
    let gain = total.coupling * inverse;
    let angular = inverse_symmetric(&(total.rotational - gain * total.coupling.transpose()))
        * (gain * total.force - total.torque);
    let linear = -inverse * (total.force + total.coupling.tr_mul(&angular));
    (angular, linear)
}
