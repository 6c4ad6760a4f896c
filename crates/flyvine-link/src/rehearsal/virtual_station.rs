//! The base station's end of the wires under a virtual clock: the rig lives in the same process, and waiting lets its time
//! go on. The same flight to the last bit, thousands of them in minutes.

use std::cell::RefCell;
use std::io::{ErrorKind, Read, Write};
use std::rc::Rc;
use std::time::{Duration, Instant};

use flyvine::control::{Controller, Proposal, Tick};

use super::fault::FaultKind;
use super::rig::{Rig, rig_bodies};
use crate::arm::FramedArm;
use crate::autopilot::{Clock, Flags, LatestPoses, PoseSource, Station, Wire, WiredArm};
use crate::mocap::{HygieneLimits, Incoming, Tracker};

/// How long a base station that stalls stands still, s.
pub const STALL_S: f64 = 0.16;

/// The rig, shared by the wires of one station and by whoever judges.
pub type SharedRig = Rc<RefCell<Rig>>;

/// A station on `rig`; scripted faults of the base station raise its `flags`.
pub fn virtual_station(rig: &SharedRig, flags: &Flags) -> Station {
    Station {
        clock: Box::new(VirtualClock {
            rig: Rc::clone(rig),
            flags: flags.clone(),
            stalled: false,
        }),
        wire: Box::new(VirtualWire(Rc::clone(rig))),
        poses: Box::new(VirtualMocap::new(rig)),
        arm: Box::new(WiredArm::new(Box::new(FramedArm::new(
            VirtualLine(Rc::clone(rig)),
            rig.borrow().now_s(),
        )))),
    }
}

struct VirtualClock {
    rig: SharedRig,
    flags: Flags,
    stalled: bool,
}

impl Clock for VirtualClock {
    fn now_s(&self) -> f64 {
        self.rig.borrow().now_s()
    }

    fn sleep_until(&mut self, time_s: f64) {
        let mut rig = self.rig.borrow_mut();
        let mut until_s = time_s;
        if rig.has(FaultKind::BaseStalls) && !self.stalled {
            self.stalled = true;
            until_s += STALL_S;
        }
        if rig.has(FaultKind::DiskFull) {
            self.flags
                .recording_failed
                .store(true, std::sync::atomic::Ordering::Relaxed);
        }
        // A vehicle that can no longer be simulated is as silent as one that is no more.
        let _ = rig.advance_to(until_s);
    }
}

struct VirtualWire(SharedRig);

impl Wire for VirtualWire {
    fn send(&mut self, frame: &[u8]) {
        self.0.borrow_mut().receive(frame);
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) {
        for frame in self.0.borrow_mut().take_frames() {
            bytes.extend(frame);
        }
    }
}

/// Frames without a network: from the rig to what judges them.
struct VirtualMocap {
    rig: SharedRig,
    tracker: Tracker,
    epoch: Instant,
}

impl VirtualMocap {
    fn new(rig: &SharedRig) -> Self {
        let epoch = Instant::now();
        Self {
            rig: Rc::clone(rig),
            tracker: Tracker::new(Some(rig_bodies()), HygieneLimits::default(), epoch),
            epoch,
        }
    }

    /// An instant for a time of the rig's clock; only differences matter.
    fn instant(&self, time_s: f64) -> Instant {
        self.epoch + Duration::from_secs_f64(time_s.max(0.0))
    }
}

impl PoseSource for VirtualMocap {
    fn latest(&mut self, now_s: f64) -> LatestPoses {
        let frames = self.rig.borrow_mut().take_mocap_frames();
        for frame in frames {
            let arrived = self.instant(frame.captured_s);
            self.tracker.take(Incoming::Frame(frame, arrived));
        }
        let latest = self.tracker.latest(self.instant(now_s));
        LatestPoses::new(&latest, |instant| (instant - self.epoch).as_secs_f64())
    }
}

/// The arm's line without a device.
struct VirtualLine(SharedRig);

impl Read for VirtualLine {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let said = self.0.borrow_mut().take_arm_bytes();
        if said.is_empty() {
            return Err(ErrorKind::WouldBlock.into());
        }
        // What does not fit is lost, as on a line that nobody reads for long.
        let count = said.len().min(buffer.len());
        buffer[..count].copy_from_slice(&said[..count]);
        Ok(count)
    }
}

impl Write for VirtualLine {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.borrow_mut().receive_arm(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A controller that is late while the script says so.
pub struct LateController<'a> {
    controller: &'a mut dyn Controller,
    rig: SharedRig,
}

impl<'a> LateController<'a> {
    /// `controller`, as the script of `rig` lets it answer.
    pub fn new(controller: &'a mut dyn Controller, rig: &SharedRig) -> Self {
        Self {
            controller,
            rig: Rc::clone(rig),
        }
    }
}

impl Controller for LateController<'_> {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        match self.rig.borrow().has(FaultKind::SolverLate) {
            true => Proposal::Late,
            false => self.controller.propose(tick),
        }
    }
}
