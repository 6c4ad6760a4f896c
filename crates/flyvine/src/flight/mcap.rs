//! Flights as MCAP files (<https://mcap.dev>) of the [`messages`](super::messages).
//!
//! Each message's sequence number is its row. Chunks are small and not compressed, so a file that was cut off
//! loses its last seconds only.

mod sound;

use std::collections::BTreeMap;
use std::io::Cursor;

use super::continuity::check_rate;
use super::control_step::{ControlStep, StepRow};
use super::error::{FlightError, Problem};
use super::messages::{
    COMMAND, COMMAND_VELOCITY, CONFIGURATION, CONTROLLER, ConfigurationMessage, ENCODING, END_EFFECTOR,
    Message, PoseInFrame, QUADROTOR, TOPICS, Vector3, row_messages, schemas,
};
use super::{Configuration, Flight, Pose, Sample, plausible, quaternion};
use ::mcap::records::MessageHeader;
use ::mcap::{McapError, MessageStream, WriteOptions, Writer, read::Options};
use prost::Message as _;
use serde::de::DeserializeOwned;

pub use self::sound::sound_mcap;

/// Some four seconds of flight.
const CHUNK_BYTES: u64 = 32 * 1024;

/// The flight as an MCAP file's bytes. `file` is what error messages call it.
pub(super) fn format_mcap(
    file: &str,
    flight: &Flight,
    steps: &[ControlStep],
) -> Result<Vec<u8>, FlightError> {
    let encoded = encode(flight, steps).map_err(|error| FlightError::in_file(file, mcap_problem(error)))?;
    // What cannot be read again is not written.
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
    let schemas = schemas();
    let mut channels = Vec::with_capacity(TOPICS.len());
    for topic in &TOPICS {
        // A topic that nobody could have written to is not announced.
        if topic.name == CONTROLLER.name && steps.is_empty() {
            continue;
        }
        let schema = writer.add_schema(topic.schema_name, ENCODING, &schemas)?;
        channels.push(writer.add_channel(schema, topic.name, ENCODING, &BTreeMap::new())?);
    }
    let mut steps_left = steps.iter().peekable();
    for (row, sample) in flight.samples.iter().enumerate() {
        // The format's clock is unsigned; the exact time is in the message.
        let time_ns = (sample.t_s * 1e9).round().max(0.0) as u64;
        let step = steps_left.next_if(|step| step.row == row);
        for Message { topic, bytes } in row_messages(sample, step, time_ns) {
            let header = MessageHeader {
                channel_id: channels[topic],
                sequence: row as u32,
                log_time: time_ns,
                publish_time: time_ns,
            };
            writer.write_to_known_channel(&header, &bytes)?;
        }
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
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
    for message in MessageStream::new(sound_mcap(bytes)).map_err(fail)? {
        let message = message.map_err(fail)?;
        if message.channel.topic != CONTROLLER.name {
            continue;
        }
        let row = message.sequence as usize;
        let step = if is_json(&message) {
            serde_json::from_slice(&message.data).map_err(|error| error.to_string())
        } else {
            StepRow::decode(&*message.data).map_err(|error| error.to_string())
        };
        steps.push(step.and_then(|step: StepRow| step.step(row)).map_err(|reason| {
            FlightError::in_file(file, Problem::NotAMessage(reason))
                .field(&place(CONTROLLER.name, message.sequence))
        })?);
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
    let bytes = sound_mcap(bytes);
    let mut rows: BTreeMap<u32, PartialRow> = BTreeMap::new();
    let mut end = None;
    match MessageStream::new_with_options(bytes, Options::IgnoreEndMagic.into()) {
        Err(error) => end = Some(error),
        Ok(messages) => {
            for message in messages {
                match message {
                    // Recordings carry more than rows; the sequence numbers of other topics are their own.
                    Ok(message) if !is_row(&message) => (),
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
            return fail(CONFIGURATION.name, Problem::NoMessage);
        };
        let Some(command) = partial.command else {
            return fail(COMMAND.name, Problem::NoMessage);
        };
        if let Some(previous) = samples.last().map(|sample| sample.t_s)
            && t_s <= previous
        {
            return fail(
                CONFIGURATION.name,
                Problem::TimeNotIncreasing { found: t_s, previous },
            );
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
    /// Takes in one message of a row.
    fn read(&mut self, file: &str, message: &::mcap::Message) -> Result<(), FlightError> {
        let topic = message.channel.topic.as_str();
        let fail = |problem| FlightError::in_file(file, problem).field(&place(topic, message.sequence));
        if topic == CONFIGURATION.name {
            let ConfigurationMessage {
                t_s,
                length_m,
                pressure_kpa,
            } = decode_message(message).map_err(fail)?;
            if !t_s.is_finite() {
                return Err(fail(Problem::NotFinite { found: t_s }));
            }
            plausible::length(length_m)
                .and_then(|()| plausible::pressure(pressure_kpa))
                .map_err(fail)?;
            let configuration = Configuration {
                length_m,
                pressure_kpa,
            };
            self.configuration = Some((t_s, configuration));
        } else if topic == COMMAND_VELOCITY.name {
            let Vector3 { x, y, z } = decode_message(message).map_err(fail)?;
            [x, y, z]
                .into_iter()
                .try_for_each(plausible::velocity)
                .map_err(fail)?;
            self.command_velocity = Some([x, y, z]);
        } else {
            let Pose { position, attitude } = decode_pose(message).map_err(fail)?;
            match topic {
                _ if topic == COMMAND.name => self.command = Some(position),
                _ if topic == QUADROTOR.name => self.quadrotor = Some(Pose { position, attitude }),
                _ => self.end_effector = Some(position),
            }
        }
        Ok(())
    }
}

/// A message of either encoding.
fn decode_message<M: prost::Message + Default + DeserializeOwned>(
    message: &::mcap::Message,
) -> Result<M, Problem> {
    if is_json(message) {
        serde_json::from_slice(&message.data).map_err(|error| Problem::NotAMessage(error.to_string()))
    } else {
        M::decode(&*message.data).map_err(|error| Problem::NotAMessage(error.to_string()))
    }
}

/// A `foxglove.PoseInFrame`, of which all parts must be there.
fn decode_pose(message: &::mcap::Message) -> Result<Pose, Problem> {
    let missing = |what: &str| Problem::NotAMessage(format!("no {what}"));
    let found: PoseInFrame = decode_message(message)?;
    let pose = found.pose.ok_or_else(|| missing("pose"))?;
    let Vector3 { x, y, z } = pose.position.ok_or_else(|| missing("position"))?;
    let position = [x, y, z];
    position.into_iter().try_for_each(plausible::position)?;
    let orientation = pose.orientation.ok_or_else(|| missing("orientation"))?;
    let attitude = quaternion::unit([orientation.w, orientation.x, orientation.y, orientation.z])
        .map_err(|norm| Problem::NotUnitQuaternion { norm })?;
    Ok(Pose { position, attitude })
}

/// Whether a message is part of a row, as the reader of flights sees it.
fn is_row(message: &::mcap::Message) -> bool {
    [CONFIGURATION, COMMAND, COMMAND_VELOCITY, QUADROTOR, END_EFFECTOR]
        .iter()
        .any(|topic| topic.name == message.channel.topic)
}

/// Whether a message is one of an earlier version's.
fn is_json(message: &::mcap::Message) -> bool {
    message.channel.message_encoding == "json"
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
