//! Contact of the end effector with the floor and with a ball, as stiff, damped springs.
//!
//! The tip is a sphere. The ball (the beach ball of the paper's demonstration) rests where it was put until it
//! is touched; then it flies under gravity and air drag.

use super::parameters::{Checker, ParameterError};
use crate::GRAVITY;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What the end effector can touch. Nothing by default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactParameters {
    /// Radius of the end effector, m.
    pub tip_radius_m: f64,
    /// Stiffness of a contact, N/m.
    pub stiffness_n_m: f64,
    /// Damping of a contact, N s/m.
    pub damping_n_s_m: f64,
    /// Height of the floor, m, if the tip can touch it.
    pub floor_m: Option<f64>,
    /// A ball to kick.
    pub ball: Option<BallParameters>,
}

/// A light ball.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallParameters {
    /// Where its centre rests until it is touched, m.
    pub position_m: [f64; 3],
    /// Radius, m.
    pub radius_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
}

impl Default for ContactParameters {
    fn default() -> Self {
        ContactParameters {
            tip_radius_m: 0.05,
            stiffness_n_m: 300.0,
            damping_n_s_m: 1.0,
            floor_m: None,
            ball: None,
        }
    }
}

impl ContactParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("contact");
        check.range("tip_radius_m", self.tip_radius_m, 0.001, 1.0, "m")?;
        check.range("stiffness_n_m", self.stiffness_n_m, 1.0, 5000.0, "N/m")?;
        check.range("damping_n_s_m", self.damping_n_s_m, 0.0, 20.0, "N s/m")?;
        if let Some(floor) = self.floor_m {
            check.range("floor_m", floor, -10.0, 10.0, "m")?;
        }
        if let Some(ball) = &self.ball {
            for coordinate in ball.position_m {
                check.range("ball.position_m", coordinate, -100.0, 100.0, "m")?;
            }
            check.range("ball.radius_m", ball.radius_m, 0.01, 2.0, "m")?;
            check.range("ball.mass_kg", ball.mass_kg, 0.005, 10.0, "kg")?;
        }
        Ok(())
    }
}

/// The ball's motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Centre, m.
    pub position: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// True once it has been touched.
    pub touched: bool,
}

impl Ball {
    /// At rest where it was put.
    pub fn at_rest(parameters: &BallParameters) -> Ball {
        Ball {
            position: parameters.position_m.into(),
            velocity: Vector3::zeros(),
            touched: false,
        }
    }
}

/// Force on a sphere's centre that penetrates by `depth` along the outward `normal`, moving at `velocity`
/// relative to the other body, N. Contacts push only.
fn push(
    parameters: &ContactParameters,
    depth: f64,
    normal: Vector3<f64>,
    velocity: &Vector3<f64>,
) -> Vector3<f64> {
    if depth <= 0.0 {
        return Vector3::zeros();
    }
    let magnitude = parameters.stiffness_n_m * depth - parameters.damping_n_s_m * velocity.dot(&normal);
    magnitude.max(0.0) * normal
}

/// Force on the end effector (N) from floor and ball; advances the ball by `step` seconds.
pub(super) fn step(
    parameters: &ContactParameters,
    ball: Option<&mut Ball>,
    tip: &Vector3<f64>,
    tip_velocity: &Vector3<f64>,
    wind: &Vector3<f64>,
    step: f64,
) -> Vector3<f64> {
    let mut force = Vector3::zeros();
    if let Some(floor) = parameters.floor_m {
        let depth = floor + parameters.tip_radius_m - tip.z;
        force += push(parameters, depth, Vector3::z(), tip_velocity);
    }
    if let (Some(ball), Some(shape)) = (ball, &parameters.ball) {
        let apart = tip - ball.position;
        let distance = apart.norm();
        if distance > 1e-9 {
            let depth = shape.radius_m + parameters.tip_radius_m - distance;
            let contact = push(
                parameters,
                depth,
                apart / distance,
                &(tip_velocity - ball.velocity),
            );
            ball.touched |= depth > 0.0;
            force += contact;
            if ball.touched {
                // A sphere's drag: ½ ρ C_d A with C_d = 0.47.
                let area = std::f64::consts::PI * shape.radius_m * shape.radius_m;
                let air = wind - ball.velocity;
                let drag = 0.5 * 1.2 * 0.47 * area * air.norm() * air;
                let weight = Vector3::new(0.0, 0.0, -GRAVITY * shape.mass_kg);
                ball.velocity += step * (weight + drag - contact) / shape.mass_kg;
                ball.position += step * ball.velocity;
                let lowest = parameters.floor_m.unwrap_or(f64::NEG_INFINITY) + shape.radius_m;
                if ball.position.z < lowest {
                    ball.position.z = lowest;
                    ball.velocity.z = 0.5 * ball.velocity.z.abs();
                }
            }
        }
    }
    force
}
