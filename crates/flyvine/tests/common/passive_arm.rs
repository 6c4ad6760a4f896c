//! The clamped arms of `data/passive`, as that folder's README describes them.

use flyvine::sim::chain::{Chain, Growth, Joint, Link, Tip};
use flyvine::sim::state::ChainState;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;

/// An arm of equal links on elastic ball joints, its base fixed.
#[derive(Deserialize)]
#[allow(non_snake_case)] // the file's own names
pub struct PassiveArm {
    link_length_m: f64,
    link_mass_kg: f64,
    link_com_from_upper_joint_m: f64,
    link_inertia_transverse: f64,
    link_inertia_axial: f64,
    tip_mass_kg: f64,
    tip_inertia_transverse: f64,
    tip_inertia_axial: f64,
    h_tip_m: f64,
    joint0_stiffness_Nm_per_rad: f64,
    joint_stiffness_Nm_per_rad: f64,
    joint0_damping_Nms_per_rad: f64,
    joint_damping_Nms_per_rad: f64,
}

impl PassiveArm {
    /// The arm with so many links.
    pub fn chain(&self, links: usize, gravity: f64) -> Chain {
        let link = Link {
            length_m: self.link_length_m,
            mass_kg: self.link_mass_kg,
            center_m: self.link_com_from_upper_joint_m,
            inertia_transverse_kg_m2: self.link_inertia_transverse,
            inertia_axial_kg_m2: self.link_inertia_axial,
            drag_normal: 0.0,
            drag_tangential: 0.0,
        };
        let joint = |stiffness, damping| Joint {
            stiffness,
            damping,
            collapse_moment: f64::INFINITY,
            hysteresis: None,
        };
        let mut joints = vec![joint(self.joint_stiffness_Nm_per_rad, self.joint_damping_Nms_per_rad); links];
        joints[0] = joint(self.joint0_stiffness_Nm_per_rad, self.joint0_damping_Nms_per_rad);
        Chain {
            base: None,
            links: vec![link; links],
            joints,
            tip: Tip {
                mass_kg: self.tip_mass_kg,
                offset_m: self.h_tip_m,
                inertia_transverse_kg_m2: self.tip_inertia_transverse,
                inertia_axial_kg_m2: self.tip_inertia_axial,
                drag: 0.0,
                slider: None,
            },
            growth: Growth::default(),
            gravity,
        }
    }
}

/// At rest with the joints at `quaternions`, child in parent, scalar first, one after another.
pub fn bent(quaternions: &[f64]) -> ChainState {
    let mut state = ChainState::hanging(Vector3::zeros(), quaternions.len() / 4);
    let mut attitude = UnitQuaternion::identity();
    for (link, q) in state.links.iter_mut().zip(quaternions.chunks(4)) {
        attitude *= UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]));
        *link = attitude;
    }
    state
}
