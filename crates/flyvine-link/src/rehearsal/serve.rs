//! The rig in real time over sockets.

use std::fs::File;
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use flyvine::link::VehicleError;

use super::fault::{FaultKind, Phase};
use super::rig::{PERIOD_S, Rig};
use crate::arm::Pty;
use crate::autopilot::{Clock, MonotonicClock, Wire};
use crate::mocap::{MocapError, MocapServer};

/// The vehicle's ends of the wires.
pub struct Ends {
    /// The line to the base station's MAVLink port.
    pub autopilot: Box<dyn Wire>,
    /// Motion capture; none if nobody wants poses.
    pub mocap: Option<MocapServer>,
    /// The arm's serial line; none if there is nobody to command it.
    pub arm: Option<Pty>,
    /// The serial line to a board with the arm's firmware, if there is one: [`Rig::use_board`].
    pub board: Option<File>,
}

/// Why the vehicle's end stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Motion capture.
    #[error(transparent)]
    Mocap(#[from] MocapError),
    /// The physics.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// What happened at the vehicle's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RigEvent {
    /// A phase began.
    Phase {
        /// Which.
        phase: Phase,
        /// [`Rig::loop_phase_s`].
        loop_phase_s: f64,
    },
    /// A fault began.
    Fault(FaultKind),
}

/// Serves `rig` until `stop`. Each event is told to `tell` as it happens.
pub fn serve(
    rig: &mut Rig,
    ends: &mut Ends,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(f64, RigEvent),
) -> Result<(), ServeError> {
    let mut clock = MonotonicClock::start();
    let mut phase = Phase::Idle;
    let mut begun = Vec::new();
    let mut bytes = Vec::new();
    let mut next_s = 0.0;
    while !stop.load(Ordering::Relaxed) {
        // First what happened, then what came meanwhile: nothing acts before it arrived.
        rig.advance_to(clock.now_s())?;
        bytes.clear();
        ends.autopilot.receive(&mut bytes);
        if !bytes.is_empty() {
            rig.receive(&bytes);
        }
        if let Some(arm) = &mut ends.arm {
            read(&mut arm.file, |bytes| rig.receive_arm(bytes));
        }
        if let Some(board) = &mut ends.board {
            read(board, |bytes| rig.hear_board(bytes));
        }
        for frame in rig.take_frames() {
            ends.autopilot.send(&frame);
        }
        for frame in rig.take_mocap_frames() {
            if let Some(mocap) = &ends.mocap {
                mocap.publish(clock.unix_s(frame.captured_s), &frame.bodies)?;
            }
        }
        // A line whose buffer is full loses the bytes, as a real one.
        let said = rig.take_arm_bytes();
        if let Some(arm) = &mut ends.arm {
            let _ = arm.file.write(&said);
        }
        let told = rig.take_for_board();
        if let Some(board) = &mut ends.board {
            let _ = board.write(&told);
        }
        if rig.faults().phase() != phase {
            phase = rig.faults().phase();
            let loop_phase_s = rig.loop_phase_s();
            tell(rig.now_s(), RigEvent::Phase { phase, loop_phase_s });
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

/// Takes what waits on a line that never blocks.
fn read(line: &mut File, mut take: impl FnMut(&[u8])) {
    let mut bytes = [0; 2048];
    while let Ok(count @ 1..) = line.read(&mut bytes) {
        take(&bytes[..count]);
    }
}
