//! A flight without a vehicle: the simulated one at the other end of the very same wires, with a PX4's manners, and
//! faults by script.

mod arm_end;
mod campaign;
mod fault;
mod lockstep;
mod px4;
mod px4_telemetry;
mod rig;
mod serve;
mod virtual_station;

pub use campaign::{RehearsedFlight, Verdict, one_fault, rehearse, wired_limits};
pub use fault::{FaultClock, FaultKind, Phase, Script, ScriptError, ScriptedFault};
pub use lockstep::PhasedVehicle;
pub use px4::{IDENTITY, ReceivedSetpoint, SimulatedPx4};
pub use px4_telemetry::Sensed;
pub use rig::{PERIOD_S, Rig, rig_bodies};
pub use serve::{Ends, RigEvent, ServeError, serve};
pub use virtual_station::{LateController, STALL_S, SharedRig, virtual_station};
