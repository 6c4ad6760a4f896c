//! Flights as MCAP files (<https://mcap.dev>) of JSON messages that Foxglove, Rerun and PlotJuggler know.
//!
//! | topic | schema | |
//! | --- | --- | --- |
//! | `/configuration` | `flyvine.Configuration` | every row: its exact time, the arm's length and pressure |
//! | `/command` | `foxglove.PoseInFrame` | every row: the commanded position |
//! | `/command_velocity` | `foxglove.Vector3` | rows that have one |
//! | `/quadrotor` | `foxglove.PoseInFrame` | rows with a pose |
//! | `/end_effector` | `foxglove.PoseInFrame` | rows with a pose |
//! | `/controller` | `flyvine.ControlStep` | rows of which a controller reported |
//!
//! Each message's sequence number is its row. Chunks are small and not compressed, so a file that was cut off
//! loses its last seconds only.

use std::collections::BTreeMap;
use std::io::Cursor;

use ::mcap::records::MessageHeader;
use ::mcap::{McapError, MessageStream, WriteOptions, Writer, read::Options};
use serde::{Deserialize, Serialize};

use super::continuity::check_rate;
use super::control_step::{ControlStep, StepRow};
use super::error::{FlightError, Problem};
use super::{Configuration, Flight, Pose, Sample, plausible, quaternion};

const CONFIGURATION: &str = "/configuration";
const COMMAND: &str = "/command";
const COMMAND_VELOCITY: &str = "/command_velocity";
const QUADROTOR: &str = "/quadrotor";
const END_EFFECTOR: &str = "/end_effector";
const CONTROLLER: &str = "/controller";

/// Some five seconds of flight.
const CHUNK_BYTES: u64 = 64 * 1024;

const CONFIGURATION_SCHEMA: (&str, &str) = (
    "flyvine.Configuration",
    r#"{"type":"object","properties":{"t_s":{"type":"number"},"length_m":{"type":"number"},"pressure_kpa":{"type":"number"}}}"#,
);
const CONTROLLER_SCHEMA: (&str, &str) = (
    "flyvine.ControlStep",
    r#"{"type":"object","properties":{"step_ms":{"type":"number"},"step_status":{"type":"string"},"step_changes":{"type":"integer"},"step_active":{"type":"integer"},"step_residual":{"type":"number"},"step_delay_knots":{"type":"number"},"step_delay_deviation_knots":{"type":"number"}}}"#,
);
const VECTOR_SCHEMA: (&str, &str) = (
    "foxglove.Vector3",
    r#"{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}}"#,
);
const POSE_SCHEMA: (&str, &str) = (
    "foxglove.PoseInFrame",
    r#"{"type":"object","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"frame_id":{"type":"string"},
"pose":{"type":"object","title":"foxglove.Pose","properties":{
"position":{"type":"object","title":"foxglove.Vector3","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},
"orientation":{"type":"object","title":"foxglove.Quaternion","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"},"w":{"type":"number"}}}}}}}"#,
);

/// `flyvine.Configuration`
#[derive(Serialize, Deserialize)]
struct ConfigurationMessage {
    t_s: f64,
    length_m: f64,
    pressure_kpa: f64,
}

/// `foxglove.Vector3`
#[derive(Serialize, Deserialize)]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

/// `foxglove.Quaternion`
#[derive(Serialize, Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `foxglove.PoseInFrame`
#[derive(Serialize, Deserialize)]
struct PoseInFrame {
    timestamp: Timestamp,
    frame_id: String,
    pose: PoseMessage,
}

/// `foxglove.Pose`
#[derive(Serialize, Deserialize)]
struct PoseMessage {
    position: Vector3,
    orientation: Quaternion,
}

#[derive(Serialize, Deserialize)]
struct Timestamp {
    sec: i64,
    nsec: u32,
}

/// The flight as an MCAP file's bytes. `file` is what error messages call it.
pub(super) fn format_mcap(
    file: &str,
    flight: &Flight,
    steps: &[ControlStep],
) -> Result<Vec<u8>, FlightError> {
    let encoded = encode(flight, steps).map_err(|error| FlightError::in_file(file, mcap_problem(error)))?;
    // JSON has no NaN: such a number became `null`. What cannot be read again is not written.
    parse_mcap(file, &encoded)?;
    Ok(encoded)
}

fn encode(flight: &Flight, steps: &[ControlStep]) -> Result<Vec<u8>, McapError> {
    let options = WriteOptions::new()
        .compression(None)
        .chunk_size(Some(CHUNK_BYTES))
        .profile("")
        .library(concat!("flyvine ", env!("CARGO_PKG_VERSION")));
    let mut writer = Writer::with_options(Cursor::new(Vec::new()), options)?;
    let mut channel = |topic: &str, (name, schema): (&str, &str)| {
        let schema_id = writer.add_schema(name, "jsonschema", schema.as_bytes())?;
        writer.add_channel(schema_id, topic, "json", &BTreeMap::new())
    };
    let configuration = channel(CONFIGURATION, CONFIGURATION_SCHEMA)?;
    let command = channel(COMMAND, POSE_SCHEMA)?;
    let command_velocity = channel(COMMAND_VELOCITY, VECTOR_SCHEMA)?;
    let quadrotor = channel(QUADROTOR, POSE_SCHEMA)?;
    let end_effector = channel(END_EFFECTOR, POSE_SCHEMA)?;
    let controller = match steps {
        [] => None,
        _ => Some(channel(CONTROLLER, CONTROLLER_SCHEMA)?),
    };
    let mut steps_left = steps.iter().peekable();
    let mut row_writer = RowWriter {
        writer: &mut writer,
        row: 0,
        time_ns: 0,
    };
    for sample in &flight.samples {
        let Configuration {
            length_m,
            pressure_kpa,
        } = sample.configuration;
        // The format's clock is unsigned; the exact time is in the message.
        row_writer.time_ns = (sample.t_s * 1e9).round().max(0.0) as u64;
        let message = ConfigurationMessage {
            t_s: sample.t_s,
            length_m,
            pressure_kpa,
        };
        row_writer.write(configuration, &message)?;
        row_writer.write_pose(command, sample.command, UPRIGHT)?;
        if let Some([x, y, z]) = sample.command_velocity {
            row_writer.write(command_velocity, &Vector3 { x, y, z })?;
        }
        if let Some(pose) = sample.quadrotor {
            row_writer.write_pose(quadrotor, pose.position, pose.attitude)?;
        }
        if let Some(position) = sample.end_effector {
            row_writer.write_pose(end_effector, position, UPRIGHT)?;
        }
        let row = row_writer.row as usize;
        if let (Some(controller), Some(step)) = (controller, steps_left.next_if(|step| step.row == row)) {
            row_writer.write(controller, &StepRow::new(step))?;
        }
        row_writer.row += 1;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}

const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

struct RowWriter<'a> {
    writer: &'a mut Writer<Cursor<Vec<u8>>>,
    row: u32,
    time_ns: u64,
}

impl RowWriter<'_> {
    fn write(&mut self, channel_id: u16, message: &impl Serialize) -> Result<(), McapError> {
        let header = MessageHeader {
            channel_id,
            sequence: self.row,
            log_time: self.time_ns,
            publish_time: self.time_ns,
        };
        let json = serde_json::to_vec(message).map_err(std::io::Error::from)?;
        self.writer.write_to_known_channel(&header, &json)
    }

    fn write_pose(&mut self, channel_id: u16, [x, y, z]: [f64; 3], q: [f64; 4]) -> Result<(), McapError> {
        let timestamp = Timestamp {
            sec: (self.time_ns / 1_000_000_000) as i64,
            nsec: (self.time_ns % 1_000_000_000) as u32,
        };
        let [qw, qx, qy, qz] = q;
        let pose = PoseMessage {
            position: Vector3 { x, y, z },
            orientation: Quaternion {
                x: qx,
                y: qy,
                z: qz,
                w: qw,
            },
        };
        self.write(
            channel_id,
            &PoseInFrame {
                timestamp,
                frame_id: "world".into(),
                pose,
            },
        )
    }
}

/// The flight in an MCAP file's bytes. A file that was cut off is an error that says how many rows are left;
/// [`recover_mcap`] reads those.
pub(super) fn parse_mcap(file: &str, bytes: &[u8]) -> Result<Flight, FlightError> {
    let (flight, end) = decode(file, bytes)?;
    match end {
        None if flight.samples.is_empty() => Err(FlightError::in_file(file, Problem::NoRows)),
        None => check_rate(file, &flight.samples).map(|()| flight),
        Some(McapError::BadMagic | McapError::UnexpectedEof | McapError::UnexpectedEoc)
            if !flight.samples.is_empty() =>
        {
            Err(FlightError::in_file(
                file,
                Problem::CutOff {
                    rows: flight.samples.len(),
                },
            ))
        }
        Some(error) => Err(FlightError::in_file(file, mcap_problem(error))),
    }
}

/// The controller's steps in a flight's MCAP file.
pub(super) fn parse_steps(file: &str, bytes: &[u8]) -> Result<Vec<ControlStep>, FlightError> {
    let fail = |error| FlightError::in_file(file, mcap_problem(error));
    let mut steps = Vec::new();
    for message in MessageStream::new(bytes).map_err(fail)? {
        let message = message.map_err(fail)?;
        if message.channel.topic == CONTROLLER {
            let step: StepRow = serde_json::from_slice(&message.data).map_err(|error| {
                FlightError::in_file(file, Problem::NotAMessage(error.to_string()))
                    .field(&place(CONTROLLER, message.sequence))
            })?;
            steps.push(step.step(message.sequence as usize));
        }
    }
    Ok(steps)
}

/// The whole rows in front of the first damage.
pub(super) fn recover_mcap(file: &str, bytes: &[u8]) -> Result<Flight, FlightError> {
    let (flight, end) = decode(file, bytes)?;
    match end {
        Some(error) if flight.samples.is_empty() => Err(FlightError::in_file(file, mcap_problem(error))),
        None if flight.samples.is_empty() => Err(FlightError::in_file(file, Problem::NoRows)),
        _ => Ok(flight),
    }
}

/// A row of which the messages are still coming.
#[derive(Default)]
struct PartialRow {
    configuration: Option<(f64, Configuration)>,
    command: Option<[f64; 3]>,
    command_velocity: Option<[f64; 3]>,
    quadrotor: Option<Pose>,
    end_effector: Option<[f64; 3]>,
}

/// Reads up to the end or the first damage, which is returned too.
fn decode(file: &str, bytes: &[u8]) -> Result<(Flight, Option<McapError>), FlightError> {
    let mut rows: BTreeMap<u32, PartialRow> = BTreeMap::new();
    let mut end = None;
    match MessageStream::new_with_options(bytes, Options::IgnoreEndMagic.into()) {
        Err(error) => end = Some(error),
        Ok(messages) => {
            for message in messages {
                match message {
                    Ok(message) => rows.entry(message.sequence).or_default().read(file, &message)?,
                    Err(error) => {
                        end = Some(error);
                        break;
                    }
                }
            }
        }
    }
    if end.is_none() && !bytes.ends_with(::mcap::MAGIC) {
        end = Some(McapError::BadMagic);
    }
    if end.is_some() {
        // The last row may lack messages.
        rows.pop_last();
    }
    let mut samples: Vec<Sample> = Vec::with_capacity(rows.len());
    for (row, partial) in rows {
        let fail = |topic, problem| Err(FlightError::in_file(file, problem).field(&place(topic, row)));
        let Some((t_s, configuration)) = partial.configuration else {
            return fail(CONFIGURATION, Problem::NoMessage);
        };
        let Some(command) = partial.command else {
            return fail(COMMAND, Problem::NoMessage);
        };
        if let Some(previous) = samples.last().map(|sample| sample.t_s)
            && t_s <= previous
        {
            return fail(CONFIGURATION, Problem::TimeNotIncreasing { found: t_s, previous });
        }
        let PartialRow {
            command_velocity,
            quadrotor,
            end_effector,
            ..
        } = partial;
        samples.push(Sample {
            t_s,
            configuration,
            command,
            command_velocity,
            quadrotor,
            end_effector,
        });
    }
    Ok((
        Flight {
            name: file.to_owned(),
            samples,
        },
        end,
    ))
}

impl PartialRow {
    /// Takes in one message; those of other topics are ignored.
    fn read(&mut self, file: &str, message: &::mcap::Message) -> Result<(), FlightError> {
        let topic = message.channel.topic.as_str();
        let fail = |problem| FlightError::in_file(file, problem).field(&place(topic, message.sequence));
        let not_json = |error: serde_json::Error| fail(Problem::NotAMessage(error.to_string()));
        match topic {
            CONFIGURATION => {
                let found: ConfigurationMessage = serde_json::from_slice(&message.data).map_err(not_json)?;
                let ConfigurationMessage {
                    t_s,
                    length_m,
                    pressure_kpa,
                } = found;
                plausible::length(length_m)
                    .and_then(|()| plausible::pressure(pressure_kpa))
                    .map_err(fail)?;
                self.configuration = Some((
                    t_s,
                    Configuration {
                        length_m,
                        pressure_kpa,
                    },
                ));
            }
            COMMAND_VELOCITY => {
                let Vector3 { x, y, z } = serde_json::from_slice(&message.data).map_err(not_json)?;
                [x, y, z]
                    .into_iter()
                    .try_for_each(plausible::velocity)
                    .map_err(fail)?;
                self.command_velocity = Some([x, y, z]);
            }
            COMMAND | QUADROTOR | END_EFFECTOR => {
                let found: PoseInFrame = serde_json::from_slice(&message.data).map_err(not_json)?;
                let Vector3 { x, y, z } = found.pose.position;
                let position = [x, y, z];
                position
                    .into_iter()
                    .try_for_each(plausible::position)
                    .map_err(fail)?;
                let Quaternion {
                    x: qx,
                    y: qy,
                    z: qz,
                    w: qw,
                } = found.pose.orientation;
                let attitude = quaternion::unit([qw, qx, qy, qz])
                    .map_err(|norm| fail(Problem::NotUnitQuaternion { norm }))?;
                match topic {
                    COMMAND => self.command = Some(position),
                    QUADROTOR => self.quadrotor = Some(Pose { position, attitude }),
                    _ => self.end_effector = Some(position),
                }
            }
            _ => {}
        }
        Ok(())
    }
}

fn place(topic: &str, row: u32) -> String {
    format!("{topic}, row {row}")
}

fn mcap_problem(error: McapError) -> Problem {
    match error {
        McapError::Io(error) => Problem::Io(error),
        error => Problem::NotMcap(error.to_string()),
    }
}

#[cfg(test)]
mod tests;
