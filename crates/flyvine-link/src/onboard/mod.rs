//! The companion computer's daemon: bridges a serial arm and a serial autopilot to the network.
//!
//! * **Arm**: datagrams carry whole frames of [`vine_arm`]'s protocol, both ways. Only frames that are whole are passed
//!   on, re-encoded. A [legacy](ArmProtocol::Legacy) arm is made to look like a new one, with the watchdog here.
//! * **Autopilot**: MAVLink packets pass through untouched, one or more whole packets per datagram.
//!
//! Answers go to whoever sent the last valid datagram (or, for the autopilot, to a fixed peer). Nothing here generates
//! set-points: when the base station falls silent, so does this, and the arm's watchdog stops it. A serial port that goes
//! away is tried again every second. When the daemon ends, it tells the arm to stop, and says whether the arm agreed.

mod arm_bridge;
mod fcu_bridge;
mod mavlink_packets;
mod serial_port;

use std::fmt;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::arm::{LegacyOptions, LegacyOptionsError};
use arm_bridge::ArmBridge;
use fcu_bridge::FcuBridge;
use serial_port::SerialPort;

/// Longest wait for bytes, ns: the control period of a legacy arm.
const TURN_NS: i64 = 5_000_000;

/// What the arm on the serial port speaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArmProtocol {
    /// Frames of [`vine_arm`].
    Framed,
    /// The prototype's ASCII line.
    Legacy(LegacyOptions),
}

/// An arm to bridge.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmPort {
    /// Serial port.
    pub path: PathBuf,
    /// Its baud rate.
    pub baud: u32,
    /// What the arm speaks.
    pub protocol: ArmProtocol,
    /// Where datagrams are received.
    pub listen: SocketAddr,
}

/// An autopilot to bridge.
#[derive(Debug, Clone, PartialEq)]
pub struct FcuPort {
    /// Serial port.
    pub path: PathBuf,
    /// Its baud rate.
    pub baud: u32,
    /// Where datagrams are received, and sent from.
    pub listen: SocketAddr,
    /// Where the autopilot's packets go until somebody else sends a datagram.
    pub peer: SocketAddr,
}

/// What happens on board.
#[derive(Debug, Clone, PartialEq)]
pub enum OnboardEvent {
    /// A bridge is up.
    Bridging {
        /// "arm" or "autopilot".
        what: &'static str,
        /// Serial port.
        path: PathBuf,
        /// Where its datagrams are received.
        listen: SocketAddr,
    },
    /// Answers go to another address from now on.
    Peer {
        /// "arm" or "autopilot".
        what: &'static str,
        /// Who sent the last valid datagram.
        address: SocketAddr,
    },
    /// A serial port failed; it is tried again every second.
    SerialLost {
        /// Which.
        path: PathBuf,
        /// Why.
        error: String,
    },
    /// A serial port is back.
    SerialBack {
        /// Which.
        path: PathBuf,
    },
    /// Ending: whether the arm has acknowledged its stop.
    ArmStopped(bool),
}

impl fmt::Display for OnboardEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OnboardEvent::Bridging { what, path, listen } => {
                write!(f, "{what}: {} <-> udp {listen}", path.display())
            }
            OnboardEvent::Peer { what, address } => write!(f, "{what}: answering {address}"),
            OnboardEvent::SerialLost { path, error } => {
                write!(f, "{} lost ({error}); trying again every second", path.display())
            }
            OnboardEvent::SerialBack { path } => write!(f, "{} is back", path.display()),
            OnboardEvent::ArmStopped(true) => f.write_str("arm stopped"),
            OnboardEvent::ArmStopped(false) => {
                f.write_str("the arm has not acknowledged its stop; its own watchdog stops it within 0.3 s")
            }
        }
    }
}

/// What was carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traffic {
    /// Frames or packets from the serial port to the network.
    pub from_serial: u64,
    /// Frames or packets from the network to the serial port.
    pub to_serial: u64,
    /// Corrupt or strange ones, not carried.
    pub rejected: u64,
    /// Dropped because the serial port was slow or away.
    pub dropped: u64,
}

/// What was done when the daemon ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OnboardSummary {
    /// Of the arm, if there was one.
    pub arm: Option<Traffic>,
    /// Whether the arm acknowledged its stop; `None` without an arm.
    pub arm_stopped: Option<bool>,
    /// Of the autopilot, if there was one.
    pub fcu: Option<Traffic>,
}

/// Why the daemon cannot run.
#[derive(Debug, thiserror::Error)]
pub enum OnboardError {
    /// Neither arm nor autopilot.
    #[error("nothing to bridge: expected a serial arm, a serial autopilot, or both")]
    Nothing,
    /// A serial port cannot be opened.
    #[error("cannot open the serial port {}: {error}", path.display())]
    Serial {
        /// Which.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// An address cannot be listened on.
    #[error("cannot listen on udp {address}: {error}")]
    Listen {
        /// Which.
        address: SocketAddr,
        /// Why.
        error: io::Error,
    },
    /// Impossible options of a legacy arm.
    #[error(transparent)]
    Legacy(#[from] LegacyOptionsError),
    /// The system cannot wait for input.
    #[error("cannot wait for input: {0}")]
    Wait(io::Error),
}

/// Bridges until `stop` is set, then stops the arm. `tell` hears what happens.
pub fn run(
    arm: Option<&ArmPort>,
    fcu: Option<&FcuPort>,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(OnboardEvent),
) -> Result<OnboardSummary, OnboardError> {
    if arm.is_none() && fcu.is_none() {
        return Err(OnboardError::Nothing);
    }
    let mut arm = arm.map(|port| ArmBridge::open(port, tell)).transpose()?;
    let mut fcu = fcu.map(|port| FcuBridge::open(port, tell)).transpose()?;
    let start = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        wait(arm.as_ref(), fcu.as_ref())?;
        let now_s = start.elapsed().as_secs_f64();
        if let Some(arm) = &mut arm {
            arm.turn(now_s, tell);
        }
        if let Some(fcu) = &mut fcu {
            fcu.turn(now_s, tell);
        }
    }
    let arm_stopped = arm.as_mut().map(|arm| arm.stop(start));
    if let Some(stopped) = arm_stopped {
        tell(OnboardEvent::ArmStopped(stopped));
    }
    Ok(OnboardSummary {
        arm: arm.map(|arm| arm.traffic()),
        arm_stopped,
        fcu: fcu.map(|fcu| fcu.traffic()),
    })
}

/// Waits for bytes on any line, or a control period.
fn wait(arm: Option<&ArmBridge>, fcu: Option<&FcuBridge>) -> Result<(), OnboardError> {
    let timeout = Timespec {
        tv_sec: 0,
        tv_nsec: TURN_NS,
    };
    let mut lines = Vec::with_capacity(4);
    for (file, socket) in [arm.map(ArmBridge::lines), fcu.map(FcuBridge::lines)]
        .into_iter()
        .flatten()
    {
        lines.push(PollFd::new(socket, PollFlags::IN));
        lines.extend(file.map(|file| PollFd::new(file, PollFlags::IN)));
    }
    match poll(&mut lines, Some(&timeout)) {
        // A signal ends the wait; the caller looks whether it was the end.
        Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
        Err(error) => Err(OnboardError::Wait(error.into())),
    }
}

/// A socket that never blocks.
/// Opens both sides of a bridge for `what`, and tells so.
fn open_sides(
    what: &'static str,
    path: &Path,
    baud: u32,
    address: SocketAddr,
    tell: &mut dyn FnMut(OnboardEvent),
) -> Result<(SerialPort, UdpSocket), OnboardError> {
    let port = SerialPort::open(path.to_owned(), baud)?;
    let socket = UdpSocket::bind(address)
        .and_then(|socket| socket.set_nonblocking(true).map(|()| socket))
        .map_err(|error| OnboardError::Listen { address, error })?;
    tell(OnboardEvent::Bridging {
        what,
        path: path.to_owned(),
        listen: socket.local_addr().unwrap_or(address),
    });
    Ok((port, socket))
}

/// Takes up to a hundred datagrams; what comes faster waits, so that no line starves the other.
fn receive(socket: &UdpSocket, mut each: impl FnMut(&[u8], SocketAddr)) {
    let mut datagram = [0; 2048];
    for _ in 0..100 {
        match socket.recv_from(&mut datagram) {
            Ok((length, from)) => each(&datagram[..length], from),
            // An earlier answer was not delivered: whoever asked is gone.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
            Err(_) => return,
        }
    }
}
