//! Where the chain's bodies are and how they move.

use super::rotation::rotate;
use nalgebra::{UnitQuaternion, Vector3};

/// Positions and velocities, all in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainState {
    /// Position of the base's centre of mass, m.
    pub position: Vector3<f64>,
    /// Attitude `world_from_body` of the base.
    pub attitude: UnitQuaternion<f64>,
    /// Attitudes `world_from_link`.
    pub links: Vec<UnitQuaternion<f64>>,
    /// Sliders of the joints' hysteresis, in the parent link's axes, rad.
    pub sliders: Vec<Vector3<f64>>,
    /// How far the tip hangs beyond its rest position on the last link's axis, m.
    pub extension: f64,
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
    /// Rate of the tip's extension, m/s or m/s².
    pub extension: f64,
}

impl Motion {
    /// At rest, for `links` links.
    pub fn zeros(links: usize) -> Motion {
        Motion {
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
            links: vec![Vector3::zeros(); links],
            extension: 0.0,
        }
    }

    /// Copies `other`, of the same number of links, without allocating.
    pub fn copy_from(&mut self, other: &Motion) {
        self.linear = other.linear;
        self.angular = other.angular;
        self.extension = other.extension;
        self.links.copy_from_slice(&other.links);
    }

    /// `self += factor · other`.
    pub fn add_scaled(&mut self, factor: f64, other: &Motion) {
        self.linear += factor * other.linear;
        self.angular += factor * other.angular;
        self.extension += factor * other.extension;
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
            sliders: vec![Vector3::zeros(); links],
            extension: 0.0,
            motion: Motion::zeros(links),
        }
    }

    /// Copies `other`, of the same number of links, without allocating.
    pub fn copy_from(&mut self, other: &ChainState) {
        self.position = other.position;
        self.attitude = other.attitude;
        self.extension = other.extension;
        self.links.copy_from_slice(&other.links);
        self.sliders.copy_from_slice(&other.sliders);
        self.motion.copy_from(&other.motion);
    }

    /// Moves the coordinates of `from` along `motion` for `duration`: `p + h v`, `exp(h ω) q`.
    pub fn advance(&mut self, from: &ChainState, duration: f64, motion: &Motion) {
        self.position = from.position + duration * motion.linear;
        self.extension = from.extension + duration * motion.extension;
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
            && self.extension.is_finite()
            && self.motion.extension.is_finite()
            && self.motion.links.iter().all(finite)
            && self.attitude.coords.iter().all(|x| x.is_finite())
            && self.links.iter().all(|q| q.coords.iter().all(|x| x.is_finite()))
    }
}
