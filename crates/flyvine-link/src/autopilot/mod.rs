//! The link to the autopilot over MAVLink 2: PX4 in OFFBOARD, ArduPilot in GUIDED.
//!
//! ```text
//!  motion capture ──poses──▶ ┌──────────────────┐ ◀─telemetry── arm
//!                            │ AutopilotVehicle │ ──growth────▶ arm
//!  fly() ──command, mode───▶ │   20 Hz ticks    │
//!        ◀──poses, health─── └────────┬─────────┘
//!                                AutopilotLink     bytes in, bytes out; no clock, no socket
//!                                     │
//!                              UDP or serial line
//! ```
//!
//! The supervisor in [`flyvine::control`] owns every command: what it does not hand over is not sent, and there is no
//! thread that could go on sending. World frame ENU up to [`messages`], NED beyond it.

mod arm_link;
mod checklist;
mod clock;
mod codec;
mod deadline;
mod dry_run;
mod frames;
mod link;
mod messages;
pub mod parameters;
mod pose_source;
pub mod preflight;
mod profile;
mod telemetry;
mod tick_times;
mod vehicle;
mod wire;

pub use arm_link::{ArmLink, ArmTelemetry, GROWTH_MAX_M_S, NoArm, WiredArm, growth_rate};
pub use checklist::{Checklist, Item, Weight};
pub use clock::{Clock, MonotonicClock};
pub use codec::{Codec, Identity, SigningKey, SigningKeyError};
pub use deadline::with_deadline;
pub use dry_run::{DryRun, DryRunError, dry_run};
pub use frames::{ned_frd_from_enu_flu, ned_from_enu, ned_pose, ned_yaw_from_enu};
pub use link::{AutopilotLink, LinkOptions};
pub use messages::GlobalOrigin;
pub use pose_source::{LatestPoses, MocapPoses, PoseSource, Stamped};
pub use profile::{Profile, px4_mode};
pub use telemetry::Telemetry;
pub use tick_times::{LATE_S, TickReport, TickTimes};
pub use vehicle::{AutopilotVehicle, Flags, Heard, Listener, Station};
pub use wire::{SerialWire, UdpWire, Wire, WireError, open};
