//! A flight as messages that Foxglove, Rerun and PlotJuggler know: in MCAP files, and live over a WebSocket.
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
//! They are Protocol Buffers, the only encoding in which Rerun knows Foxglove's schemas
//! (<https://docs.foxglove.dev/docs/sdk/schemas>). Files of earlier versions carry the same messages as JSON.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp};
use serde::Deserialize;

use super::control_step::{ControlStep, STEP_COLUMNS, StepRow};
use super::{Configuration, Sample};

/// How messages and schemas are encoded, as MCAP files and Foxglove name it.
pub const ENCODING: &str = "protobuf";

/// What the messages of one name look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// For example `/quadrotor`.
    pub name: &'static str,
    /// Name of the messages' schema, one of [`schemas`].
    pub schema_name: &'static str,
}

/// A row's configuration and exact time.
pub const CONFIGURATION: Topic = Topic {
    name: "/configuration",
    schema_name: "flyvine.Configuration",
};
/// Commanded quadrotor position.
pub const COMMAND: Topic = Topic {
    name: "/command",
    schema_name: "foxglove.PoseInFrame",
};
/// Commanded velocity, where there is one.
pub const COMMAND_VELOCITY: Topic = Topic {
    name: "/command_velocity",
    schema_name: "foxglove.Vector3",
};
/// Quadrotor pose.
pub const QUADROTOR: Topic = Topic {
    name: "/quadrotor",
    schema_name: "foxglove.PoseInFrame",
};
/// End-effector position.
pub const END_EFFECTOR: Topic = Topic {
    name: "/end_effector",
    schema_name: "foxglove.PoseInFrame",
};
/// What the controller reported of its step.
pub const CONTROLLER: Topic = Topic {
    name: "/controller",
    schema_name: "flyvine.ControlStep",
};
/// Every topic, in the order in which a row's messages are written; the controller's, which not every file has, last.
pub const TOPICS: [Topic; 6] = [
    CONFIGURATION,
    COMMAND,
    COMMAND_VELOCITY,
    QUADROTOR,
    END_EFFECTOR,
    CONTROLLER,
];

const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// One message: an index into [`TOPICS`], and its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Index into [`TOPICS`].
    pub topic: usize,
    /// The message.
    pub bytes: Vec<u8>,
}

/// The messages of one row, stamped with `time_ns`.
pub fn row_messages(sample: &Sample, step: Option<&ControlStep>, time_ns: u64) -> Vec<Message> {
    let Configuration {
        length_m,
        pressure_kpa,
    } = sample.configuration;
    let configuration = ConfigurationMessage {
        t_s: sample.t_s,
        length_m,
        pressure_kpa,
    };
    let pose = |position, attitude| PoseInFrame::new(time_ns, position, attitude).encode_to_vec();
    let bodies = [
        Some(configuration.encode_to_vec()),
        Some(pose(sample.command, UPRIGHT)),
        sample
            .command_velocity
            .map(|[x, y, z]| Vector3 { x, y, z }.encode_to_vec()),
        sample.quadrotor.map(|seen| pose(seen.position, seen.attitude)),
        sample.end_effector.map(|position| pose(position, UPRIGHT)),
        step.map(|step| StepRow::new(step).encode_to_vec()),
    ];
    bodies
        .into_iter()
        .enumerate()
        .filter_map(|(topic, bytes)| Some(Message { topic, bytes: bytes? }))
        .collect()
}

// `required` writes zeros, too: proto3 would leave out 0, and with it the sign of −0.

/// `flyvine.Configuration`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
pub(super) struct ConfigurationMessage {
    #[prost(double, required, tag = "1")]
    pub t_s: f64,
    #[prost(double, required, tag = "2")]
    pub length_m: f64,
    #[prost(double, required, tag = "3")]
    pub pressure_kpa: f64,
}

/// `foxglove.Vector3`
#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[expect(missing_docs, reason = "as in the schema")]
pub struct Vector3 {
    #[prost(double, required, tag = "1")]
    pub x: f64,
    #[prost(double, required, tag = "2")]
    pub y: f64,
    #[prost(double, required, tag = "3")]
    pub z: f64,
}

/// `foxglove.Quaternion`
#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[expect(missing_docs, reason = "as in the schema")]
pub struct Quaternion {
    #[prost(double, required, tag = "1")]
    pub x: f64,
    #[prost(double, required, tag = "2")]
    pub y: f64,
    #[prost(double, required, tag = "3")]
    pub z: f64,
    #[prost(double, required, tag = "4")]
    pub w: f64,
}

/// `foxglove.Pose`
#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[expect(missing_docs, reason = "as in the schema")]
pub struct PoseMessage {
    #[prost(message, optional, tag = "1")]
    pub position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<Quaternion>,
}

/// `foxglove.PoseInFrame`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[expect(missing_docs, reason = "as in the schema")]
pub struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    #[serde(skip)]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub pose: Option<PoseMessage>,
}

impl PoseInFrame {
    /// A pose in the world frame (m; Hamilton quaternion, scalar first), stamped with `time_ns`.
    pub fn new(time_ns: u64, [x, y, z]: [f64; 3], [qw, qx, qy, qz]: [f64; 4]) -> Self {
        Self {
            timestamp: Some(Timestamp {
                seconds: (time_ns / 1_000_000_000) as i64,
                nanos: (time_ns % 1_000_000_000) as i32,
            }),
            frame_id: "world".into(),
            pose: Some(PoseMessage {
                position: Some(Vector3 { x, y, z }),
                orientation: Some(Quaternion {
                    x: qx,
                    y: qy,
                    z: qz,
                    w: qw,
                }),
            }),
        }
    }
}

/// The schemas of all messages: a serialized `FileDescriptorSet`, the same for every topic.
pub fn schemas() -> Vec<u8> {
    let number = |name| (name, Type::Double, None);
    let part = |name, message| (name, Type::Message, Some(message));
    let file = |name: &str, package: &str, dependencies: &[&str], messages| FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        dependency: dependencies.iter().map(|&name| name.to_owned()).collect(),
        message_type: messages,
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    let timestamp = [("seconds", Type::Int64, None), ("nanos", Type::Int32, None)];
    let pose_in_frame = [
        part("timestamp", ".google.protobuf.Timestamp"),
        ("frame_id", Type::String, None),
        part("pose", ".foxglove.Pose"),
    ];
    let step = STEP_COLUMNS.map(|name| match name {
        "step_status" => (name, Type::String, None),
        "step_changes" | "step_active" => (name, Type::Uint64, None),
        _ => number(name),
    });
    let timestamp_file = "google/protobuf/timestamp.proto";
    FileDescriptorSet {
        file: vec![
            file(
                timestamp_file,
                "google.protobuf",
                &[],
                vec![message("Timestamp", &timestamp)],
            ),
            file(
                "foxglove.proto",
                "foxglove",
                &[timestamp_file],
                vec![
                    message("Vector3", &["x", "y", "z"].map(number)),
                    message("Quaternion", &["x", "y", "z", "w"].map(number)),
                    message(
                        "Pose",
                        &[
                            part("position", ".foxglove.Vector3"),
                            part("orientation", ".foxglove.Quaternion"),
                        ],
                    ),
                    message("PoseInFrame", &pose_in_frame),
                ],
            ),
            file(
                "flyvine.proto",
                "flyvine",
                &[],
                vec![
                    message("Configuration", &["t_s", "length_m", "pressure_kpa"].map(number)),
                    message("ControlStep", &step),
                ],
            ),
        ],
    }
    .encode_to_vec()
}

/// A message of these fields, numbered from 1.
fn message(name: &str, fields: &[(&str, Type, Option<&str>)]) -> DescriptorProto {
    let field = |(i, &(name, kind, of)): (usize, &(&str, Type, Option<&str>))| FieldDescriptorProto {
        name: Some(name.to_owned()),
        json_name: Some(name.to_owned()),
        number: Some(i as i32 + 1),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        type_name: of.map(str::to_owned),
        ..FieldDescriptorProto::default()
    };
    DescriptorProto {
        name: Some(name.to_owned()),
        field: fields.iter().enumerate().map(field).collect(),
        ..DescriptorProto::default()
    }
}
