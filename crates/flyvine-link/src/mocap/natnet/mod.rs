//! NatNet, OptiTrack's protocol: client for versions 3.0 to 4.1, server for 3.1.
//!
//! The packets are read and written by the crate `natnet`; [`Assembler`] makes frames with names of
//! them, [`NatNetClient`] and [`NatNetServer`] are the sockets.

mod assembler;
mod client;
mod server;

pub use assembler::{Assembler, Heard};
pub use client::{NatNetAddress, NatNetClient};
pub use server::NatNetServer;

/// The port of NatNet servers for commands.
pub const COMMAND_PORT: u16 = 1510;
/// The usual port for data; a server tells its own.
pub const DATA_PORT: u16 = 1511;
