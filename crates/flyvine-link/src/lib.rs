//! The wires between the base station and the vehicle: motion capture, autopilot and arm.
//!
//! Every protocol is a codec without input or output (bytes in, events out) and a thin transport over it. This crate has
//! the clock and the sockets that [`flyvine`] does without. Nothing listens beyond loopback unless asked to.

pub mod arm;
pub mod autopilot;
pub mod mocap;
pub mod onboard;
pub mod recording;
pub mod rehearsal;
#[cfg(feature = "ros2")]
pub mod ros2;
mod worker;
