//! The soft arm on a serial line or behind the companion computer.
//!
//! [`connect`] gives an [`Arm`]: something that takes set-points at 20 Hz and tells what it knows. The protocol and the
//! rules of the arm itself are in [`vine_arm`]; here are the host's half of the protocol ([`ArmClient`], without input
//! or output) and what carries it.
//!
//! | address | arm |
//! | --- | --- |
//! | `serial:PATH` or `serial:PATH,BAUD` | one that speaks [`vine_arm`]'s protocol |
//! | `udp:HOST:PORT` | the same behind `flyvine onboard` |
//! | `legacy:PATH` or `legacy:PATH,BAUD` | the prototype's ASCII line, with default [`LegacyOptions`] |

mod client;
mod emulator;
mod framed;
mod legacy;
mod line;
mod software;

pub use client::{ArmClient, ArmStatus};
pub use emulator::EmulatedBoard;
pub use framed::{FramedArm, UdpLine};
pub use legacy::{LegacyArm, LegacyDevice, LegacyOptions, LegacyOptionsError, Terminator};
pub use line::{Pty, open_serial};
pub use software::SoftwareArm;
pub use vine_arm::{Request, Setpoint, Telemetry};

use std::io;

/// Baud rate of the arm's line unless said otherwise (the prototype's).
pub const DEFAULT_BAUD: u32 = 115_200;

/// An arm that takes set-points.
///
/// Call [`poll`](Arm::poll) and then [`send`](Arm::send) at every tick of 50 ms: an arm that hears nothing for 0.25 s stops.
/// Times are the caller's monotonic clock, s.
pub trait Arm {
    /// Sends a set-point; instead of it the newest [`ask`](Arm::ask), as long as that is unanswered.
    fn send(&mut self, now_s: f64, setpoint: Setpoint) -> Result<(), ArmError>;

    /// Asks for a stop, a resume or a length: sent with this and each following [`send`](Arm::send) until answered.
    fn ask(&mut self, now_s: f64, request: Request) -> Result<(), ArmError>;

    /// Takes what has arrived; never waits.
    fn poll(&mut self, now_s: f64) -> Result<(), ArmError>;

    /// What is known of the arm.
    fn status(&self, now_s: f64) -> ArmStatus;
}

/// Why an arm can no longer be reached, or a request not be sent.
#[derive(Debug, thiserror::Error)]
pub enum ArmError {
    /// An address that is none.
    #[error("no arm at `{0}`: expected serial:PATH[,BAUD], udp:HOST:PORT or legacy:PATH[,BAUD]")]
    Address(String),
    /// The line cannot be opened.
    #[error("cannot open the arm's line {place}: {error}")]
    Open {
        /// Path or address.
        place: String,
        /// Why.
        error: io::Error,
    },
    /// Reading from or writing to the line failed.
    #[error("the arm's line failed: {0}")]
    Line(#[from] io::Error),
    /// The other end has hung up.
    #[error("the arm's line is closed")]
    Closed,
    /// A set-point or length with a NaN or an infinity.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    /// Impossible limits or options.
    #[error(transparent)]
    Legacy(#[from] LegacyOptionsError),
}

/// Opens the arm at an [address](self).
pub fn connect(address: &str, now_s: f64) -> Result<Box<dyn Arm + Send>, ArmError> {
    let unknown = || ArmError::Address(address.to_owned());
    let (kind, place) = address.split_once(':').ok_or_else(unknown)?;
    let open = |place: &str| -> Result<std::fs::File, ArmError> {
        let (path, baud) = match place.rsplit_once(',') {
            Some((path, baud)) => (path, baud.parse().map_err(|_| unknown())?),
            None => (place, DEFAULT_BAUD),
        };
        let failed = |error| ArmError::Open {
            place: path.to_owned(),
            error,
        };
        open_serial(path.as_ref(), baud).map_err(failed)
    };
    Ok(match kind {
        "serial" => Box::new(FramedArm::new(open(place)?, now_s)),
        "legacy" => Box::new(LegacyArm::new(open(place)?, LegacyOptions::default(), now_s)?),
        "udp" => {
            let failed = |error| ArmError::Open {
                place: place.to_owned(),
                error,
            };
            Box::new(FramedArm::new(UdpLine::connect(place).map_err(failed)?, now_s))
        }
        _ => return Err(unknown()),
    })
}

/// Refuses what JSON, wires and arms cannot carry.
fn check_finite(request: &Request) -> Result<(), ArmError> {
    let check = |name, value: f32| {
        if value.is_finite() {
            Ok(())
        } else {
            Err(ArmError::NotFinite(name))
        }
    };
    match request {
        Request::Setpoint(setpoint) => {
            check("the growth rate", setpoint.growth_rate_m_s)?;
            check("the pressure set-point", setpoint.pressure_kpa)
        }
        Request::SetLength(length_m) => check("the length", *length_m),
        Request::Stop | Request::Resume => Ok(()),
    }
}
