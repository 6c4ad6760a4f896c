//! The rig in real time over sockets.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};

use flyvine::link::VehicleError;

use super::fault::{FaultKind, Phase};
use super::feed::{ArmServer, PoseFeed};
use super::rig::{PERIOD_S, Rig};
use crate::autopilot::{Clock, MonotonicClock, UdpWire, Wire};

/// Where the wires end, all on one machine.
#[derive(Debug, Clone, Copy)]
pub struct Addresses {
    /// The base station's MAVLink port, which is called.
    pub autopilot: SocketAddr,
    /// The base station's pose listener, which is fed; none if nobody wants poses.
    pub poses: Option<SocketAddr>,
    /// Where the arm listens; none if there is nobody to command it.
    pub arm: Option<SocketAddr>,
}

/// Why the vehicle's end stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A socket that cannot be opened.
    #[error("{what} {address}: {error}")]
    Socket {
        /// Which.
        what: &'static str,
        /// Where.
        address: SocketAddr,
        /// What the system says.
        error: std::io::Error,
    },
    /// The physics.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// What happened at the vehicle's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RigEvent {
    /// A phase began.
    Phase(Phase),
    /// A fault began.
    Fault(FaultKind),
}

/// Serves `rig` until `stop`. Each event is told to `tell` as it happens.
pub fn serve(
    rig: &mut Rig,
    addresses: &Addresses,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(f64, RigEvent),
) -> Result<(), ServeError> {
    let failed = |what, address| move |error| ServeError::Socket { what, address, error };
    let address = addresses.autopilot;
    let mut wire = UdpWire::call(address).map_err(failed("autopilot", address))?;
    let mut feed = match addresses.poses {
        Some(address) => Some(PoseFeed::to(address).map_err(failed("poses", address))?),
        None => None,
    };
    let mut arm = match addresses.arm {
        Some(address) => Some(ArmServer::bind(address).map_err(failed("arm", address))?),
        None => None,
    };
    let mut clock = MonotonicClock::start();
    let mut phase = Phase::Idle;
    let mut begun = Vec::new();
    let mut arm_told_s = f64::NEG_INFINITY;
    let mut bytes = Vec::new();
    let mut next_s = 0.0;
    while !stop.load(Ordering::Relaxed) {
        bytes.clear();
        wire.receive(&mut bytes);
        if !bytes.is_empty() {
            rig.receive(&bytes);
        }
        if let Some((growth_m_s, pressure_kpa)) = arm.as_mut().and_then(ArmServer::receive) {
            rig.command_arm(growth_m_s, pressure_kpa);
        }
        rig.advance_to(clock.now_s())?;
        for frame in rig.take_frames() {
            wire.send(&frame);
        }
        if let Some(feed) = &mut feed {
            feed.publish(&clock, &rig.latest_poses());
        }
        let telemetry = rig.arm_telemetry();
        if let Some(arm) = &mut arm
            && telemetry.heard_s > arm_told_s
        {
            arm_told_s = telemetry.heard_s;
            arm.publish(&telemetry);
        }
        if rig.faults().phase() != phase {
            phase = rig.faults().phase();
            tell(rig.now_s(), RigEvent::Phase(phase));
        }
        for kind in FaultKind::ALL {
            if rig.has(kind) && !begun.contains(&kind) {
                begun.push(kind);
                tell(rig.now_s(), RigEvent::Fault(kind));
            }
        }
        next_s += PERIOD_S;
        clock.sleep_until(next_s);
    }
    Ok(())
}
