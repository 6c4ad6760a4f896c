//! The simulated vehicle: a quadrotor with a PX4-structured autopilot and a soft inflated arm.
//!
//! The simulator shares no code with the identified models, so that one can judge the other.

pub mod autopilot;
pub mod chain;
pub mod integrator;
pub mod mocap;
pub mod parameters;
pub mod pneumatics;
pub mod vehicle;
pub mod wind;

pub use parameters::{ParameterError, VehicleParameters};
pub use vehicle::{SimulatedVehicle, Truth};
