//! What goes in at the start, where the flight stands, and what comes out.

use std::fmt;

use crate::link::{Mode, Setpoint};

/// Where the flight stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// On the ground, not armed; the start position streams.
    Standing,
    /// On the way from the ground to the start.
    Climbing,
    /// Under control of the controller.
    Flying,
    /// Under control of the controller, which lacks a fresh pose.
    Coasting,
    /// Ended: the position at the abort is held by set-points.
    Holding,
    /// Ended: the autopilot shall hold by itself.
    AutopilotHold,
    /// The autopilot shall land: the flight is over, in good order or not.
    Landing,
    /// Ended: nothing is sent any more.
    Stopped,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Standing => "standing",
            Self::Climbing => "climbing",
            Self::Flying => "flying",
            Self::Coasting => "coasting",
            Self::Holding => "holding",
            Self::AutopilotHold => "autopilot hold",
            Self::Landing => "landing",
            Self::Stopped => "stopped",
        })
    }
}

/// What may leave the machine at this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Order {
    /// What to send; `None`: nothing. It goes on in Hold and Land, so that the autopilot is never left without a
    /// set-point while a mode change is under way.
    pub setpoint: Option<Setpoint>,
    /// The mode to ask for.
    pub mode: Mode,
}

/// Where the vehicle is known to be when supervision starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Time, s.
    pub t_s: f64,
    /// Quadrotor position, m; it must be in the room, or below it if the vehicle stands on the ground.
    pub quadrotor: [f64; 3],
    /// End-effector position, m; likewise.
    pub end_effector: [f64; 3],
}
