//! A vehicle behind an autopilot, in real time: the link, motion capture and the arm, paced at 20 Hz.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use flyvine::DT;
use flyvine::control::Trajectory;
use flyvine::control::supervisor::Limits;
use flyvine::flight::Configuration;
use flyvine::link::{Captured, Fault, Health, Mode, Observation, Setpoint, Vehicle, VehicleError};

use super::arm_link::{ArmLink, ArmTelemetry, growth_rate};
use super::checklist::{Checklist, Weight};
use super::clock::Clock;
use super::link::{AutopilotLink, LinkOptions};
use super::pose_source::{LatestPoses, PoseSource};
use super::preflight::{Findings, MocapWatch, WATCH_S, check};
use super::tick_times::{TickReport, TickTimes};
use super::wire::Wire;

/// Longest time between two looks at the wires, s.
const POLL_S: f64 = 0.005;
/// Least time between two poses relayed to the autopilot, s: 50 Hz, as its filter wants them.
const VISION_S: f64 = 0.018;
/// Longest wait for the autopilot before a flight, s, and for what is asked of it then.
const CONNECT_S: f64 = 10.0;
const ANSWERS_S: f64 = 6.0;

/// Everything outside that the vehicle is made of.
pub struct Station {
    /// What everything is stamped with.
    pub clock: Box<dyn Clock>,
    /// The line to the autopilot.
    pub wire: Box<dyn Wire>,
    /// Motion capture.
    pub poses: Box<dyn PoseSource>,
    /// The line to the arm.
    pub arm: Box<dyn ArmLink>,
}

/// What the wires said, newest of all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heard {
    /// Now, s on the link's clock.
    pub now_s: f64,
    /// Of motion capture.
    pub poses: LatestPoses,
    /// Of the arm; `None` where there is none on the wire.
    pub arm: Option<ArmTelemetry>,
    /// The mode that the autopilot says it is in; `None` for one that is not listed.
    pub mode: Option<Mode>,
    /// Whether it says that its motors are armed.
    pub armed: bool,
    /// When it was last heard, s.
    pub autopilot_heard_s: f64,
}

/// Whoever wants to know what the wires say. It must not block.
pub type Listener = Box<dyn FnMut(&Heard)>;

/// Flags that other threads may raise.
#[derive(Debug, Clone, Default)]
pub struct Flags {
    /// The operator wants to stop.
    pub interrupted: Arc<AtomicBool>,
    /// The recording cannot be written.
    pub recording_failed: Arc<AtomicBool>,
}

/// A vehicle behind an autopilot; see the [module](self).
pub struct AutopilotVehicle {
    link: AutopilotLink,
    station: Station,
    flags: Flags,
    trajectory: Trajectory,
    limits: Limits,
    checklist: Option<Checklist>,
    mode: Mode,
    configuration: Configuration,
    last_step: Configuration,
    vision_s: f64,
    next_tick_s: f64,
    missed_ticks: u32,
    times: TickTimes,
    health: Option<Health>,
    notes: Vec<String>,
    listener: Option<Listener>,
    bytes: Vec<u8>,
}

impl AutopilotVehicle {
    /// A vehicle that will fly `trajectory` within `limits`; nothing is sent yet.
    pub fn new(
        options: LinkOptions,
        station: Station,
        flags: Flags,
        trajectory: Trajectory,
        limits: Limits,
    ) -> Self {
        let configuration = trajectory.configuration(0);
        Self {
            link: AutopilotLink::new(options),
            station,
            flags,
            trajectory,
            limits,
            checklist: None,
            mode: Mode::Standby,
            configuration,
            last_step: configuration,
            vision_s: f64::NEG_INFINITY,
            next_tick_s: 0.0,
            missed_ticks: 0,
            times: TickTimes::default(),
            health: None,
            notes: Vec::new(),
            listener: None,
            bytes: Vec::new(),
        }
    }

    /// From now on `listener` is told of what the wires say, at every look at them: some 200 times a second.
    pub fn listen(&mut self, listener: Listener) {
        self.listener = Some(listener);
    }

    /// Connects, reads the parameters back and goes through the checklist; arms nothing.
    pub fn prepare(&mut self) -> Result<&Checklist, VehicleError> {
        let begun_s = self.station.clock.now_s();
        self.station
            .arm
            .prepare(begun_s, self.trajectory.configuration(0));
        self.wait_until(begun_s + CONNECT_S, |vehicle| {
            vehicle.link.telemetry().identity.is_some()
        })?;
        let mut watch = MocapWatch::default();
        // What came before anybody listened is not to be judged.
        self.wait_until(self.station.clock.now_s() + 2.0 * DT, |_| false)?;
        let heard_s = self.station.clock.now_s();
        let mut seen_s = heard_s;
        loop {
            self.poll();
            let now_s = self.station.clock.now_s();
            watch.see(now_s, now_s - seen_s, &self.station.poses.latest(now_s));
            seen_s = now_s;
            let answered = self.has_answers();
            if (answered && now_s - heard_s >= WATCH_S) || now_s - heard_s >= ANSWERS_S {
                break;
            }
            if self.flags.interrupted.load(Ordering::Relaxed) {
                return Err(VehicleError::Interrupted);
            }
            self.station.clock.sleep_until(now_s + POLL_S);
        }
        let now_s = self.station.clock.now_s();
        let checklist = check(&Findings {
            profile: self.link.options().profile,
            telemetry: self.link.telemetry(),
            now_s,
            watch,
            latest: self.station.poses.latest(now_s),
            arm: self.station.arm.telemetry(now_s),
            trajectory: &self.trajectory,
            limits: &self.limits,
        });
        Ok(self.checklist.insert(checklist))
    }

    /// The checklist of the last [`prepare`](Self::prepare).
    pub fn checklist(&self) -> Option<&Checklist> {
        self.checklist.as_ref()
    }

    /// How the ticks were kept so far.
    pub fn tick_report(&self) -> Option<TickReport> {
        self.times.report()
    }

    /// What the autopilot had to say, since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    fn has_answers(&self) -> bool {
        let telemetry = self.link.telemetry();
        let rules = self.link.options().profile.rules();
        let known = |name: &str| telemetry.parameters.contains_key(name);
        let told = telemetry.has_origin && telemetry.position.is_some() && telemetry.on_ground.is_some();
        told && rules.iter().all(|rule| known(rule.name))
    }

    /// Looks at every wire once: takes in what came, relays the newest pose, sends what is due.
    fn poll(&mut self) {
        let now_s = self.station.clock.now_s();
        self.bytes.clear();
        self.station.wire.receive(&mut self.bytes);
        self.link.receive(now_s, &self.bytes);
        self.link.tick(now_s);
        // Listening is also calling, to an arm that has not answered yet.
        let arm = self.station.arm.telemetry(now_s);
        let poses = self.station.poses.latest(now_s);
        if let Some(listener) = &mut self.listener {
            listener(&Heard {
                now_s,
                poses,
                arm,
                mode: self.link.mode(),
                armed: self.link.telemetry().armed,
                autopilot_heard_s: self.link.telemetry().heard_s,
            });
        }
        if let Some(pose) = poses.quadrotor
            && pose.captured_s >= self.vision_s + VISION_S
        {
            self.vision_s = pose.captured_s;
            let speed_max = self.limits.quadrotor_speed_max_m_s;
            self.link.send_vision(&pose.value, pose.captured_s, speed_max);
        }
        self.flush(now_s);
    }

    fn flush(&mut self, now_s: f64) {
        for frame in self.link.take_frames() {
            self.station.wire.send(&frame);
        }
        let notes = self.link.take_notes();
        self.notes
            .extend(notes.into_iter().map(|note| format!("{now_s:.3} s: {note}")));
    }

    /// Polls until `time_s`, or until `done`; an error if the operator interrupts.
    fn wait_until(&mut self, time_s: f64, done: impl Fn(&Self) -> bool) -> Result<(), VehicleError> {
        loop {
            self.poll();
            let now_s = self.station.clock.now_s();
            if now_s >= time_s || done(self) {
                return Ok(());
            }
            if self.flags.interrupted.load(Ordering::Relaxed) {
                return Err(VehicleError::Interrupted);
            }
            self.station.clock.sleep_until(time_s.min(now_s + POLL_S));
        }
    }

    /// Waits for the next tick on the grid, and says how it was kept.
    fn tick(&mut self) {
        loop {
            self.poll();
            let now_s = self.station.clock.now_s();
            if now_s >= self.next_tick_s {
                self.missed_ticks = self.times.tick(now_s - self.next_tick_s);
                self.next_tick_s += DT;
                return;
            }
            self.station
                .clock
                .sleep_until(self.next_tick_s.min(now_s + POLL_S));
        }
    }

    /// The newest poses and the state of the wires, now.
    fn observe(&mut self) -> Observation {
        let now_s = self.station.clock.now_s();
        let LatestPoses {
            quadrotor,
            end_effector,
        } = self.station.poses.latest(now_s);
        let arm = self.station.arm.telemetry(now_s);
        let telemetry = self.link.telemetry();
        let fault = match arm.and_then(|arm| arm.fault()) {
            _ if telemetry.restarted => Some(Fault::Disarmed),
            _ if self.link.is_refused() => Some(Fault::Refused),
            _ if self.flags.recording_failed.load(Ordering::Relaxed) => Some(Fault::Recording),
            Some(code) => Some(Fault::Arm { code }),
            None => None,
        };
        self.health = Some(Health {
            now_s,
            captured: Captured {
                quadrotor_s: quadrotor.map_or(f64::NEG_INFINITY, |pose| pose.captured_s),
                end_effector_s: end_effector.map_or(f64::NEG_INFINITY, |tip| tip.captured_s),
            },
            autopilot_heard_s: telemetry.heard_s,
            arm_heard_s: arm.map(|arm| arm.heard_s),
            missed_ticks: self.missed_ticks,
            armed: telemetry.armed,
            standing: !telemetry.armed || telemetry.on_ground == Some(true),
            mode: self.link.mode(),
            fault,
        });
        Observation {
            t_s: now_s,
            quadrotor: quadrotor.map(|pose| pose.value),
            end_effector: end_effector.map(|tip| tip.value),
        }
    }

    /// Tells the arm where to go in the coming period.
    fn command_arm(&mut self, now_s: f64, configuration: Configuration) {
        let measured_m = self.station.arm.telemetry(now_s).and_then(|arm| arm.length_m);
        let growth_m_s = growth_rate(self.last_step, configuration, measured_m);
        self.station
            .arm
            .command(now_s, growth_m_s, configuration.pressure_kpa);
        self.last_step = configuration;
    }
}

impl Vehicle for AutopilotVehicle {
    /// Connects and checks, if [`prepare`](Self::prepare) was not called; the vehicle then stands on the ground.
    fn reset(&mut self, configuration: Configuration, _seed: u64) -> Result<Observation, VehicleError> {
        if self.checklist.is_none() {
            self.prepare()?;
        }
        let checklist = self.checklist.take().unwrap_or_default();
        if !checklist.is_ready() {
            let missing: Vec<String> = checklist
                .missing(Weight::Blocking)
                .map(ToString::to_string)
                .collect();
            return Err(VehicleError::NotReady {
                what: missing.join("\n"),
            });
        }
        self.set_mode(Mode::Standby);
        (self.configuration, self.last_step) = (configuration, configuration);
        self.next_tick_s = self.station.clock.now_s();
        self.tick();
        Ok(self.observe())
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let now_s = self.station.clock.now_s();
        self.link.send_setpoint(now_s, setpoint);
        self.flush(now_s);
        self.times.sent(now_s);
        self.command_arm(now_s, configuration);
        self.tick();
        Ok(self.observe())
    }

    fn health(&self) -> Option<Health> {
        self.health
    }

    fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.link.set_mode(mode);
    }

    /// Leaves the arm at rest.
    fn close(&mut self) -> Result<(), VehicleError> {
        let now_s = self.station.clock.now_s();
        self.station.arm.command(now_s, 0.0, self.last_step.pressure_kpa);
        Ok(())
    }
}
