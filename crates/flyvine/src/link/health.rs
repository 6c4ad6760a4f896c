//! What a vehicle in real time knows beside its poses.

/// What the autopilot is to do with the set-points, or does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Stand by, not armed, while the set-points already stream.
    Standby,
    /// Arm if need be, and follow the set-points.
    Offboard,
    /// Hold position.
    Hold,
    /// Land.
    Land,
}

/// When the newest pose of each body was captured, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Captured {
    /// Of the quadrotor.
    pub quadrotor_s: f64,
    /// Of the end effector.
    pub end_effector_s: f64,
}

/// The state of the wires at one tick. Times are seconds on one clock that never runs backwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Health {
    /// Now.
    pub now_s: f64,
    /// When the poses were captured.
    pub captured: Captured,
    /// When the autopilot was last heard.
    pub autopilot_heard_s: f64,
    /// When the arm was last heard; `None` of an arm that never answers, as the authors' prototype.
    pub arm_heard_s: Option<f64>,
    /// By how many whole periods this tick is late.
    pub missed_ticks: u32,
    /// Whether the motors are armed.
    pub armed: bool,
    /// Whether the autopilot says that it stands on the ground.
    pub standing: bool,
    /// The mode that the autopilot says it is in; `None` for one that is not listed.
    pub mode: Option<Mode>,
    /// What went wrong, if anything did.
    pub fault: Option<Fault>,
}

/// What can go wrong beyond the poses and the silence of a wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Fault {
    /// Somebody else took the vehicle, the pilot or the autopilot's own failsafe: it is not ours to command any more.
    #[error("the autopilot left the mode that it was in: the pilot or its own failsafe has the vehicle")]
    TakenOver,
    /// The motors went off in flight, or the autopilot started anew.
    #[error("the autopilot disarmed or restarted in flight")]
    Disarmed,
    /// The autopilot refuses to follow set-points or to arm.
    #[error("the autopilot refuses to arm or to follow set-points")]
    Refused,
    /// The arm reports a fault.
    #[error("the arm reports fault {code}")]
    Arm {
        /// The arm's own number for it.
        code: u8,
    },
    /// The recording cannot be written.
    #[error("the recording cannot be written")]
    Recording,
}
