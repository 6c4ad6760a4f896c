//! What a recording carries beside the rows of a flight, in the same encoding and with the same schemas as
//! [`flyvine::flight::messages`].

use flyvine::flight::messages::{PoseInFrame, PoseMessage, schemas};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp};

use super::SupervisorRow;
use crate::autopilot::ArmTelemetry;

/// `foxglove.PosesInFrame`
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PosesInFrame {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, repeated, tag = "3")]
    poses: Vec<PoseMessage>,
}

impl PosesInFrame {
    /// A path of upright poses, m, world frame.
    pub fn path(time_ns: u64, positions: &[[f64; 3]]) -> Self {
        let upright = |position: &[f64; 3]| PoseInFrame::new(time_ns, *position, [1.0, 0.0, 0.0, 0.0]);
        Self {
            timestamp: Some(timestamp(time_ns)),
            frame_id: "world".into(),
            poses: positions
                .iter()
                .filter_map(|position| upright(position).pose)
                .collect(),
        }
    }
}

/// `foxglove.Log`
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Log {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Foxglove's number: 2 info, 3 warning, 4 error.
    #[prost(int32, tag = "2")]
    pub level: i32,
    #[prost(string, tag = "3")]
    pub message: String,
    #[prost(string, tag = "4")]
    pub name: String,
}

/// `flyvine.Supervisor`
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Supervisor {
    #[prost(string, tag = "1")]
    state: String,
    #[prost(string, tag = "2")]
    reason: String,
    #[prost(string, tag = "3")]
    autopilot_mode: String,
    #[prost(bool, tag = "4")]
    armed: bool,
    #[prost(double, optional, tag = "5")]
    quadrotor_age_s: Option<f64>,
    #[prost(double, optional, tag = "6")]
    end_effector_age_s: Option<f64>,
    #[prost(double, optional, tag = "7")]
    autopilot_age_s: Option<f64>,
    #[prost(double, optional, tag = "8")]
    arm_age_s: Option<f64>,
}

impl From<&SupervisorRow> for Supervisor {
    fn from(row: &SupervisorRow) -> Self {
        Self {
            state: row.state.clone(),
            reason: row.reason.clone().unwrap_or_default(),
            autopilot_mode: row.autopilot_mode.clone(),
            armed: row.armed,
            quadrotor_age_s: row.quadrotor_age_s,
            end_effector_age_s: row.end_effector_age_s,
            autopilot_age_s: row.autopilot_age_s,
            arm_age_s: row.arm_age_s,
        }
    }
}

/// `flyvine.Arm`
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Arm {
    #[prost(double, optional, tag = "1")]
    length_m: Option<f64>,
    #[prost(double, optional, tag = "2")]
    pressure_kpa: Option<f64>,
    #[prost(double, tag = "3")]
    growth_m_s: f64,
    #[prost(string, tag = "4")]
    state: String,
}

impl From<&ArmTelemetry> for Arm {
    fn from(telemetry: &ArmTelemetry) -> Self {
        Self {
            length_m: telemetry.length_m,
            pressure_kpa: telemetry.pressure_kpa,
            growth_m_s: telemetry.growth_m_s,
            state: telemetry
                .state
                .map_or_else(String::new, |state| format!("{state:?}")),
        }
    }
}

pub(super) fn timestamp(time_ns: u64) -> Timestamp {
    Timestamp {
        seconds: (time_ns / 1_000_000_000) as i64,
        nanos: (time_ns % 1_000_000_000) as i32,
    }
}

/// The schemas of a flight's rows and of everything here: a serialized `FileDescriptorSet`.
pub(super) fn recording_schemas() -> Vec<u8> {
    let mut set = FileDescriptorSet::decode(&*schemas()).expect("the library's own schemas");
    let number = |name| field(name, Type::Double, None);
    let text = |name| field(name, Type::String, None);
    let stamp = || field("timestamp", Type::Message, Some(".google.protobuf.Timestamp"));
    let poses = FieldDescriptorProto {
        label: Some(Label::Repeated.into()),
        ..field("poses", Type::Message, Some(".foxglove.Pose"))
    };
    let log = vec![
        stamp(),
        field("level", Type::Int32, None),
        text("message"),
        text("name"),
    ];
    let supervisor = vec![
        text("state"),
        text("reason"),
        text("autopilot_mode"),
        field("armed", Type::Bool, None),
        number("quadrotor_age_s"),
        number("end_effector_age_s"),
        number("autopilot_age_s"),
        number("arm_age_s"),
    ];
    let arm = vec![
        number("length_m"),
        number("pressure_kpa"),
        number("growth_m_s"),
        text("state"),
    ];
    let file = |name: &str, package: &str, messages| FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        dependency: vec![
            "google/protobuf/timestamp.proto".to_owned(),
            "foxglove.proto".to_owned(),
        ],
        message_type: messages,
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    set.file.extend([
        file(
            "foxglove_recording.proto",
            "foxglove",
            vec![
                message("PosesInFrame", vec![stamp(), text("frame_id"), poses]),
                message("Log", log),
            ],
        ),
        file(
            "flyvine_recording.proto",
            "flyvine",
            vec![message("Supervisor", supervisor), message("Arm", arm)],
        ),
    ]);
    set.encode_to_vec()
}

fn field(name: &str, kind: Type, of: Option<&str>) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        json_name: Some(name.to_owned()),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        type_name: of.map(str::to_owned),
        ..FieldDescriptorProto::default()
    }
}

/// A message of these fields, numbered from 1.
fn message(name: &str, mut fields: Vec<FieldDescriptorProto>) -> DescriptorProto {
    for (i, field) in fields.iter_mut().enumerate() {
        field.number = Some(i as i32 + 1);
    }
    DescriptorProto {
        name: Some(name.to_owned()),
        field: fields,
        ..DescriptorProto::default()
    }
}
