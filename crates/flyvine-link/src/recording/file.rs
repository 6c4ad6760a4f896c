//! The file of a recording, and the thread that writes it.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use flyvine::flight::{Pose, Sample, quaternion};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use serde::Serialize;

use super::schema::{self, Configuration, Log, PoseInFrame, PosesInFrame, Schema, Supervisor, Vector3};
use super::{Entry, LogLevel, PlannedPaths, SupervisorRow};

/// Time between two chunks.
const CHUNK_PERIOD: Duration = Duration::from_millis(250);
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// The topics, by their channels.
struct Channels {
    configuration: u16,
    command: u16,
    command_velocity: u16,
    quadrotor: u16,
    end_effector: u16,
    supervisor: u16,
    log: u16,
}

/// An MCAP file that grows row by row.
pub(super) struct RecordingFile {
    writer: Writer<File>,
    channels: Channels,
    /// Rows so far.
    rows: u32,
}

impl RecordingFile {
    pub fn create(path: &Path, planned: &PlannedPaths) -> Result<Self, McapError> {
        // A chunk goes to the file whole: without seeking, it is put together in memory.
        let options = WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .profile("")
            .library(concat!("flyvine ", env!("CARGO_PKG_VERSION")));
        let mut writer = Writer::with_options(File::create(path)?, options)?;
        let channels = Channels {
            configuration: channel(&mut writer, "/configuration", schema::CONFIGURATION)?,
            command: channel(&mut writer, "/command", schema::POSE)?,
            command_velocity: channel(&mut writer, "/command_velocity", schema::VECTOR)?,
            quadrotor: channel(&mut writer, "/quadrotor", schema::POSE)?,
            end_effector: channel(&mut writer, "/end_effector", schema::POSE)?,
            supervisor: channel(&mut writer, "/supervisor", schema::SUPERVISOR)?,
            log: channel(&mut writer, "/log", schema::LOG)?,
        };
        let paths = [
            ("/plan/command", &planned.command),
            ("/plan/end_effector", &planned.end_effector),
            ("/plan/reference", &planned.reference),
        ];
        let mut file = RecordingFile {
            writer,
            channels,
            rows: 0,
        };
        for (topic, path) in paths {
            if !path.is_empty() {
                let channel = channel(&mut file.writer, topic, schema::POSES)?;
                file.write(channel, 0, 0, &PosesInFrame::path(0, path))?;
            }
        }
        file.writer.flush()?;
        Ok(file)
    }

    fn write(
        &mut self,
        channel_id: u16,
        sequence: u32,
        time_ns: u64,
        message: &impl Serialize,
    ) -> Result<(), McapError> {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        let json = serde_json::to_vec(message).map_err(std::io::Error::from)?;
        self.writer.write_to_known_channel(&header, &json)
    }

    fn write_row(&mut self, sample: &Sample, supervisor: &SupervisorRow) -> Result<(), McapError> {
        let time_ns = nanoseconds(sample.t_s);
        // One message that cannot be read would spoil the file.
        if !is_row(sample) {
            return self.write_log(time_ns, LogLevel::Error, &format!("left out a row: {sample:?}"));
        }
        let row = self.rows;
        self.rows += 1;
        let configuration = Configuration {
            t_s: sample.t_s,
            length_m: sample.configuration.length_m,
            pressure_kpa: sample.configuration.pressure_kpa,
        };
        self.write(self.channels.configuration, row, time_ns, &configuration)?;
        let command = PoseInFrame::new(time_ns, sample.command, UPRIGHT);
        self.write(self.channels.command, row, time_ns, &command)?;
        if let Some(velocity) = sample.command_velocity {
            let velocity = Vector3::from(velocity);
            self.write(self.channels.command_velocity, row, time_ns, &velocity)?;
        }
        let (quadrotor, end_effector) = (
            sample.quadrotor.filter(is_pose),
            sample.end_effector.filter(is_position),
        );
        if (quadrotor, end_effector) != (sample.quadrotor, sample.end_effector) {
            let message = format!("left out poses that are none: {sample:?}");
            self.write_log(time_ns, LogLevel::Warning, &message)?;
        }
        if let Some(pose) = quadrotor {
            let pose = PoseInFrame::new(time_ns, pose.position, pose.attitude);
            self.write(self.channels.quadrotor, row, time_ns, &pose)?;
        }
        if let Some(position) = end_effector {
            let pose = PoseInFrame::new(time_ns, position, UPRIGHT);
            self.write(self.channels.end_effector, row, time_ns, &pose)?;
        }
        let supervisor = Supervisor::from(supervisor);
        self.write(self.channels.supervisor, row, time_ns, &supervisor)
    }

    /// An event belongs to the newest row.
    fn write_log(&mut self, time_ns: u64, level: LogLevel, message: &str) -> Result<(), McapError> {
        let row = self.rows.saturating_sub(1);
        let log = Log::new(time_ns, level, message);
        self.write(self.channels.log, row, time_ns, &log)
    }

    fn put(&mut self, entry: &Entry) -> Result<(), McapError> {
        match entry {
            Entry::Row(row) => self.write_row(&row.0, &row.1),
            Entry::Log { t_s, level, message } => self.write_log(nanoseconds(*t_s), *level, message),
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

/// A topic with JSON messages of a schema.
fn channel(writer: &mut Writer<File>, topic: &str, (name, text): Schema) -> Result<u16, McapError> {
    let schema = writer.add_schema(name, "jsonschema", text.as_bytes())?;
    writer.add_channel(schema, topic, "json", &BTreeMap::new())
}

/// The format's clock is unsigned; a row's exact time is in its message.
fn nanoseconds(t_s: f64) -> u64 {
    (t_s * 1e9).round().max(0.0) as u64
}

/// Writes entries until their senders are gone, and then the file's end.
pub(super) fn write_queue(mut file: RecordingFile, queue: &Receiver<Entry>) -> Result<(), McapError> {
    let mut flushed = Instant::now();
    let mut pending = false;
    loop {
        let wait = CHUNK_PERIOD.saturating_sub(flushed.elapsed());
        match queue.recv_timeout(wait) {
            Ok(entry) => {
                file.put(&entry)?;
                pending = true;
            }
            Err(RecvTimeoutError::Timeout) => (),
            Err(RecvTimeoutError::Disconnected) => break,
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
