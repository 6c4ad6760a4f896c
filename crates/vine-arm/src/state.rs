//! The states of the arm, and how each is left.
//!
//! ```text
//! Waiting ──set-point──▶ Active ──no set-point for the watchdog's time──▶ Silent ──set-point──▶ Active
//!    ▲                                          any state ──Stop──▶ Stopped ──Resume──▶ Waiting
//!    └──────────────Resume, once the cause has gone────────────── Fault ◀──a fault── any state
//! ```
//!
//! Motor and pumps run in `Active` alone. A fault outlives a stop: it is seen even while stopped.

/// What the arm is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Powered up or resumed; everything off until the first set-point.
    Waiting,
    /// Following set-points.
    Active,
    /// The watchdog has stopped motor and pumps; the next set-point starts them.
    Silent,
    /// Told to stop; left by [`crate::Request::Resume`].
    Stopped,
    /// Everything off; left by [`crate::Request::Resume`] once the cause has gone.
    Fault(Fault),
}

/// Why the arm stopped itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// Pressure above [`crate::Limits::over_pressure_kpa`]. Gone when it is back at or below the greatest set-point;
    /// where there is a vent it opens meanwhile.
    #[error("over-pressure")]
    OverPressure,
    /// A pressure reading that is not finite, impossible, or no longer there. Gone with a possible reading.
    #[error("pressure sensor failed")]
    PressureSensor,
    /// A length reading that is not finite, impossible, jumping, or no longer there. Gone with a possible reading.
    #[error("length sensor failed")]
    LengthSensor,
    /// The motor was driven for [`crate::Limits::stall_travel_m`] and the spool hardly followed, or went the other
    /// way. Left by resuming: the next try shows whether it is gone.
    #[error("growth motor stalled")]
    MotorStalled,
    /// The pumps ran for [`crate::Limits::pump_timeout_s`] without reaching the set-point: a leak, or a pump that
    /// does not turn. Left by resuming: the next try shows whether it is gone.
    #[error("pumps do not raise the pressure")]
    PumpsIneffective,
    /// The board's time step was not a positive number. Left by resuming.
    #[error("the board's clock is broken")]
    Clock,
}

impl State {
    const ALL: [State; 10] = [
        State::Waiting,
        State::Active,
        State::Silent,
        State::Stopped,
        State::Fault(Fault::OverPressure),
        State::Fault(Fault::PressureSensor),
        State::Fault(Fault::LengthSensor),
        State::Fault(Fault::MotorStalled),
        State::Fault(Fault::PumpsIneffective),
        State::Fault(Fault::Clock),
    ];

    /// The wire code: faults begin at 16.
    pub fn code(self) -> u8 {
        match self {
            State::Waiting => 0,
            State::Active => 1,
            State::Silent => 2,
            State::Stopped => 3,
            State::Fault(Fault::OverPressure) => 16,
            State::Fault(Fault::PressureSensor) => 17,
            State::Fault(Fault::LengthSensor) => 18,
            State::Fault(Fault::MotorStalled) => 19,
            State::Fault(Fault::PumpsIneffective) => 20,
            State::Fault(Fault::Clock) => 21,
        }
    }

    /// The state of a wire code.
    pub(crate) fn from_code(code: u8) -> Option<State> {
        State::ALL.into_iter().find(|state| state.code() == code)
    }
}

impl core::fmt::Display for State {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            State::Waiting => f.write_str("waiting for a set-point"),
            State::Active => f.write_str("active"),
            State::Silent => f.write_str("stopped by the watchdog"),
            State::Stopped => f.write_str("stopped"),
            State::Fault(fault) => write!(f, "fault: {fault}"),
        }
    }
}
