//! What the supervisor says: why it ended a flight, and what else happened.

use std::fmt;

use crate::link::Fault;

/// One of the two tracked bodies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {
    /// The quadrotor.
    Quadrotor,
    /// The end effector.
    EndEffector,
}

impl fmt::Display for Body {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Body::Quadrotor => "quadrotor",
            Body::EndEffector => "end effector",
        })
    }
}

/// Why the supervisor ended a flight.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Reason {
    /// A pose with a NaN, an infinity, or an attitude that is not of unit length.
    #[error("impossible {0} pose: not finite, or its quaternion not of unit length")]
    ImpossiblePose(Body),
    /// No pose for too long.
    #[error("{body} pose lost: {age_s:.3} s old; limit {limit_s} s")]
    StalePose {
        /// Whose.
        body: Body,
        /// Age of the newest credible pose, s.
        age_s: f64,
        /// Limit, s.
        limit_s: f64,
    },
    /// The same pose again and again for too long, while something else moved.
    #[error("{body} pose frozen: unchanged for {age_s:.3} s while the vehicle moves; limit {limit_s} s")]
    FrozenPose {
        /// Whose.
        body: Body,
        /// Age of the newest credible pose, s.
        age_s: f64,
        /// Limit, s.
        limit_s: f64,
    },
    /// A pose that jumped and stayed away.
    #[error("{body} pose jumped by {distance_m:.3} m; limit {limit_m:.3} m")]
    JumpingPose {
        /// Whose.
        body: Body,
        /// Distance from the last credible pose, m.
        distance_m: f64,
        /// How far the body can fly in the time, m.
        limit_m: f64,
    },
    /// A body left the room.
    #[error("{body} left the room at ({:.3}, {:.3}, {:.3}) m", .position[0], .position[1], .position[2])]
    LeftRoom {
        /// Which.
        body: Body,
        /// Where it was seen, m.
        position: [f64; 3],
    },
    /// The end effector is farther away than the arm is long.
    #[error("end effector {distance_m:.3} m from the quadrotor; limit {limit_m:.3} m")]
    Overstretched {
        /// Distance from quadrotor to end effector, m.
        distance_m: f64,
        /// The arm's length and the margin, m.
        limit_m: f64,
    },
    /// A proposed command with a NaN or an infinity.
    #[error("proposed command is not finite")]
    CommandNotFinite,
    /// The controller missed two ticks running.
    #[error("controller late twice running")]
    ControllerLate,
    /// The controller gave up.
    #[error("controller failed")]
    ControllerFailed,
    /// Nothing heard from the autopilot for too long.
    #[error("autopilot silent for {silence_s:.3} s; limit {limit_s} s")]
    AutopilotSilent {
        /// Since it was last heard, s.
        silence_s: f64,
        /// Limit, s.
        limit_s: f64,
    },
    /// Nothing heard from the arm for too long.
    #[error("arm silent for {silence_s:.3} s; limit {limit_s} s")]
    ArmSilent {
        /// Since it was last heard, s.
        silence_s: f64,
        /// Limit, s.
        limit_s: f64,
    },
    /// A time that is not finite or runs backwards, or a pose from the future.
    #[error("the clock is broken: {found} s after {last} s")]
    Clock {
        /// The time found, s.
        found: f64,
        /// The last good time, s.
        last: f64,
    },
    /// An arm length that is not a positive number.
    #[error("impossible arm length {length_m} m")]
    ArmLength {
        /// The length found, m.
        length_m: f64,
    },
    /// Ticks came too late, two or more periods in a row.
    #[error("{missed} ticks missed in a row")]
    TicksMissed {
        /// How many.
        missed: u32,
    },
    /// Not at the start in time.
    #[error("not at the start {limit_s} s after arming")]
    NotAirborne {
        /// Limit, s.
        limit_s: f64,
    },
    /// Nobody said that it stands.
    #[error(
        "no landing confirmed within {limit_s} s: the autopilot has the vehicle, in the air or on the ground"
    )]
    NotLanded {
        /// Limit, s.
        limit_s: f64,
    },
    /// What the vehicle itself reports.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// The operator asked for it.
    #[error("stopped by the operator")]
    Operator,
}

/// Something worth saying, in the order in which it happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// When, s.
    pub t_s: f64,
    /// What.
    pub kind: EventKind,
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EventKind {
    /// The pose of a body is older than the soft limit: the controller coasts on its estimate.
    Coasting {
        /// Whose.
        body: Body,
        /// Its age, s.
        age_s: f64,
        /// Whether poses came, but the same again and again.
        frozen: bool,
    },
    /// Both poses are fresh again.
    Fresh,
    /// A pose jumped and was refused.
    JumpRefused {
        /// Whose.
        body: Body,
        /// Distance from the last credible pose, m.
        distance_m: f64,
    },
    /// A proposed command was outside the room; told once per stretch of clipped commands.
    Clipped {
        /// The proposal, m.
        proposed: [f64; 3],
        /// What was sent, m.
        sent: [f64; 3],
    },
    /// The velocity of the commands was too fast to feed forward; told once per stretch.
    Slowed {
        /// Their speed, m/s.
        speed_m_s: f64,
        /// What was sent, m/s.
        limit_m_s: f64,
    },
    /// The controller missed a tick: the last command stays.
    ControllerLate,
    /// Armed, on the way to the start.
    Climbing,
    /// At the start: the controller has the vehicle.
    AtStart,
    /// The flight is over: hold in place, or the safest that is left from where the vehicle is.
    Aborted(Reason),
    /// The next rung of the abort ladder: the autopilot shall hold.
    AutopilotHold,
    /// The next rung: land.
    Land,
    /// The last rung: no set-points any more.
    Stopped,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "t = {:.3} s: {}", self.t_s, self.kind)
    }
}

impl fmt::Display for EventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EventKind::Coasting { body, age_s, frozen } => {
                let how = if *frozen { "frozen" } else { "missing" };
                write!(f, "{body} pose {how}, {age_s:.3} s old: coasting")
            }
            EventKind::Fresh => f.write_str("both poses fresh again"),
            EventKind::JumpRefused { body, distance_m } => {
                write!(f, "{body} pose jumped by {distance_m:.3} m: refused")
            }
            EventKind::Clipped {
                proposed: [x, y, z],
                sent: [u, v, w],
            } => {
                write!(
                    f,
                    "command ({x:.3}, {y:.3}, {z:.3}) outside the room: sent ({u:.3}, {v:.3}, {w:.3})"
                )
            }
            EventKind::Slowed { speed_m_s, limit_m_s } => write!(
                f,
                "commands move at {speed_m_s:.2} m/s: fed forward as {limit_m_s} m/s"
            ),
            EventKind::ControllerLate => f.write_str("controller late: the last command stays"),
            EventKind::Climbing => f.write_str("climbing to the start"),
            EventKind::AtStart => f.write_str("at the start"),
            EventKind::Aborted(reason) => write!(f, "abort: {reason}"),
            EventKind::AutopilotHold => f.write_str("autopilot Hold"),
            EventKind::Land => f.write_str("Land"),
            EventKind::Stopped => f.write_str("stream stopped"),
        }
    }
}
