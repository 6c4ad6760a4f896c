//! The file of a recording, and the thread that writes it.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use flyvine::flight::messages::{ENCODING, PoseInFrame, TOPICS, Topic, row_messages};
use flyvine::flight::{ControlStep, Pose, Sample, quaternion};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use prost::Message as _;

use super::messages::{Arm, Log, PosesInFrame, Supervisor, recording_schemas, timestamp};
use super::{Entry, LogLevel, PlannedPaths};

/// Time between two chunks.
const CHUNK_PERIOD: Duration = Duration::from_millis(250);

const POSE: &str = "foxglove.PoseInFrame";
const POSES: &str = "foxglove.PosesInFrame";
const SETPOINT: Topic = Topic {
    name: "/setpoint",
    schema_name: POSE,
};
const SUPERVISOR: Topic = Topic {
    name: "/supervisor",
    schema_name: "flyvine.Supervisor",
};
const ARM: Topic = Topic {
    name: "/arm",
    schema_name: "flyvine.Arm",
};
const LOG: Topic = Topic {
    name: "/log",
    schema_name: "foxglove.Log",
};
const PLANNED: [Topic; 3] = [
    Topic {
        name: "/plan/command",
        schema_name: POSES,
    },
    Topic {
        name: "/plan/end_effector",
        schema_name: POSES,
    },
    Topic {
        name: "/plan/reference",
        schema_name: POSES,
    },
];
/// What motion capture says, in the order of [`super::Body`].
const MOCAP: [Topic; 2] = [
    Topic {
        name: "/mocap/quadrotor",
        schema_name: POSE,
    },
    Topic {
        name: "/mocap/end_effector",
        schema_name: POSE,
    },
];

/// An MCAP file that grows row by row.
pub(super) struct RecordingFile {
    writer: Writer<File>,
    schemas: Vec<u8>,
    /// Channels so far, by topic, and how many messages each has.
    channels: BTreeMap<&'static str, (u16, u32)>,
    /// Rows so far.
    rows: u32,
    /// Time of the newest, s.
    newest_s: f64,
}

impl RecordingFile {
    pub fn create(path: &Path, time_ns: u64, planned: &PlannedPaths) -> Result<Self, McapError> {
        // A chunk goes to the file whole: without seeking, it is put together in memory.
        let options = WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .profile("")
            .library(concat!("flyvine ", env!("CARGO_PKG_VERSION")));
        let mut file = RecordingFile {
            writer: Writer::with_options(File::create(path)?, options)?,
            schemas: recording_schemas(),
            channels: BTreeMap::new(),
            rows: 0,
            newest_s: f64::NEG_INFINITY,
        };
        let paths = [&planned.command, &planned.end_effector, &planned.reference];
        for (topic, path) in PLANNED.into_iter().zip(paths) {
            if !path.is_empty() {
                file.write(topic, time_ns, &PosesInFrame::path(time_ns, path).encode_to_vec())?;
            }
        }
        file.writer.flush()?;
        Ok(file)
    }

    /// The channel of a topic, and the number of its next message.
    fn channel(&mut self, topic: Topic) -> Result<&mut (u16, u32), McapError> {
        if !self.channels.contains_key(topic.name) {
            let schema = self
                .writer
                .add_schema(topic.schema_name, ENCODING, &self.schemas)?;
            let channel = self
                .writer
                .add_channel(schema, topic.name, ENCODING, &BTreeMap::new())?;
            self.channels.insert(topic.name, (channel, 0));
        }
        Ok(self.channels.get_mut(topic.name).expect("it is there now"))
    }

    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]) -> Result<(), McapError> {
        let (channel_id, next) = self.channel(topic)?;
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *next,
            log_time: time_ns,
            publish_time: time_ns,
        };
        *next += 1;
        self.writer.write_to_known_channel(&header, message)
    }

    fn write_row(
        &mut self,
        time_ns: u64,
        sample: &Sample,
        step: Option<ControlStep>,
    ) -> Result<(), McapError> {
        // One message that cannot be read would spoil the file; so would a row that is no later than the last, as of ticks that
        // catch up.
        if !is_row(sample) || sample.t_s <= self.newest_s {
            return self.write_log(time_ns, LogLevel::Error, &format!("left out a row: {sample:?}"));
        }
        let readable = Sample {
            quadrotor: sample.quadrotor.filter(is_pose),
            end_effector: sample.end_effector.filter(is_position),
            ..*sample
        };
        if readable != *sample {
            let message = format!("left out poses that are none: {sample:?}");
            self.write_log(time_ns, LogLevel::Warning, &message)?;
        }
        let row = self.rows;
        self.rows += 1;
        self.newest_s = sample.t_s;
        for message in row_messages(&readable, step.as_ref(), time_ns) {
            let channel = self.channel(TOPICS[message.topic])?;
            // The reader of flights puts messages of one number together.
            channel.1 = row;
            self.write(TOPICS[message.topic], time_ns, &message.bytes)?;
        }
        Ok(())
    }

    fn write_log(&mut self, time_ns: u64, level: LogLevel, message: &str) -> Result<(), McapError> {
        let log = Log {
            timestamp: Some(timestamp(time_ns)),
            level: level as i32,
            message: message.to_owned(),
            name: "flyvine".to_owned(),
        };
        self.write(LOG, time_ns, &log.encode_to_vec())
    }

    fn put(&mut self, time_ns: u64, entry: &Entry) -> Result<(), McapError> {
        let pose = |position, attitude| PoseInFrame::new(time_ns, position, attitude).encode_to_vec();
        match entry {
            Entry::Row(row) => self.write_row(time_ns, &row.0, row.1),
            Entry::Supervisor(row) => {
                let setpoint = pose(row.setpoint, [1.0, 0.0, 0.0, 0.0]);
                self.write(SETPOINT, time_ns, &setpoint)?;
                self.write(SUPERVISOR, time_ns, &Supervisor::from(&**row).encode_to_vec())
            }
            Entry::Pose(body, Pose { position, attitude }) => {
                self.write(MOCAP[*body as usize], time_ns, &pose(*position, *attitude))
            }
            Entry::Arm(telemetry) => self.write(ARM, time_ns, &Arm::from(telemetry).encode_to_vec()),
            Entry::Log { level, message } => self.write_log(time_ns, *level, message),
            Entry::End => Ok(()),
        }
    }
}

/// Whether the format's reader takes this as a position, m.
fn is_position(position: &[f64; 3]) -> bool {
    position.iter().all(|x| x.abs() <= 100.0)
}

fn is_pose(pose: &Pose) -> bool {
    is_position(&pose.position) && quaternion::unit(pose.attitude).is_ok()
}

fn is_row(sample: &Sample) -> bool {
    let configuration = sample.configuration;
    let velocity = sample.command_velocity.unwrap_or_default();
    sample.t_s.is_finite()
        && configuration.length_m > 0.0
        && configuration.length_m <= 10.0
        && configuration.pressure_kpa.abs() <= 100.0
        && is_position(&sample.command)
        && is_position(&velocity)
}

/// Writes entries until the last one, and then the file's end. `waiting` is how many are left.
pub(super) fn write_queue(
    mut file: RecordingFile,
    queue: &Receiver<(u64, Entry)>,
    waiting: &AtomicUsize,
) -> Result<(), McapError> {
    let mut flushed = Instant::now();
    let mut pending = false;
    loop {
        let wait = CHUNK_PERIOD.saturating_sub(flushed.elapsed());
        match queue.recv_timeout(wait) {
            Ok((_, Entry::End)) | Err(RecvTimeoutError::Disconnected) => break,
            Ok((time_ns, entry)) => {
                file.put(time_ns, &entry)?;
                waiting.fetch_sub(1, Ordering::Relaxed);
                pending = true;
            }
            Err(RecvTimeoutError::Timeout) => (),
        }
        if flushed.elapsed() >= CHUNK_PERIOD {
            if std::mem::take(&mut pending) {
                file.writer.flush()?;
            }
            flushed = Instant::now();
        }
    }
    file.writer.finish()?;
    Ok(())
}
