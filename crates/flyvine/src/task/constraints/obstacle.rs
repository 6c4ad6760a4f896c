//! Obstacles, and how far the quadrotor and the whole arm are from one.
//!
//! Models know the ends of the arm, not its shape: between them it counts as straight, and the margin must leave room
//! for how far it bends. Its distance is a smooth minimum over points on it, never more than the least of theirs and
//! at most `ln(points) / SHARPNESS` (2.8 cm) less:
//!
//! ```text
//! y = −1/β ln Σ_i exp(−β d_i)
//! ```

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{END_EFFECTOR, NOW, QUADROTOR};
use crate::trajopt::Output;

/// Points on the arm.
const POINTS: usize = 16;
/// β of the smooth minimum, 1/m.
const SHARPNESS: f64 = 100.0;

/// Something that neither the quadrotor nor the arm may touch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Name, for messages.
    pub name: String,
    /// Its shape and place.
    pub shape: Shape,
    /// Distance that the arm's axis keeps from it: the arm's radius, and room for how far it bends, m.
    #[serde(default = "Obstacle::default_margin_m")]
    pub margin_m: f64,
    /// Distance that the quadrotor's centre keeps from it, m.
    #[serde(default = "Obstacle::default_quadrotor_margin_m")]
    pub quadrotor_margin_m: f64,
}

impl Obstacle {
    fn default_margin_m() -> f64 {
        0.1
    }

    fn default_quadrotor_margin_m() -> f64 {
        0.35
    }
}

/// A convex shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Centre, m.
        centre_m: [f64; 3],
        /// Radius, m.
        radius_m: f64,
    },
    /// A box with edges along the world's axes.
    Box {
        /// Lower corner, m.
        lower_m: [f64; 3],
        /// Upper corner, m.
        upper_m: [f64; 3],
    },
}

/// Distance of a point from a shape, negative inside, with slope and curvature.
struct Distance {
    value: f64,
    slope: Vector3<f64>,
    curvature: Matrix3<f64>,
}

impl Distance {
    /// That from the origin to `offset`, of which only the `free` axes count: `|v|`, `v/|v|`, `(I − n nᵀ)/|v|`.
    fn from_origin(offset: Vector3<f64>, free: Vector3<f64>) -> Self {
        let value = offset.norm().max(f64::MIN_POSITIVE);
        let slope = offset / value;
        Self {
            value,
            slope,
            curvature: (Matrix3::from_diagonal(&free) - slope * slope.transpose()) / value,
        }
    }
}

impl Shape {
    fn distance(&self, point: Vector3<f64>) -> Distance {
        match self {
            Self::Sphere { centre_m, radius_m } => {
                let from_centre =
                    Distance::from_origin(point - Vector3::from(*centre_m), Vector3::repeat(1.0));
                Distance {
                    value: from_centre.value - radius_m,
                    ..from_centre
                }
            }
            Self::Box { lower_m, upper_m } => {
                let (lower, upper) = (Vector3::from(*lower_m), Vector3::from(*upper_m));
                let from_centre = point - 0.5 * (lower + upper);
                let beyond = from_centre.abs() - 0.5 * (upper - lower);
                let side = from_centre.map(f64::signum);
                if beyond.max() > 0.0 {
                    let free = beyond.map(|entry| f64::from(u8::from(entry > 0.0)));
                    let outside = beyond.sup(&Vector3::zeros()).component_mul(&side);
                    return Distance::from_origin(outside, free);
                }
                let axis = beyond.imax();
                let mut slope = Vector3::zeros();
                slope[axis] = side[axis];
                Distance {
                    value: beyond[axis],
                    slope,
                    curvature: Matrix3::zeros(),
                }
            }
        }
    }
}

/// Smooth least distance of quadrotor and arm from an obstacle, margins taken off, m.
#[derive(Debug)]
pub(super) struct Clearance {
    shape: Shape,
    /// (share of the way from quadrotor to end effector, margin) of each point.
    points: Vec<(f64, f64)>,
}

impl Clearance {
    pub fn new(obstacle: &Obstacle) -> Self {
        let on_arm = (1..=POINTS).map(|point| (point as f64 / POINTS as f64, obstacle.margin_m));
        Self {
            shape: obstacle.shape.clone(),
            points: std::iter::once((0.0, obstacle.quadrotor_margin_m))
                .chain(on_arm)
                .collect(),
        }
    }

    /// Of every point its share of the way, its distance, and its weight exp(−β d_i) / Σ in the minimum; and y.
    fn distances(&self, w: &[f64]) -> (Vec<(f64, Distance, f64)>, f64) {
        let at = |part: usize| Vector3::from_column_slice(&w[NOW + part..][..3]);
        let (quadrotor, end_effector) = (at(QUADROTOR), at(END_EFFECTOR));
        let mut points: Vec<(f64, Distance, f64)> = self
            .points
            .iter()
            .map(|&(share, margin)| {
                let mut distance = self.shape.distance(quadrotor.lerp(&end_effector, share));
                distance.value -= margin;
                (share, distance, 0.0)
            })
            .collect();
        let least = points
            .iter()
            .map(|(_, distance, _)| distance.value)
            .fold(f64::INFINITY, f64::min);
        let mut sum = 0.0;
        for (_, distance, weight) in &mut points {
            *weight = (-SHARPNESS * (distance.value - least)).exp();
            sum += *weight;
        }
        for (_, _, weight) in &mut points {
            *weight /= sum;
        }
        (points, least - sum.ln() / SHARPNESS)
    }
}

impl Output for Clearance {
    fn value(&self, w: &[f64]) -> f64 {
        self.distances(w).1
    }

    /// With p_i = (1 − s_i) q + s_i e and weights π_i: `∇y = Σ π_i ∇d_i`,
    /// `∇²y = Σ π_i ∇²d_i − β (Σ π_i ∇d_i ∇d_iᵀ − ∇y ∇yᵀ)`.
    fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        gradient.fill(0.0);
        hessian.fill(0.0);
        let (points, y) = self.distances(w);
        let ends = |share: f64| [(NOW + QUADROTOR, 1.0 - share), (NOW + END_EFFECTOR, share)];
        for (share, distance, weight) in &points {
            let second =
                *weight * (distance.curvature - SHARPNESS * distance.slope * distance.slope.transpose());
            for (first, by_first) in ends(*share) {
                for i in 0..3 {
                    gradient[first + i] += weight * by_first * distance.slope[i];
                    for (other, by_other) in ends(*share) {
                        for j in 0..3 {
                            hessian[(first + i) * w.len() + other + j] +=
                                by_first * by_other * second[(i, j)];
                        }
                    }
                }
            }
        }
        for i in 0..w.len() {
            for j in 0..w.len() {
                hessian[i * w.len() + j] += SHARPNESS * gradient[i] * gradient[j];
            }
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_output_derivatives;
    use super::*;

    fn obstacle(shape: Shape) -> Obstacle {
        Obstacle {
            name: "obstacle".into(),
            shape,
            margin_m: 0.05,
            quadrotor_margin_m: 0.2,
        }
    }

    fn sphere() -> Shape {
        Shape::Sphere {
            centre_m: [0.5, 0.1, 1.0],
            radius_m: 0.2,
        }
    }

    fn block() -> Shape {
        Shape::Box {
            lower_m: [0.4, -0.3, 0.6],
            upper_m: [0.8, 0.3, 1.1],
        }
    }

    /// w with quadrotor and end effector here.
    fn motion(quadrotor: [f64; 3], end_effector: [f64; 3]) -> Vec<f64> {
        let mut w = vec![0.0; 21];
        w[..3].copy_from_slice(&quadrotor);
        w[6..9].copy_from_slice(&end_effector);
        w
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        for shape in [sphere(), block()] {
            let clearance = Clearance::new(&obstacle(shape));
            // Beside, across and through the obstacle.
            for (quadrotor, end_effector) in [
                ([0.0, 0.02, 1.5], [0.13, 0.05, 0.82]),
                ([0.2, -0.31, 1.53], [0.33, 0.07, 0.87]),
                ([0.52, 0.03, 1.45], [0.63, 0.08, 0.71]),
            ] {
                assert_output_derivatives(&clearance, &motion(quadrotor, end_effector));
            }
        }
    }

    #[test]
    fn the_distance_is_that_of_the_nearest_point_less_its_margin() {
        // A hanging arm beside the box, 0.3 m from its face; beside a ball, whose centre is level with the middle.
        let hanging = motion([0.1, 0.0, 1.5], [0.1, 0.0, 0.7]);
        let most = (17.0_f64).ln() / SHARPNESS;
        for (shape, expected) in [(block(), 0.3), (sphere(), (0.16_f64 + 0.01).sqrt() - 0.2)] {
            let found = Clearance::new(&obstacle(shape)).value(&hanging);
            let expected = expected - 0.05;
            assert!(
                (expected - most..=expected + 2e-3).contains(&found),
                "{found} of {expected}"
            );
        }
    }

    #[test]
    fn inside_the_distance_is_negative_and_points_out() {
        let distance = block().distance(Vector3::new(0.75, 0.0, 0.9));
        assert!((distance.value + 0.05).abs() < 1e-12);
        assert_eq!(distance.slope, Vector3::x());
    }
}
