//! The arm's geometry: a base that rides on the quadrotor, below its reference point, and links whose lengths may grow.

use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::{LINKS, State};
use super::vector::{Attitude, Vector};
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
    #[inline(always)]
    pub fn constant(length_m: f64) -> Self {
        ArmLength {
            length_m,
            rate_m_s: 0.0,
        }
    }
}

/// Link lengths and their rates from the base outwards.
#[inline(always)]
pub fn link_lengths<S: Scalar>(parameters: &Parameters<S>, arm: ArmLength) -> [(S, S); LINKS] {
    let length = -parameters.base_offset + arm.length_m;
    let outer = -parameters.joint_fraction + 1.0;
    [parameters.joint_fraction, outer].map(|share| (length * share, share * arm.rate_m_s))
}

/// Position and velocity of the arm's base, which rides on the quadrotor; `rotation` is the state's.
#[inline(always)]
pub fn base<S: Scalar>(
    parameters: &Parameters<S>,
    state: &State<S>,
    rotation: &Attitude<S>,
) -> (Vector<S>, Vector<S>) {
    let offset = base_offset(parameters);
    (
        state.position + rotation.rotate(&offset),
        state.velocity + rotation.rotate(&state.body_rate.cross(&offset)),
    )
}

/// The base in body coordinates.
#[inline(always)]
pub fn base_offset<S: Scalar>(parameters: &Parameters<S>) -> Vector<S> {
    Vector([S::from(0.0), S::from(0.0), -parameters.base_offset])
}

/// The direction of `span`; zero where there is none.
#[inline(always)]
pub fn unit<S: Scalar>(span: &Vector<S>) -> Vector<S> {
    *span * (span.norm_squared() + 1e-12).sqrt().recip()
}
