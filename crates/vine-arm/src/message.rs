//! What host and arm say to each other. [`crate::frame`] has the bytes around it.
//!
//! The host sends [`Request`]s; the arm answers each with an [acknowledgement](Message::Acknowledgement) that carries
//! the request's sequence number, and reports [`Telemetry`] of its own accord. A request that is silently lost is
//! recognised by its missing acknowledgement; one that is refused says why.
//!
//! | kind | message | payload, little-endian |
//! | --- | --- | --- |
//! | 0x01 | set-point | growth rate f32 m/s, pressure f32 kPa |
//! | 0x02 | stop | – |
//! | 0x03 | resume | – |
//! | 0x04 | set length | length f32 m |
//! | 0x81 | acknowledgement | 0 accepted, else the [`Refusal`] u8 |
//! | 0x82 | telemetry | see [`Telemetry`] |

use crate::pumps::Air;
use crate::state::State;

/// One message with its sequence number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Counts the sender's messages, wrapping; an acknowledgement repeats the request's.
    pub sequence: u16,
    /// The message.
    pub message: Message,
}

/// What a frame carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Message {
    /// Host to arm.
    Request(Request),
    /// Arm to host: the request of this sequence number was accepted or refused.
    Acknowledgement(Result<(), Refusal>),
    /// Arm to host.
    Telemetry(Telemetry),
}

/// What the host can ask of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request {
    /// Follow this; feeds the watchdog.
    Setpoint(Setpoint),
    /// Motor and pumps off until [`Request::Resume`].
    Stop,
    /// Leave the stop, or a fault whose cause has gone.
    Resume,
    /// The arm's length as known from elsewhere (tape, motion capture), m: for arms without a spool encoder.
    SetLength(f32),
}

/// What the arm shall do until the next set-point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Growth rate, m/s; negative retracts.
    pub growth_rate_m_s: f32,
    /// Gauge pressure of the tube, kPa; zero switches the pumps off.
    pub pressure_kpa: f32,
}

/// Why the arm did not accept a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[repr(u8)]
pub enum Refusal {
    /// NaN or infinite.
    #[error("growth rate is not finite")]
    GrowthRateNotFinite = 1,
    /// Faster than [`crate::Limits::max_growth_rate_m_s`].
    #[error("growth rate is above the arm's greatest")]
    GrowthRateOutOfRange = 2,
    /// NaN or infinite.
    #[error("pressure is not finite")]
    PressureNotFinite = 3,
    /// Negative, or above [`crate::Limits::max_pressure_kpa`].
    #[error("pressure is negative or above the arm's greatest")]
    PressureOutOfRange = 4,
    /// NaN or infinite.
    #[error("length is not finite")]
    LengthNotFinite = 5,
    /// Outside the arm's end stops.
    #[error("length is outside the arm's end stops")]
    LengthOutOfRange = 6,
    /// Growth was asked for, but without a length the arm cannot keep its end stops.
    #[error("length is unknown: set it before growing")]
    LengthUnknown = 7,
    /// The arm measures its length and will not be told it.
    #[error("length is measured by the arm")]
    LengthMeasured = 8,
    /// A newer request has been accepted within the watchdog's time.
    #[error("older than a request already accepted")]
    OldSequence = 9,
    /// [`Request::Resume`] comes first.
    #[error("the arm is stopped")]
    Stopped = 10,
    /// [`Request::Resume`] comes first.
    #[error("the arm is in a fault state")]
    Faulted = 11,
    /// The cause of the fault is still there.
    #[error("the fault persists")]
    FaultPersists = 12,
}

impl Refusal {
    const ALL: [Refusal; 12] = [
        Refusal::GrowthRateNotFinite,
        Refusal::GrowthRateOutOfRange,
        Refusal::PressureNotFinite,
        Refusal::PressureOutOfRange,
        Refusal::LengthNotFinite,
        Refusal::LengthOutOfRange,
        Refusal::LengthUnknown,
        Refusal::LengthMeasured,
        Refusal::OldSequence,
        Refusal::Stopped,
        Refusal::Faulted,
        Refusal::FaultPersists,
    ];

    /// The refusal of a wire code.
    pub(crate) fn from_code(code: u8) -> Option<Refusal> {
        Refusal::ALL.into_iter().find(|refusal| *refusal as u8 == code)
    }
}

/// The arm's report: 20 times a second, and at once when its state changes.
///
/// On the wire, in the order of the fields: u32, u32 (all ones for none), u8 flags (bit 0 length known, bit 1 pressure
/// known), 4 × f32, 2 × u8, 2 × u32; an unknown value is sent as zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Telemetry {
    /// The arm's own clock since power-up, ms, wrapping.
    pub time_ms: u32,
    /// Age of the newest accepted set-point by the arm's own clock, ms.
    pub setpoint_age_ms: Option<u32>,
    /// Length estimate, m; `None` where neither measured nor set.
    pub length_m: Option<f32>,
    /// Gauge pressure, kPa; `None` without a sensor.
    pub pressure_kpa: Option<f32>,
    /// Growth rate after the end stops, m/s: what the motor is asked for.
    pub growth_rate_m_s: f32,
    /// Motor duty, −1 to 1.
    pub growth_duty: f32,
    /// Pumps and vent.
    pub air: Air,
    /// State or fault.
    pub state: State,
    /// Requests received whole, wrapping, whether accepted or refused.
    pub frames_received: u32,
    /// Frames rejected as corrupt, wrapping.
    pub frames_rejected: u32,
}
