//! Axes of recordings, turned into flyvine's: east, north, up; the quadrotor's x forward, y left, z up.

use serde::Deserialize;

use crate::flight::quaternion::product;

/// A recording's axes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// z up in the world and in the quadrotor: flyvine's own.
    #[default]
    ZUp,
    /// y up in the world and in the quadrotor, as OptiTrack's Motive exports by default: x stays, −z
    /// becomes y.
    YUp,
    /// World north-east-down, quadrotor forward-right-down, as PX4 logs.
    Ned,
}

/// Which way a quaternion turns.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// It turns body coordinates into world coordinates.
    #[default]
    WorldFromBody,
    /// It turns world coordinates into body coordinates.
    BodyFromWorld,
}

impl Axes {
    /// A position or velocity in flyvine's world axes.
    pub fn vector(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Axes::ZUp => [x, y, z],
            Axes::YUp => [x, -z, y],
            Axes::Ned => [y, x, -z],
        }
    }

    /// An attitude between flyvine's world and body axes: `q_here = q_world q q_body⁻¹`, each factor the
    /// change of axes.
    pub fn attitude(self, q: [f64; 4]) -> [f64; 4] {
        const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
        match self {
            Axes::ZUp => q,
            // The same quarter turn about x on both sides turns the vector part like a vector.
            Axes::YUp => {
                let [w, x, y, z] = q;
                [w, x, -z, y]
            }
            // ENU from NED: half a turn about (1, 1, 0)/√2. FRD from FLU: half a turn about x.
            Axes::Ned => product(product([0.0, HALF, HALF, 0.0], q), [0.0, 1.0, 0.0, 0.0]),
        }
    }
}

impl Direction {
    /// The quaternion `world_from_body`.
    pub(super) fn world_from_body(self, [w, x, y, z]: [f64; 4]) -> [f64; 4] {
        match self {
            Direction::WorldFromBody => [w, x, y, z],
            Direction::BodyFromWorld => [w, -x, -y, -z],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::quaternion::dot;

    /// `v` turned by `q`.
    fn turn(q: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [w, a, b, c] = q;
        let [_, x, y, z] = product(product(q, [0.0, x, y, z]), [w, -a, -b, -c]);
        [x, y, z]
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() < 1e-12)
    }

    #[test]
    fn a_turned_body_points_the_same_way_in_either_axes() {
        let q = [0.5, 0.1, -0.7, 0.5];
        let q = q.map(|c| c / dot(q, q).sqrt());
        // For each convention: the body's forward, left and up axes in the recording's body coordinates.
        let bodies = [
            (Axes::ZUp, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            (Axes::YUp, [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
            (Axes::Ned, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
        ];
        for (axes, body) in bodies {
            for (here, there) in bodies[0].1.into_iter().zip(body) {
                let expected = axes.vector(turn(q, there));
                assert!(near(turn(axes.attitude(q), here), expected), "{axes:?} {here:?}");
            }
        }
    }

    #[test]
    fn a_level_vehicle_that_faces_north_in_px4_faces_north_here() {
        let q = Axes::Ned.attitude([1.0, 0.0, 0.0, 0.0]);
        assert!(near(turn(q, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]));
        assert!(near(turn(q, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]));
    }
}
