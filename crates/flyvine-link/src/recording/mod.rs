//! The recording of a flight while it is flown: an MCAP file that is readable whatever happens to the process.
//!
//! The file is a flight as [`flyvine::flight::read_flight`] reads it, with further topics for people and viewers
//! (Foxglove, Rerun, PlotJuggler):
//!
//! | topic | schema | when |
//! | --- | --- | --- |
//! | those of [`flyvine::flight::messages`] | as in every flight | every row of the flight itself |
//! | `/plan/command`, `/plan/end_effector`, `/plan/reference` | `foxglove.PosesInFrame` | at the start |
//! | `/setpoint` | `foxglove.PoseInFrame` | every tick, from before arming until after landing |
//! | `/supervisor` | `flyvine.Supervisor`: state, reason, the autopilot's mode, ages of everything heard | every tick |
//! | `/mocap/quadrotor`, `/mocap/end_effector` | `foxglove.PoseInFrame` | every pose that the flight was given |
//! | `/arm` | `flyvine.Arm`: its own telemetry | as it comes |
//! | `/log` | `foxglove.Log` | as events come |
//!
//! A row of the flight has the poses of its own time, between the frames around it; what the flight was given is in `/mocap`, and
//! how old it was then in `/supervisor`. Times are those of the machine's clock; a row's time in its flight is in
//! `/configuration`. A thread writes; the flight
//! never waits for the disk. Four times a second it closes a chunk and hands it to the operating system, so that `kill -9`
//! costs at most the last quarter of a second ([`flyvine::flight::recover_flight`] reads what is left).

mod file;
mod flight_log;
mod messages;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::{self, JoinHandle};

use flyvine::flight::{ControlStep, Pose, Sample};
use flyvine::task::Plan;

use self::file::{RecordingFile, write_queue};
use crate::autopilot::ArmTelemetry;

pub use flight_log::FlightLog;

/// Entries that may wait for the disk before it counts as failed: some ten seconds of flight.
const WAITING_MAX: usize = 4096;

/// Why a flight is not being recorded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be created or written.
    #[error("recording {path}: {source}")]
    Write {
        /// The file, as it was named by the caller.
        path: String,
        /// What went wrong.
        #[source]
        source: mcap::McapError,
    },
    /// The writing thread cannot be started.
    #[error("recording {path}: cannot start a thread: {source}")]
    Thread {
        /// The file.
        path: String,
        /// The system's error.
        #[source]
        source: std::io::Error,
    },
}

/// What was planned, as paths through the world, m, one position per knot. Empty where there is none.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlannedPaths {
    /// Commanded quadrotor positions.
    pub command: Vec<[f64; 3]>,
    /// Predicted end-effector positions.
    pub end_effector: Vec<[f64; 3]>,
    /// End-effector reference.
    pub reference: Vec<[f64; 3]>,
}

impl From<&Plan> for PlannedPaths {
    fn from(plan: &Plan) -> Self {
        Self {
            command: plan.commands.clone(),
            end_effector: plan
                .states
                .iter()
                .map(|state| [state[6], state[7], state[8]])
                .collect(),
            reference: plan.reference.clone(),
        }
    }
}

/// The supervisor's view of one tick.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SupervisorRow {
    /// What was sent, m.
    pub setpoint: [f64; 3],
    /// The name of its state.
    pub state: String,
    /// Why it ended the flight, if it did.
    pub reason: Option<String>,
    /// The mode that the autopilot says it is in.
    pub autopilot_mode: String,
    /// Whether its motors are armed.
    pub armed: bool,
    /// Age of the quadrotor's newest pose, s.
    pub quadrotor_age_s: Option<f64>,
    /// Age of the end effector's, s.
    pub end_effector_age_s: Option<f64>,
    /// Time since the autopilot was heard, s.
    pub autopilot_age_s: Option<f64>,
    /// Time since the arm was heard, s.
    pub arm_age_s: Option<f64>,
}

/// How much an entry of the log matters; the numbers are Foxglove's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum LogLevel {
    Info = 2,
    Warning = 3,
    Error = 4,
}

/// A body of motion capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Body {
    Quadrotor = 0,
    EndEffector = 1,
}

/// What is put down.
enum Entry {
    Row(Box<(Sample, Option<ControlStep>)>),
    Supervisor(Box<SupervisorRow>),
    Pose(Body, Pose),
    Arm(ArmTelemetry),
    Log { level: LogLevel, message: String },
    End,
}

/// Records a flight. Dropping it finishes the file too, but then nobody learns how that went.
///
/// Nothing that is put down waits for the disk, and nothing is lost to a slow one. Times are nanoseconds since 1970.
#[derive(Debug)]
pub struct FlightRecorder {
    path: String,
    entries: Sender<(u64, Entry)>,
    writer: Option<JoinHandle<Result<(), mcap::McapError>>>,
    failed: Arc<AtomicBool>,
    /// Entries that wait for the disk.
    waiting: Arc<AtomicUsize>,
}

impl FlightRecorder {
    /// Creates the file at `path`, replacing one that is there, and writes down what is planned. `failed` is raised when
    /// the disk is full, gone, or too slow: the flight may want to end then.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(
        path: &Path,
        time_ns: u64,
        planned: &PlannedPaths,
        failed: Arc<AtomicBool>,
    ) -> Result<Self, RecordingError> {
        let shown = path.display().to_string();
        let file = RecordingFile::create(path, time_ns, planned).map_err(|source| RecordingError::Write {
            path: shown.clone(),
            source,
        })?;
        let (entries, queue) = channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let (flag, left) = (failed.clone(), waiting.clone());
        let writer = thread::Builder::new()
            .name("flight recorder".into())
            .spawn(move || {
                let result = write_queue(file, &queue, &left);
                if result.is_err() {
                    flag.store(true, Ordering::Relaxed);
                }
                result
            })
            .map_err(|source| RecordingError::Thread {
                path: shown.clone(),
                source,
            })?;
        Ok(FlightRecorder {
            path: shown,
            entries,
            writer: Some(writer),
            failed,
            waiting,
        })
    }

    /// Puts down the next row of the flight: what was seen and sent, and what the controller reported. Poses that are no
    /// poses (NaN, kilometres away, no unit quaternion) are left out and the log says so; so are whole rows of which time,
    /// configuration or command are not finite, or that are no later than the last.
    pub fn row(&self, time_ns: u64, sample: &Sample, step: Option<&ControlStep>) {
        self.put(time_ns, Entry::Row(Box::new((*sample, step.copied()))));
    }

    /// Puts down one tick, in whatever phase.
    pub fn supervisor(&self, time_ns: u64, row: SupervisorRow) {
        self.put(time_ns, Entry::Supervisor(Box::new(row)));
    }

    /// Puts down a pose of motion capture as the flight was given it, captured at `time_ns`.
    pub fn pose(&self, time_ns: u64, body: Body, pose: Pose) {
        self.put(time_ns, Entry::Pose(body, pose));
    }

    /// Puts down what the arm said.
    pub fn arm(&self, time_ns: u64, telemetry: ArmTelemetry) {
        self.put(time_ns, Entry::Arm(telemetry));
    }

    /// Puts down an event.
    pub fn log(&self, time_ns: u64, level: LogLevel, message: impl Into<String>) {
        let message = message.into();
        self.put(time_ns, Entry::Log { level, message });
    }

    /// Writes what waits, and the file's index and end; what is put down later is lost.
    ///
    /// # Errors
    /// Something could not be written, now or before.
    pub fn finish(&mut self) -> Result<(), RecordingError> {
        self.join().map_err(|source| RecordingError::Write {
            path: self.path.clone(),
            source,
        })
    }

    fn put(&self, time_ns: u64, entry: Entry) {
        let waiting = self.waiting.fetch_add(1, Ordering::Relaxed);
        if self.entries.send((time_ns, entry)).is_err() || waiting >= WAITING_MAX {
            self.failed.store(true, Ordering::Relaxed);
        }
    }

    /// Lets the thread come to its end.
    fn join(&mut self) -> Result<(), mcap::McapError> {
        // A thread that has failed takes nothing any more.
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        let _ = self.entries.send((0, Entry::End));
        let panicked = |_| Err(std::io::Error::other("its thread panicked").into());
        writer.join().unwrap_or_else(panicked)
    }
}

impl Drop for FlightRecorder {
    fn drop(&mut self) {
        // Whoever wants to know how it ended calls `finish`.
        let _ = self.join();
    }
}
