//! What goes in at the start, where the flight stands, and what comes out.

use std::fmt;

/// Where the flight stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum State {
    /// Under control of the controller.
    Flying,
    /// Under control of the controller, which lacks a fresh pose.
    Coasting,
    /// Ended: the position at the abort is held by set-points.
    Holding,
    /// Ended: the autopilot shall hold by itself.
    AutopilotHold,
    /// Ended: the autopilot shall land.
    Landing,
    /// Ended: nothing is sent any more.
    Stopped,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flying => "flying",
            Self::Coasting => "coasting",
            Self::Holding => "holding",
            Self::AutopilotHold => "autopilot hold",
            Self::Landing => "landing",
            Self::Stopped => "stopped",
        })
    }
}

/// The autopilot mode that goes with a set-point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Follow the set-points.
    Offboard,
    /// Hold position.
    Hold,
    /// Land.
    Land,
}

/// What may leave the machine at this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Order {
    /// The quadrotor position to send, m; `None`: send none. It goes on in Hold and Land, so that the
    /// autopilot is never left without a set-point while a mode change is under way.
    pub setpoint: Option<[f64; 3]>,
    /// The mode to ask for.
    pub mode: Mode,
}

/// Where the vehicle is known to be when supervision starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Time, s.
    pub t_s: f64,
    /// Quadrotor position, m; it must be in the room.
    pub quadrotor: [f64; 3],
    /// End-effector position, m; it must be in the room.
    pub end_effector: [f64; 3],
}
