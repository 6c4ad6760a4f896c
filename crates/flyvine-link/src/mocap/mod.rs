//! Motion capture over the network: clients and servers for VRPN and NatNet, and [`MocapSource`], which makes
//! either of them the two poses that a flight needs.
//!
//! ```text
//! VRPN or NatNet server ── client thread ── clock offset ── hygiene ── body frames ── latest(now)
//! ```
//!
//! Clients deliver [`Frame`]s as they come: names, axes and time stamps are the server's. Everything after that,
//! the same for both protocols, happens in the source.

mod address;
mod bodies;
pub(crate) mod clock;
mod error;
mod frame;
mod hygiene;
pub mod natnet;
mod server;
mod source;
mod tracker;
pub mod vrpn;
mod watch;

pub use bodies::{Bodies, BodyFrame};
pub use clock::{ClockEstimate, ClockFilter};
pub use error::MocapError;
pub use frame::{BodyPose, Frame, Incoming, LinkState, Sink};
pub use hygiene::{HygieneCounts, HygieneLimits, LiveFault};
pub use server::MocapServer;
pub use source::{Address, MocapSource};
pub(crate) use tracker::Tracker;
pub use tracker::{BodyStatus, Latest, MocapStatus, Nonsense, StampedPose};
