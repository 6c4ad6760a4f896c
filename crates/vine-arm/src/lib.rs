//! The soft arm's wire protocol and controller, shared by firmware, base station and simulated vehicle.
//!
//! Everything here is a pure function of bytes, sensor readings and elapsed time: no input or output, no clock, no
//! allocation, no `unsafe`. A board supplies [`Sensors`], applies [`Actuators`] and moves bytes; the rest is here:
//!
//! | module | what |
//! | --- | --- |
//! | [`message`] | what host and arm say to each other |
//! | [`frame`] | how it travels: version, sequence, CRC-16, byte stuffing; resynchronises after corruption |
//! | [`controller`] | the state machine: set-points in, actuators out, watchdog, faults |
//! | [`growth`], [`pumps`] | motor duty with end stops; on-off pressure control with interlocks |
//! | [`device`] | controller and protocol together: the whole firmware but its drivers |
//! | [`plant`] | a simulated spool and tube, for boards and vehicles without real ones |
//!
//! Units: m, m/s, kPa gauge, s. Growth is positive outwards. Numbers are `f32`: the wire's and the processor's.

#![no_std]
#![forbid(unsafe_code)]

pub mod controller;
pub mod device;
pub mod frame;
pub mod growth;
pub mod limits;
pub mod message;
pub mod plant;
pub mod pumps;
pub mod state;
mod watch;

pub use controller::{Actuators, Controller, Sensors};
pub use device::Device;
pub use frame::{Decoder, Encoded, FrameError};
pub use limits::{Limits, LimitsError};
pub use message::{Frame, Message, Refusal, Request, Setpoint, Telemetry};
pub use pumps::Air;
pub use state::{Fault, State};
