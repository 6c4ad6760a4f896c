//! The messages that go out, each built in one place.

use flyvine::flight::Pose;
use flyvine::link::Setpoint;
use mavlink::dialects::common::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavEstimatorType, MavFrame, MavMessage,
    MavModeFlag, MavState, MavType, ODOMETRY_DATA, PARAM_REQUEST_READ_DATA,
    SET_POSITION_TARGET_LOCAL_NED_DATA,
};

use super::codec::Identity;
use super::frames::{ned_from_enu, ned_pose, ned_yaw_from_enu};
use super::profile::Profile;

/// Standard deviation that external vision claims, position in m and attitude in rad; the filter has its own floor.
const VISION_POSITION_M: f32 = 1e-3;
const VISION_ATTITUDE_RAD: f32 = 1e-2;

/// Where the room is on Earth. Any place will do: Hold and Land want a global position, and indoors nobody knows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobalOrigin {
    /// Degrees.
    pub latitude_deg: f64,
    /// Degrees.
    pub longitude_deg: f64,
    /// Above mean sea level, m.
    pub altitude_m: f64,
}

impl Default for GlobalOrigin {
    /// Stanford's campus, where the paper's flights were made.
    fn default() -> Self {
        Self {
            latitude_deg: 37.4275,
            longitude_deg: -122.1697,
            altitude_m: 30.0,
        }
    }
}

/// A ground station's heartbeat: PX4 counts its link as lost without one.
pub(super) fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_GCS,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

/// A command with its seven parameters.
pub(super) fn command(to: Identity, command: MavCmd, parameters: [f32; 7], confirmation: u8) -> MavMessage {
    let [param1, param2, param3, param4, param5, param6, param7] = parameters;
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        command,
        target_system: to.system,
        target_component: to.component,
        confirmation,
    })
}

/// Asks for one parameter by name.
pub(super) fn read_parameter(to: Identity, name: &str) -> MavMessage {
    MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: to.system,
        target_component: to.component,
        param_id: name.into(),
    })
}

/// Tells where the local frame's origin is on Earth.
#[expect(
    deprecated,
    reason = "what replaces it, MAV_CMD_DO_SET_GLOBAL_ORIGIN, no released autopilot knows yet"
)]
pub(super) fn set_origin(to: Identity, origin: &GlobalOrigin, now_us: u64) -> MavMessage {
    MavMessage::SET_GPS_GLOBAL_ORIGIN(mavlink::dialects::common::SET_GPS_GLOBAL_ORIGIN_DATA {
        latitude: (1e7 * origin.latitude_deg).round() as i32,
        longitude: (1e7 * origin.longitude_deg).round() as i32,
        altitude: (1e3 * origin.altitude_m).round() as i32,
        target_system: to.system,
        time_usec: now_us,
    })
}

/// A set-point in ENU; `yaw` in ENU, rad.
pub(super) fn setpoint(
    to: Identity,
    profile: Profile,
    setpoint: Setpoint,
    yaw: f64,
    now_ms: u32,
) -> MavMessage {
    let [x, y, z] = ned_from_enu(setpoint.position).map(|x| x as f32);
    let [vx, vy, vz] = ned_from_enu(setpoint.velocity.unwrap_or_default()).map(|v| v as f32);
    MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: now_ms,
        x,
        y,
        z,
        vx,
        vy,
        vz,
        yaw: ned_yaw_from_enu(yaw) as f32,
        type_mask: profile.setpoint_mask(setpoint.velocity.is_some()),
        target_system: to.system,
        target_component: to.component,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
    })
}

/// External vision. Velocity is unknown and therefore NaN, as the message wants it; a pose with a NaN never gets here.
pub(super) fn vision(pose: &Pose, captured_us: u64, resets: u8) -> MavMessage {
    let Pose { position, attitude } = ned_pose(pose);
    let [x, y, z] = position.map(|x| x as f32);
    let mut pose_covariance = [0.0; 21];
    // Diagonal of the upper triangle of a 6 × 6 matrix, row by row.
    for (axis, place) in [0, 6, 11, 15, 18, 20].into_iter().enumerate() {
        let deviation = match axis {
            ..3 => VISION_POSITION_M,
            _ => VISION_ATTITUDE_RAD,
        };
        pose_covariance[place] = deviation * deviation;
    }
    let mut velocity_covariance = [0.0; 21];
    velocity_covariance[0] = f32::NAN;
    MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: captured_us,
        x,
        y,
        z,
        q: attitude.map(|q| q as f32),
        vx: f32::NAN,
        vy: f32::NAN,
        vz: f32::NAN,
        rollspeed: f32::NAN,
        pitchspeed: f32::NAN,
        yawspeed: f32::NAN,
        pose_covariance,
        velocity_covariance,
        frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        reset_counter: resets,
        estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_MOCAP,
        quality: 100,
    })
}
