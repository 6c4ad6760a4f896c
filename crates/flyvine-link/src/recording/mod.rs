//! The recording of a flight while it is flown: an MCAP file that is readable whatever happens to the process.
//!
//! The file is a flight as [`flyvine::flight::read_flight`] reads it, with further topics for people and viewers
//! (Foxglove, Rerun, PlotJuggler):
//!
//! | topic | schema | when |
//! | --- | --- | --- |
//! | `/configuration`, `/command`, `/quadrotor`, `/end_effector` | as in every flight | every row |
//! | `/plan/command`, `/plan/end_effector`, `/plan/reference` | `foxglove.PosesInFrame` | at the start |
//! | `/supervisor` | `flyvine.Supervisor` | every row |
//! | `/log` | `foxglove.Log` | as events come |
//!
//! A thread writes; the flight never waits for the disk. Four times a second it closes a chunk and hands it to
//! the operating system, so that `kill -9` costs at most the last quarter of a second
//! ([`flyvine::flight::recover_flight`] reads what is left). Messages carry the row as their sequence number.

mod file;
mod schema;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use flyvine::flight::Sample;

use self::file::{RecordingFile, write_queue};

/// Entries that may wait for the disk: more than ten seconds of flight.
const QUEUE: usize = 1024;

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
    /// The disk was slower than the flight: entries were lost.
    #[error("recording {path}: the disk was too slow, {lost} entries were lost")]
    TooSlow {
        /// The file.
        path: String,
        /// How many.
        lost: u64,
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

/// The supervisor's view of one row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SupervisorRow {
    /// The name of its state.
    pub state: String,
    /// The mode that the autopilot shall be in.
    pub mode: String,
    /// Why it ended the flight, if it did.
    pub reason: Option<String>,
    /// Age of the quadrotor's newest credible pose, s.
    pub quadrotor_age_s: Option<f64>,
    /// Age of the end effector's, s.
    pub end_effector_age_s: Option<f64>,
}

/// How much an entry of the log matters; the numbers are Foxglove's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum LogLevel {
    Info = 2,
    Warning = 3,
    Error = 4,
}

/// What is put down.
enum Entry {
    Row(Box<(Sample, SupervisorRow)>),
    Log {
        t_s: f64,
        level: LogLevel,
        message: String,
    },
}

/// Records a flight. Dropping it finishes the file too, but then nobody learns how that went.
#[derive(Debug)]
pub struct FlightRecorder {
    path: String,
    entries: Option<SyncSender<Entry>>,
    writer: Option<JoinHandle<Result<(), mcap::McapError>>>,
    failed: Arc<AtomicBool>,
    lost: u64,
}

impl FlightRecorder {
    /// Creates the file at `path`, replacing one that is there, and writes down what is planned.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, planned: &PlannedPaths) -> Result<Self, RecordingError> {
        let shown = path.display().to_string();
        let file = RecordingFile::create(path, planned).map_err(|source| RecordingError::Write {
            path: shown.clone(),
            source,
        })?;
        let (entries, queue) = sync_channel(QUEUE);
        let failed = Arc::new(AtomicBool::new(false));
        let flag = failed.clone();
        let writer = thread::Builder::new()
            .name("flight recorder".into())
            .spawn(move || {
                let result = write_queue(file, &queue);
                flag.store(result.is_err(), Ordering::Relaxed);
                result
            })
            .map_err(|source| RecordingError::Thread {
                path: shown.clone(),
                source,
            })?;
        Ok(FlightRecorder {
            path: shown,
            entries: Some(entries),
            writer: Some(writer),
            failed,
            lost: 0,
        })
    }

    /// Puts down the next row of the flight: what was seen and sent at its time, and what the supervisor made of it.
    /// It never waits. Poses that are no poses (NaN, kilometres away, no unit quaternion) are left out and the log
    /// says so; so are whole rows of which time, configuration or command are not finite.
    pub fn row(&mut self, sample: &Sample, supervisor: SupervisorRow) {
        self.put(Entry::Row(Box::new((*sample, supervisor))));
    }

    /// Puts down an event at `t_s`, flight time. It never waits.
    pub fn log(&mut self, t_s: f64, level: LogLevel, message: impl Into<String>) {
        self.put(Entry::Log {
            t_s,
            level,
            message: message.into(),
        });
    }

    /// Whether recording has failed: the disk is full, gone, or too slow. The flight may want to end then.
    pub fn has_failed(&self) -> bool {
        self.lost > 0 || self.failed.load(Ordering::Relaxed)
    }

    /// Writes what waits, and the file's index and end.
    ///
    /// # Errors
    /// Something could not be written, now or before.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        match self.join() {
            Err(source) => Err(RecordingError::Write {
                path: self.path.clone(),
                source,
            }),
            Ok(()) if self.lost > 0 => Err(RecordingError::TooSlow {
                path: self.path.clone(),
                lost: self.lost,
            }),
            Ok(()) => Ok(()),
        }
    }

    fn put(&mut self, entry: Entry) {
        let taken = self
            .entries
            .as_ref()
            .is_some_and(|entries| entries.try_send(entry).is_ok());
        self.lost += u64::from(!taken);
    }

    /// Lets the thread come to its end.
    fn join(&mut self) -> Result<(), mcap::McapError> {
        self.entries = None;
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // It has been joined, or has panicked and said so.
            Some(Err(_)) | None => Ok(()),
        }
    }
}

impl Drop for FlightRecorder {
    fn drop(&mut self) {
        // Whoever wants to know how it ended calls `finish`.
        let _ = self.join();
    }
}
