//! The base station's end of the wires under a virtual clock: the rig lives in the same process, and waiting lets its time
//! go on. The same flight to the last bit, thousands of them in minutes.

use std::cell::RefCell;
use std::rc::Rc;

use flyvine::control::{Controller, Proposal, Tick};

use super::fault::FaultKind;
use super::rig::Rig;
use crate::autopilot::{ArmLink, ArmTelemetry, Clock, Flags, LatestPoses, PoseSource, Station, Wire};

/// How long a base station that stalls stands still, s.
const STALL_S: f64 = 0.16;

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
        poses: Box::new(VirtualMocap(Rc::clone(rig))),
        arm: Box::new(VirtualArm(Rc::clone(rig))),
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

struct VirtualMocap(SharedRig);

impl PoseSource for VirtualMocap {
    fn latest(&mut self, _now_s: f64) -> LatestPoses {
        self.0.borrow().latest_poses()
    }
}

struct VirtualArm(SharedRig);

impl ArmLink for VirtualArm {
    fn command(&mut self, _now_s: f64, growth_m_s: f64, pressure_kpa: f64) {
        self.0.borrow_mut().command_arm(growth_m_s, pressure_kpa);
    }

    fn telemetry(&mut self, _now_s: f64) -> Option<ArmTelemetry> {
        Some(self.0.borrow().arm_telemetry())
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
