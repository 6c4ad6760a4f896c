//! The simulated vehicle: a quadrotor with a PX4-structured autopilot and a soft inflated arm.
//!
//! The simulator shares no code with the identified models, so that one can judge the other.

pub mod articulated;
pub mod autopilot;
pub mod calibrate;
pub mod chain;
#[cfg(test)]
mod chain_tests;
pub mod free;
pub mod integrator;
pub mod mocap;
pub mod parameters;
pub mod pneumatics;
pub mod replay;
pub mod vehicle;
pub mod wind;

pub use parameters::{ParameterError, VehicleParameters};
pub use vehicle::{SimulatedVehicle, Truth};
