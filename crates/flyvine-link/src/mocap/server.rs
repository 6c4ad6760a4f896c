//! A motion-capture server of either protocol, for simulated vehicles.

use std::net::SocketAddr;

use super::natnet::NatNetServer;
use super::vrpn::VrpnServer;
use super::{BodyPose, MocapError};

/// Serves poses to whoever speaks the protocol, as a motion-capture system does.
#[derive(Debug)]
pub enum MocapServer {
    /// VRPN, both transports.
    Vrpn(VrpnServer),
    /// NatNet 3.1, unicast.
    NatNet(NatNetServer),
}

impl MocapServer {
    /// A VRPN server at `address`; with port 0 the system chooses.
    ///
    /// # Errors
    /// The address cannot be listened at.
    pub fn vrpn(address: SocketAddr) -> Result<Self, MocapError> {
        VrpnServer::bind(address).map(MocapServer::Vrpn)
    }

    /// A NatNet server for the bodies called `names`, with its commands at `address` and its data at `data_port`.
    ///
    /// # Errors
    /// The address cannot be listened at; a name that the protocol cannot carry.
    pub fn natnet(address: SocketAddr, data_port: u16, names: &[String]) -> Result<Self, MocapError> {
        NatNetServer::bind(address, data_port, names).map(MocapServer::NatNet)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        match self {
            MocapServer::Vrpn(server) => server.address(),
            MocapServer::NatNet(server) => server.address(),
        }
    }

    /// How many clients it has.
    pub fn clients(&self) -> usize {
        match self {
            MocapServer::Vrpn(server) => server.clients(),
            MocapServer::NatNet(server) => server.clients(),
        }
    }

    /// Sends `bodies`, seen at `captured_s` (Unix time, s), to all clients. It never waits for a client.
    /// Poses are sent as they are, nonsense included: a rehearsal may want it.
    ///
    /// # Errors
    /// A capture time that no protocol can carry; a frame that cannot be encoded.
    pub fn publish(&self, captured_s: f64, bodies: &[BodyPose]) -> Result<(), MocapError> {
        // VRPN's seconds have 32 bits.
        if !(0.0..f64::from(u32::MAX)).contains(&captured_s) {
            return Err(MocapError::CaptureTime { found: captured_s });
        }
        match self {
            MocapServer::Vrpn(server) => {
                server.publish(captured_s, bodies);
                Ok(())
            }
            MocapServer::NatNet(server) => server.publish(captured_s, bodies),
        }
    }
}
