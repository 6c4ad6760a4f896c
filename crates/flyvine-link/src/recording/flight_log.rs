//! What is put down of a flight on the link, from its two sides: what the wires say, and what the flight loop makes of it.

use std::collections::VecDeque;

use flyvine::control::FlownRow;
use flyvine::control::supervisor::{EventKind, State};
use flyvine::flight::{ControlStep, Pose, Sample, quaternion};

use super::{Body, FlightRecorder, LogLevel, RecordingError, SupervisorRow};
use crate::autopilot::{Heard, MonotonicClock};

/// The arm's silence is measured to rounding, s; it speaks every 50 ms.
const NEW_S: f64 = 1e-6;
/// A row waits so long for the first poses behind it, s.
const WAIT_S: f64 = 0.1;
/// Poses farther apart than this are not interpolated, s; as in recordings of others.
const MAX_GAP_S: f64 = 0.1;

/// Puts a flight down as it goes on.
///
/// The flight loop acts on poses that are up to a frame and a network old; a row shall hold those of its own time. So it waits
/// for the next frame, and has the poses between the two.
#[derive(Debug)]
pub struct FlightLog {
    recorder: FlightRecorder,
    clock: MonotonicClock,
    newest: Option<Heard>,
    /// The newest poses of both bodies, put down already.
    tracks: [Track; 2],
    /// Rows that wait for poses behind them.
    rows: VecDeque<WaitingRow>,
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
            tracks: [Track::default(), Track::default()],
            rows: VecDeque::new(),
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
        for ((body, seen), track) in bodies.into_iter().zip(&mut self.tracks) {
            if let Some((captured_s, pose)) = seen
                && captured_s > track.newest_s()
            {
                track.push(captured_s, pose);
                self.recorder.pose(self.clock.unix_ns(captured_s), body, pose);
            }
        }
        self.put_rows(heard.now_s - WAIT_S);
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
            self.rows.push_back(WaitingRow {
                tick_s: heard.now_s,
                sample: *flown.sample,
                step: flown.step.copied(),
            });
        }
    }

    /// Puts down the rows that both bodies have been seen behind, and those up to `late_s`, in order.
    fn put_rows(&mut self, late_s: f64) {
        let seen_s = self
            .tracks
            .iter()
            .map(Track::newest_s)
            .fold(f64::INFINITY, f64::min);
        while let Some(row) = self.rows.pop_front_if(|row| row.tick_s <= seen_s.max(late_s)) {
            let [quadrotor, tip] = self.tracks.each_ref().map(|track| track.at(row.tick_s));
            let sample = Sample {
                quadrotor: quadrotor.or(row.sample.quadrotor),
                end_effector: tip.map(|tip| tip.position).or(row.sample.end_effector),
                ..row.sample
            };
            let time_ns = self.clock.unix_ns(row.tick_s);
            self.recorder.row(time_ns, &sample, row.step.as_ref());
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
        self.put_rows(f64::INFINITY);
        self.recorder.finish()
    }
}

/// A row of the flight, and when its command went out, s.
#[derive(Debug)]
struct WaitingRow {
    tick_s: f64,
    sample: Sample,
    step: Option<ControlStep>,
}

/// The last poses of one body and when they were captured, s.
#[derive(Debug, Default)]
struct Track(VecDeque<(f64, Pose)>);

impl Track {
    fn newest_s(&self) -> f64 {
        self.0.back().map_or(f64::NEG_INFINITY, |newest| newest.0)
    }

    fn push(&mut self, captured_s: f64, pose: Pose) {
        self.0.push_back((captured_s, pose));
        while self.0[0].0 < captured_s - WAIT_S - MAX_GAP_S {
            self.0.pop_front();
        }
    }

    /// The pose at `time_s`, between two that are near enough; `None` where there are none, or where one is NaN.
    fn at(&self, time_s: f64) -> Option<Pose> {
        let behind = self.0.partition_point(|(captured_s, _)| *captured_s < time_s);
        let (after_s, after) = *self.0.get(behind)?;
        let (before_s, before) = *self.0.get(behind.checked_sub(1)?)?;
        let gap_s = after_s - before_s;
        let share = (time_s - before_s) / gap_s;
        let pose = Pose {
            position: std::array::from_fn(|i| {
                before.position[i] + share * (after.position[i] - before.position[i])
            }),
            attitude: quaternion::slerp(before.attitude, after.attitude, share),
        };
        let is_finite = pose
            .position
            .iter()
            .chain(&pose.attitude)
            .all(|number| number.is_finite());
        (gap_s <= MAX_GAP_S && is_finite).then_some(pose)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use flyvine::flight::{Configuration, read_flight};

    use super::*;
    use crate::autopilot::{LatestPoses, Stamped};
    use crate::recording::PlannedPaths;

    /// A vehicle that moves at 1 m/s along x, seen at 100 Hz, 3 ms before each look at the wires, except from 0.5 s to 0.8 s;
    /// ticks fall 7 ms behind a frame.
    fn recorded(path: &Path) -> Vec<Sample> {
        let recorder = FlightRecorder::create(path, 0, &PlannedPaths::default(), Arc::default()).unwrap();
        let mut log = FlightLog::new(recorder, MonotonicClock::start());
        log.at_start = true;
        let pose = |captured_s: f64| Pose {
            position: [captured_s, 0.0, 1.5],
            attitude: [1.0, 0.0, 0.0, 0.0],
        };
        let mut seen_s = 0.0;
        for k in 0..1200 {
            let now_s = 0.001 * f64::from(k);
            let is_frame = k % 10 == 3 && !(500..800).contains(&k);
            if is_frame {
                seen_s = now_s - 0.003;
            }
            let heard = Heard {
                now_s,
                poses: LatestPoses {
                    quadrotor: Some(Stamped {
                        value: pose(seen_s),
                        captured_s: seen_s,
                    }),
                    end_effector: Some(Stamped {
                        value: [seen_s, 0.0, 0.8],
                        captured_s: seen_s,
                    }),
                },
                arm: None,
                mode: None,
                armed: true,
                autopilot_heard_s: now_s,
            };
            log.hear(&heard);
            if k % 50 == 7 {
                let sample = Sample {
                    t_s: now_s - 0.007,
                    configuration: Configuration {
                        length_m: 0.7,
                        pressure_kpa: 0.0,
                    },
                    command: [0.0, 0.0, 1.5],
                    command_velocity: None,
                    quadrotor: Some(pose(seen_s)),
                    end_effector: Some([seen_s, 0.0, 0.8]),
                };
                log.row(&FlownRow {
                    row: k as usize / 50,
                    knots: 24,
                    sample: &sample,
                    state: State::Flying,
                    reason: None,
                    events: &[],
                    step: None,
                });
            }
        }
        log.finish().unwrap();
        read_flight(path).unwrap().samples
    }

    #[test]
    fn a_row_holds_the_poses_of_its_own_time() {
        let folder = tempfile::tempdir().unwrap();
        let samples = recorded(&folder.path().join("flight.mcap"));
        assert_eq!(samples.len(), 24);
        for (k, sample) in samples.iter().enumerate() {
            let tick_s = 0.05 * k as f64 + 0.007;
            let (x, tip_x) = (
                sample.quadrotor.unwrap().position[0],
                sample.end_effector.unwrap()[0],
            );
            assert_eq!(x, tip_x);
            match (0.49..0.8).contains(&tick_s) {
                false => assert!((x - tick_s).abs() < 1e-9, "row {k}: {x}"),
                // Nobody knows better than the flight did.
                true => assert!((x - 0.49).abs() < 1e-9, "row {k}: {x}"),
            }
        }
    }
}
