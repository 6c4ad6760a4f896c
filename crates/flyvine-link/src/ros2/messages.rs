//! ROS 2's standard messages, field by field as their definitions have them: CDR is in that order.

use flyvine::flight;
use serde::{Deserialize, Serialize};

/// A type that ROS 2 knows by this name.
pub trait Message {
    /// Its name in DDS.
    const TYPE: &'static str;
}

/// `builtin_interfaces/msg/Time`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// From time since 1970, ns; those after 2038 are none that ROS has.
    pub fn from_unix_ns(time_ns: u64) -> Self {
        Self {
            sec: i32::try_from(time_ns / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (time_ns % 1_000_000_000) as u32,
        }
    }

    /// Time since 1970, s.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + 1e-9 * f64::from(self.nanosec)
    }
}

/// `std_msgs/msg/Header`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `geometry_msgs/msg/Point`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`: the scalar last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/msg/Pose`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    pub position: Point,
    pub orientation: Quaternion,
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    pub header: Header,
    pub pose: Pose,
}

/// `std_msgs/msg/Float64`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Float64 {
    pub data: f64,
}

impl Message for PoseStamped {
    const TYPE: &'static str = "geometry_msgs::msg::dds_::PoseStamped_";
}

impl Message for Float64 {
    const TYPE: &'static str = "std_msgs::msg::dds_::Float64_";
}

impl From<flight::Pose> for Pose {
    fn from(pose: flight::Pose) -> Self {
        let ([x, y, z], [qw, qx, qy, qz]) = (pose.position, pose.attitude);
        Self {
            position: Point { x, y, z },
            orientation: Quaternion {
                x: qx,
                y: qy,
                z: qz,
                w: qw,
            },
        }
    }
}
