//! The simulated vehicle: a quadrotor with a PX4-structured autopilot and a soft inflated arm.
//!
//! It stands in for hardware in tests, rehearsals and data generation. It shares no code with the identified
//! models, so that one can judge the other.
//!
//! | part | what it is |
//! | --- | --- |
//! | [`chain`], [`state`], [`articulated`] | rigid base and links on elastic ball joints, a tip that slides along the axis; O(n) forward dynamics with implicit joint forces, growth with the terms of moving material |
//! | [`hysteresis`] | elasto-slip element of a joint, off by default |
//! | [`integrator`] | second-order, L-stable, linearly implicit (the vehicle's); explicit fourth-order (undamped mode, and to check the other) |
//! | [`autopilot`] | PX4's cascade, and a geometric controller of different structure |
//! | [`pneumatics`], [`wind`], [`contact`] | pumps and leak, mean wind and gusts, floor and ball |
//! | [`mocap`] | late, noisy poses with faults counted by cause |
//! | [`vehicle`] | all of it in lockstep, as a [`crate::link::Vehicle`] |
//! | [`hover`] | the modes of vehicle and autopilot together about hover |
//! | [`replay`], [`paper`], [`calibrate`], [`free`] | recorded flights replayed, the paper's among them, and the parameters fitted to them |
//!
//! # Calibration
//!
//! [`VehicleParameters::default`] was found by [`calibrate::calibrate`] on the paper's 4 swings and 8
//! lemniscates ([`paper::recordings`]), all parameters of [`free::all`] at once, within bounds from the paper's
//! masses and sizes. Against hardware the replays differ by less than those of an independent MuJoCo vehicle
//! calibrated on the same swings (`tests/replay.rs`). What it does not reproduce: the oscillation of the short
//! inflated arm in slow flight, and initial offsets of a few centimetres. About hover that arm's swing is lightly damped
//! (0.81 Hz, ζ = 0.018, by [`hover::modes`]), and 50 g at its tip undamp it (0.77 Hz, ζ = −0.008): the swing may well have been
//! there before the recorded flight began, where a replay starts at rest.

mod arm;
pub mod articulated;
pub mod autopilot;
pub mod calibrate;
pub mod chain;
#[cfg(test)]
mod chain_tests;
pub mod contact;
pub mod free;
mod history;
pub mod hover;
pub mod hysteresis;
pub mod integrator;
pub mod mocap;
pub mod paper;
pub mod parameters;
pub mod pneumatics;
mod randomize;
pub mod replay;
mod rotation;
pub mod state;
pub mod vehicle;
pub mod wind;

pub use parameters::{ParameterError, VehicleParameters};
pub use randomize::randomized;
pub use vehicle::{SimulatedVehicle, Truth};
