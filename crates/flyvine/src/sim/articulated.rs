//! Forward dynamics of the [`Chain`]: the articulated-body algorithm with implicit joint forces.
//!
//! Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 7, written in world-aligned coordinates at the
//! joints, where eliminating a ball joint needs one 3 × 3 inverse and nothing is rotated. O(links), no allocation.

use super::chain::{Base, Chain, Load};
use super::rotation::{axis, bend};
use super::state::{ChainState, Motion};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

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

/// What the tip keeps for the last pass: `ë = free − gain · d·a`, a the acceleration where the tip is.
#[derive(Debug, Clone, Copy)]
struct SliderPass {
    free: f64,
    gain: f64,
}

/// Scratch memory of the articulated-body algorithm, for a fixed number of links.
#[derive(Debug, Clone)]
pub struct Workspace {
    joints: Vec<JointPass>,
    slider: SliderPass,
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
            slider: SliderPass { free: 0.0, gain: 0.0 },
        }
    }

    /// Accelerations of `chain` at `state` under `load`.
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
        let root = self.inward(chain, state, load, implicit_step, predicted);
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
        let (mut parent, mut last) = (angular, joint_acceleration);
        for ((pass, link), alpha) in self.joints.iter().zip(&chain.links).zip(&mut result.links) {
            *alpha = pass.offset + pass.implicit * (pass.inverse * parent) - pass.gain * joint_acceleration;
            last = joint_acceleration;
            joint_acceleration += alpha.cross(&(link.length_m * pass.axis)) + pass.bias;
            parent = *alpha;
        }
        result.extension = match (&chain.tip.slider, chain.links.last(), self.joints.last()) {
            (Some(_), Some(link), Some(pass)) => {
                let reach = link.length_m + chain.tip.offset_m + state.extension;
                let turning = state.motion.links[chain.links.len() - 1]
                    .cross(&pass.axis)
                    .norm_squared();
                // Along the axis only the joint's own and the centripetal acceleration count.
                self.slider.free - self.slider.gain * (pass.axis.dot(&last) - reach * turning)
            }
            _ => 0.0,
        };
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

            pass.implicit = implicit_step * (joint.damping + implicit_step * joint.greatest_stiffness());
            let bend = bend(&parent_attitude, &state.links[i]);
            pass.torque = joint.spring(&bend, &parent_attitude, &state.sliders[i])
                - joint.damping * (rate - parent_rate)
                + pass.implicit * (predicted.links[i] - parent_predicted);
            parent_attitude = state.links[i];
            parent_rate = rate;
            parent_predicted = predicted.links[i];
        }
    }

    /// Articulated inertias from the tip inwards; returns what the base feels at the first joint.
    fn inward(
        &mut self,
        chain: &Chain,
        state: &ChainState,
        load: &Load,
        implicit_step: f64,
        predicted: &Motion,
    ) -> Articulated {
        let mut subtree = Articulated::zeros();
        for i in (0..self.joints.len()).rev() {
            let link = &chain.links[i];
            let pass = self.joints[i];
            let rate = state.motion.links[i];
            if i + 1 < self.joints.len() {
                subtree.shift(link.length_m * pass.axis, pass.bias);
            } else {
                subtree = self.tip(chain, state, load, implicit_step, predicted);
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
            subtree.push(Vector3::zeros(), chain.kink_flux(i, &self.joints));
            self.joints[i].eliminate(&mut subtree);
        }
        subtree
    }
}

impl Workspace {
    /// The tip body as the last link feels it at its joint, its slider eliminated.
    fn tip(
        &mut self,
        chain: &Chain,
        state: &ChainState,
        load: &Load,
        implicit_step: f64,
        predicted: &Motion,
    ) -> Articulated {
        let (tip, last) = (&chain.tip, self.joints.len() - 1);
        let (pass, rate, tube) = (
            self.joints[last],
            state.motion.links[last],
            chain.links[last].length_m,
        );
        let (d, growth) = (pass.axis, chain.growth);
        let reach = tube + tip.offset_m + state.extension;
        let across = rate.cross(&d);
        let sliding = state.motion.extension + growth.link_rate;
        let air = load.wind - (pass.velocity + reach * across + sliding * d);
        // Beyond the rigid link's acceleration the tip has that of its sliding along a turning axis.
        let extra = 2.0 * sliding * across + growth.link_acceleration * d;
        let mut body = Articulated::zeros();
        body.add_body(
            &Body {
                mass: tip.mass_kg,
                center: 0.0,
                transverse: tip.inertia_transverse_kg_m2,
                axial: tip.inertia_axial_kg_m2,
            },
            d,
            rate,
            extra,
        );
        body.push(Vector3::zeros(), tip.drag * air.norm() * air + load.tip_force);
        if let Some(slider) = &tip.slider {
            let gamma = implicit_step * (slider.damping + implicit_step * slider.stiffness(state.extension));
            let force = slider.force(state.extension, state.motion.extension) + gamma * predicted.extension;
            let inverse = 1.0 / (tip.mass_kg + gamma);
            let free = inverse * (force - d.dot(&body.force));
            body.linear -= (tip.mass_kg * tip.mass_kg * inverse) * d * d.transpose();
            body.force += (tip.mass_kg * free) * d;
            self.slider = SliderPass {
                free,
                gain: tip.mass_kg * inverse,
            };
        }
        body.shift(reach * d, reach * rate.cross(&across));
        body.push(tube * d, chain.spool_flux(d, rate));
        body
    }
}

impl Chain {
    /// Force at joint i from wall material that turns as it passes the kink: `λ w² (d_{i−1} − d_i)`, w the
    /// sliding speed, N.
    fn kink_flux(&self, i: usize, joints: &[JointPass]) -> Vector3<f64> {
        if i == 0 {
            return Vector3::zeros();
        }
        let speed = i as f64 * self.growth.link_rate;
        self.growth.linear_density * speed * speed * (joints[i - 1].axis - joints[i].axis)
    }

    /// Reaction on the tip of the material that leaves the spool at the tip's centre and comes to rest in the
    /// wall: `λ w (v_tip − v_wall)`, N.
    fn spool_flux(&self, d: Vector3<f64>, rate: Vector3<f64>) -> Vector3<f64> {
        let speed = self.links.len() as f64 * self.growth.link_rate;
        self.growth.linear_density * speed * (speed * d + self.tip.offset_m * rate.cross(&d))
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
        self.force += self.linear * bias;
        self.torque += self.coupling * bias + arm.cross(&self.force);
        // H ← H + r̃ M and J ← J + r̃ Hᵀ_new − H r̃, where −H r̃ = (r̃ Hᵀ)ᵀ.
        let coupling = self.coupling + cross_columns(&arm, &self.linear);
        self.rotational += cross_columns(&arm, &coupling.transpose())
            + cross_columns(&arm, &self.coupling.transpose()).transpose();
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

/// `r̃ M`: the cross product of r with every column.
fn cross_columns(r: &Vector3<f64>, m: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        r.cross(&m.column(0)),
        r.cross(&m.column(1)),
        r.cross(&m.column(2)),
    ])
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
