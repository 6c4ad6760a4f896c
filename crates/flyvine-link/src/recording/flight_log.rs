//! What is put down of a flight on the link, from its two sides: what the wires say, and what the flight loop makes of it.

use flyvine::control::FlownRow;
use flyvine::control::supervisor::{EventKind, State};
use flyvine::flight::Pose;

use super::{Body, FlightRecorder, LogLevel, RecordingError, SupervisorRow};
use crate::autopilot::{Heard, MonotonicClock};

/// The arm's silence is measured to rounding, s; it speaks every 50 ms.
const NEW_S: f64 = 1e-6;

/// Puts a flight down as it goes on.
#[derive(Debug)]
pub struct FlightLog {
    recorder: FlightRecorder,
    clock: MonotonicClock,
    newest: Option<Heard>,
    /// Capture times of the newest poses that were put down, s.
    poses_s: [f64; 2],
    /// When the arm was heard that was put down last, s.
    arm_s: f64,
    /// Whether the rows are the flight's: not those of the way to its start.
    at_start: bool,
}

impl FlightLog {
    /// A log of a vehicle that is stamped by `clock`.
    pub fn new(recorder: FlightRecorder, clock: MonotonicClock) -> Self {
        Self {
            recorder,
            clock,
            newest: None,
            poses_s: [f64::NEG_INFINITY; 2],
            arm_s: f64::NEG_INFINITY,
            at_start: false,
        }
    }

    /// Puts down what is new on the wires.
    pub fn hear(&mut self, heard: &Heard) {
        let upright = |position| Pose {
            position,
            attitude: [1.0, 0.0, 0.0, 0.0],
        };
        let quadrotor = heard.poses.quadrotor.map(|seen| (seen.captured_s, seen.value));
        let tip = heard.poses.end_effector;
        let tip = tip.map(|seen| (seen.captured_s, upright(seen.value)));
        let bodies = [(Body::Quadrotor, quadrotor), (Body::EndEffector, tip)];
        for ((body, seen), newest_s) in bodies.into_iter().zip(&mut self.poses_s) {
            if let Some((captured_s, pose)) = seen
                && captured_s > *newest_s
            {
                *newest_s = captured_s;
                self.recorder.pose(self.clock.unix_ns(captured_s), body, pose);
            }
        }
        if let Some(telemetry) = heard.arm
            && telemetry.heard_s > self.arm_s + NEW_S
        {
            self.arm_s = telemetry.heard_s;
            self.recorder
                .arm(self.clock.unix_ns(telemetry.heard_s), telemetry);
        }
        self.newest = Some(*heard);
    }

    /// Puts down one tick of the flight loop.
    pub fn row(&mut self, flown: &FlownRow) {
        let Some(heard) = self.newest else {
            return;
        };
        let time_ns = self.clock.unix_ns(heard.now_s);
        for event in flown.events {
            self.at_start |= event.kind == EventKind::AtStart;
            let level = match event.kind {
                EventKind::Aborted(_) | EventKind::Stopped => LogLevel::Error,
                EventKind::Climbing | EventKind::AtStart | EventKind::Fresh => LogLevel::Info,
                _ => LogLevel::Warning,
            };
            self.recorder.log(time_ns, level, event.kind.to_string());
        }
        let age_s = |heard_s: f64| Some(heard.now_s - heard_s).filter(|age_s| age_s.is_finite());
        self.recorder.supervisor(
            time_ns,
            SupervisorRow {
                setpoint: flown.sample.command,
                state: flown.state.to_string(),
                reason: flown.reason.map(|reason| reason.to_string()),
                autopilot_mode: heard.mode.map_or_else(String::new, |mode| format!("{mode:?}")),
                armed: heard.armed,
                quadrotor_age_s: heard.poses.quadrotor.and_then(|seen| age_s(seen.captured_s)),
                end_effector_age_s: heard.poses.end_effector.and_then(|seen| age_s(seen.captured_s)),
                autopilot_age_s: age_s(heard.autopilot_heard_s),
                arm_age_s: heard.arm.and_then(|arm| age_s(arm.heard_s)),
            },
        );
        // The rows of the flight are those with set-points that are followed, from its start on.
        if self.at_start && matches!(flown.state, State::Flying | State::Coasting | State::Holding) {
            self.recorder.row(time_ns, flown.sample, flown.step);
        }
    }

    /// Puts down what somebody has to say.
    pub fn note(&mut self, text: &str) {
        let time_ns = self.clock.unix_ns(self.newest.map_or(0.0, |heard| heard.now_s));
        self.recorder.log(time_ns, LogLevel::Info, text);
    }

    /// Writes what waits, and the file's end.
    ///
    /// # Errors
    /// Something could not be written.
    pub fn finish(&mut self) -> Result<(), RecordingError> {
        self.recorder.finish()
    }
}
