//! The messages of a recording, as JSON with their schemas (<https://docs.foxglove.dev/docs/sdk/schemas>).

use serde::Serialize;

use super::{LogLevel, SupervisorRow};

/// A schema's name and text.
pub(super) type Schema = (&'static str, &'static str);

pub(super) const CONFIGURATION: Schema = (
    "flyvine.Configuration",
    r#"{"type":"object","properties":{"t_s":{"type":"number"},"length_m":{"type":"number"},"pressure_kpa":{"type":"number"}}}"#,
);

pub(super) const VECTOR: Schema = (
    "foxglove.Vector3",
    r#"{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}}"#,
);

pub(super) const POSE: Schema = (
    "foxglove.PoseInFrame",
    r#"{"type":"object","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"frame_id":{"type":"string"},
"pose":{"type":"object","title":"foxglove.Pose","properties":{
"position":{"type":"object","title":"foxglove.Vector3","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},
"orientation":{"type":"object","title":"foxglove.Quaternion","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"},"w":{"type":"number"}}}}}}}"#,
);

pub(super) const POSES: Schema = (
    "foxglove.PosesInFrame",
    r#"{"type":"object","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"frame_id":{"type":"string"},
"poses":{"type":"array","items":{"type":"object","title":"foxglove.Pose","properties":{
"position":{"type":"object","title":"foxglove.Vector3","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},
"orientation":{"type":"object","title":"foxglove.Quaternion","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"},"w":{"type":"number"}}}}}}}}"#,
);

pub(super) const LOG: Schema = (
    "foxglove.Log",
    r#"{"type":"object","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"level":{"type":"integer"},"message":{"type":"string"},"name":{"type":"string"},"file":{"type":"string"},"line":{"type":"integer"}}}"#,
);

pub(super) const SUPERVISOR: Schema = (
    "flyvine.Supervisor",
    r#"{"type":"object","properties":{"state":{"type":"string"},"mode":{"type":"string"},"reason":{"type":"string"},"quadrotor_age_s":{"type":"number"},"end_effector_age_s":{"type":"number"}}}"#,
);

/// The frame that all poses are in.
const WORLD: &str = "world";

#[derive(Serialize)]
pub(super) struct Configuration {
    pub t_s: f64,
    pub length_m: f64,
    pub pressure_kpa: f64,
}

#[derive(Serialize)]
pub(super) struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

impl From<[f64; 3]> for Vector3 {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Vector3 { x, y, z }
    }
}

#[derive(Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Serialize)]
struct Pose {
    position: Vector3,
    orientation: Quaternion,
}

impl Pose {
    fn new(position: [f64; 3], [w, x, y, z]: [f64; 4]) -> Self {
        Pose {
            position: position.into(),
            orientation: Quaternion { x, y, z, w },
        }
    }
}

#[derive(Serialize)]
struct Timestamp {
    sec: u64,
    nsec: u32,
}

impl Timestamp {
    fn new(time_ns: u64) -> Self {
        Timestamp {
            sec: time_ns / 1_000_000_000,
            nsec: (time_ns % 1_000_000_000) as u32,
        }
    }
}

#[derive(Serialize)]
pub(super) struct PoseInFrame {
    timestamp: Timestamp,
    frame_id: &'static str,
    pose: Pose,
}

impl PoseInFrame {
    pub fn new(time_ns: u64, position: [f64; 3], attitude: [f64; 4]) -> Self {
        PoseInFrame {
            timestamp: Timestamp::new(time_ns),
            frame_id: WORLD,
            pose: Pose::new(position, attitude),
        }
    }
}

#[derive(Serialize)]
pub(super) struct PosesInFrame {
    timestamp: Timestamp,
    frame_id: &'static str,
    poses: Vec<Pose>,
}

impl PosesInFrame {
    /// A path of upright poses.
    pub fn path(time_ns: u64, positions: &[[f64; 3]]) -> Self {
        PosesInFrame {
            timestamp: Timestamp::new(time_ns),
            frame_id: WORLD,
            poses: positions
                .iter()
                .map(|position| Pose::new(*position, [1.0, 0.0, 0.0, 0.0]))
                .collect(),
        }
    }
}

#[derive(Serialize)]
pub(super) struct Log<'a> {
    timestamp: Timestamp,
    level: u8,
    message: &'a str,
    name: &'static str,
    file: &'static str,
    line: u32,
}

impl<'a> Log<'a> {
    pub fn new(time_ns: u64, level: LogLevel, message: &'a str) -> Self {
        Log {
            timestamp: Timestamp::new(time_ns),
            level: level as u8,
            message,
            name: "flyvine",
            file: "",
            line: 0,
        }
    }
}

#[derive(Serialize)]
pub(super) struct Supervisor<'a> {
    state: &'a str,
    mode: &'a str,
    reason: &'a str,
    quadrotor_age_s: Option<f64>,
    end_effector_age_s: Option<f64>,
}

impl<'a> From<&'a SupervisorRow> for Supervisor<'a> {
    fn from(row: &'a SupervisorRow) -> Self {
        Supervisor {
            state: &row.state,
            mode: &row.mode,
            reason: row.reason.as_deref().unwrap_or_default(),
            quadrotor_age_s: row.quadrotor_age_s,
            end_effector_age_s: row.end_effector_age_s,
        }
    }
}
