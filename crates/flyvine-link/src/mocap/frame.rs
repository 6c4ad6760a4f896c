//! What a motion-capture client hears, whatever the protocol.

use std::sync::Arc;
use std::time::Instant;

/// One rigid body as the server reports it: in the server's axes and marker frame.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyPose {
    /// Its name on the server.
    pub name: String,
    /// Position, m.
    pub position: [f64; 3],
    /// Hamilton quaternion `world_from_body`, `[w, x, y, z]`.
    pub attitude: [f64; 4],
    /// Whether the server says that it sees the body. VRPN cannot say no; NatNet can.
    pub tracked: bool,
}

/// Bodies that were seen at one instant. NatNet sends all bodies together; VRPN sends each alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// When the cameras saw them, server clock, s.
    pub captured_s: f64,
    /// When the server sent them, server clock, s; the capture time where the protocol does not say.
    pub sent_s: f64,
    /// The bodies.
    pub bodies: Vec<BodyPose>,
}

/// What a client tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Incoming {
    /// A frame, and when it arrived here.
    Frame(Frame, Instant),
    /// The connection changed.
    Link(LinkState),
}

/// How a client stands with its server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkState {
    /// Not connected yet, or again.
    Connecting,
    /// Connected to a server of this name and version.
    Connected(String),
    /// The connection was lost, for this reason; the client goes on trying.
    Lost(String),
}

/// Takes what a client hears. It is called on the client's threads and must not block.
pub type Sink = Arc<dyn Fn(Incoming) + Send + Sync>;
