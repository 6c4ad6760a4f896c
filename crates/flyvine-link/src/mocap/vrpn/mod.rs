//! VRPN 07: the tracker part of the Virtual-Reality Peripheral Network, client and server.
//!
//! [`message`] frames bytes, [`Endpoint`] is one side of a connection without its sockets, [`VrpnClient`] and
//! [`VrpnServer`] are the sockets. A client reaches a server in one of two ways, and a server offers both:
//!
//! - `host` or `host:port`: the client asks by one UDP datagram to be called back by TCP, and reports come by UDP;
//! - `tcp://host:port`: the client calls, and everything goes over that connection.
//!
//! Sources: the protocol's reference implementation (github.com/vrpn/vrpn) and captures of its programs. All
//! numbers are big-endian; every message is padded to eight bytes.

mod client;
mod endpoint;
mod lob;
pub mod message;
mod server;

pub use client::{VrpnAddress, VrpnClient};
pub use endpoint::{Endpoint, Event, Report};
pub use lob::{format_lob, parse_lob};
pub use message::VrpnError;
pub use server::VrpnServer;

/// The port of VRPN servers, UDP and TCP.
pub const PORT: u16 = 3883;
