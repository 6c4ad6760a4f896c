//! What a vehicle is sent 20 times a second.

use serde::{Deserialize, Serialize};

use crate::DT;

/// Where the quadrotor shall be and, where the autopilot is told, how fast it shall pass there. World frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// Position, m.
    pub position: [f64; 3],
    /// Velocity that the velocity loop is fed forward, m/s; `None`: the vehicle is sent positions only.
    pub velocity: Option<[f64; 3]>,
}

impl From<[f64; 3]> for Setpoint {
    /// A position only.
    fn from(position: [f64; 3]) -> Self {
        Self {
            position,
            velocity: None,
        }
    }
}

impl Setpoint {
    /// Whether all of it is finite.
    pub fn is_finite(&self) -> bool {
        let mut numbers = self.position.iter().chain(self.velocity.iter().flatten());
        numbers.all(|number| number.is_finite())
    }
}

/// What a vehicle is sent beside positions.
///
/// The velocity is that of the positions themselves, `v_k = (u_k − u_{k−1}) / dt`, of whatever was really commanded: models
/// that were fitted to flights with velocities assume that relation, and no controller can break it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Feedforward {
    /// Nothing.
    #[default]
    None,
    /// The velocity of the commanded position.
    Velocity,
}

impl Feedforward {
    /// Whether nothing is sent beside positions.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    /// The set-point of `position` after that of `before`, [`DT`] earlier, m.
    pub fn setpoint(self, position: [f64; 3], before: [f64; 3]) -> Setpoint {
        Setpoint {
            position,
            velocity: match self {
                Self::None => None,
                Self::Velocity => Some(std::array::from_fn(|axis| (position[axis] - before[axis]) / DT)),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocities_are_those_of_the_positions_and_only_where_asked_for() {
        let (now, before) = ([0.3, -0.1, 1.5], [0.2, -0.1, 1.55]);
        let sent = Feedforward::Velocity.setpoint(now, before);
        assert_eq!(sent.position, now);
        let velocity = sent.velocity.unwrap();
        assert!(
            velocity
                .iter()
                .zip([2.0, 0.0, -1.0])
                .all(|(a, b)| (a - b).abs() < 1e-12)
        );
        assert_eq!(Feedforward::None.setpoint(now, before), now.into());
        assert!(sent.is_finite());
        for broken in [
            Feedforward::Velocity.setpoint(now, [f64::INFINITY, 0.0, 0.0]),
            [0.0, f64::NAN, 0.0].into(),
        ] {
            assert!(!broken.is_finite());
        }
    }
}
