//! flyvine turns motion-capture flights of a drone that carries a soft, underactuated arm into
//! flights whose *end effector* goes where it is told.
//!
//! # The problem
//!
//! A quadrotor with a PX4-like position controller carries an inflated arm (a "vine"). The only input
//! is the commanded quadrotor position `u ∈ R³`, sent every [`DT`] seconds. The state
//! `x ∈ R⁹` is the quadrotor position (3, m), the vector part of its attitude quaternion (3) and the
//! end-effector position (3, m). A model predicts
//!
//! ```text
//! x_{k+1} = f(z_k, u_k),   z_k = (x_k, x_{k-1}, x_{k-2})
//! ```
//!
//! and a plan minimizes `Σ‖z_k − z̄_k‖²_Q + Σ‖u_k − ū_k‖²_R` subject to it
//! (Jitosho et al., "Flying Vines", Sec. III).
//!
//! # Conventions
//!
//! World frame ENU (x, y horizontal, z up), metres, seconds, radians, kilograms; pressure in kPa gauge.
//! Quaternions are Hamilton, `world_from_body`, scalar first, `w ≥ 0`.

pub mod benchmark;
pub mod control;
pub mod file;
pub mod flight;
mod kernel;
pub mod link;
pub mod model;
pub mod report;
pub mod run;
mod shard;
pub mod sim;
pub mod task;
pub mod trajopt;

pub use shard::Shard;

/// Sample time of commands, flights and plans, s.
pub const DT: f64 = 0.05;
/// Standard gravity used throughout, m/s².
pub const GRAVITY: f64 = 9.81;
/// Height at which the quadrotor hovers when a flight starts, m.
pub const HOVER_HEIGHT_M: f64 = 1.5;
