//! What the simulated PX4 tells of itself, and how often.

use flyvine::flight::Pose;
use mavlink::dialects::common::{
    ATTITUDE_QUATERNION_DATA, EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot,
    MavLandedState, MavMessage, MavModeFlag, MavState, MavType, SYS_STATUS_DATA, TIMESYNC_DATA,
};

use crate::autopilot::ned_pose;

/// What the autopilot's sensors tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensed {
    /// Position, m, ENU.
    pub position: [f64; 3],
    /// Attitude, Hamilton, world_from_body, scalar first.
    pub attitude: [f64; 4],
    /// Whether it stands on the ground.
    pub on_ground: bool,
}

impl Default for Sensed {
    fn default() -> Self {
        Self {
            position: [0.0; 3],
            attitude: [1.0, 0.0, 0.0, 0.0],
            on_ground: true,
        }
    }
}

/// What there is to tell.
pub(super) struct State {
    pub(super) armed: bool,
    pub(super) mode: u32,
    pub(super) position_valid: bool,
    pub(super) since_boot_s: f64,
    pub(super) now_s: f64,
}

/// Message number of HEARTBEAT.
const HEARTBEAT: u32 = 0;
/// Period of position and attitude, s.
const FAST_S: f64 = 1.0 / 30.0;
/// Period of the rest, s.
const SLOW_S: f64 = 0.2;

/// The streams: their periods, and when each is due next, s.
#[derive(Debug, Clone, Copy)]
pub(super) struct Streams {
    heartbeat_period_s: f64,
    heartbeat_s: f64,
    slow_s: f64,
    fast_s: f64,
}

impl Default for Streams {
    fn default() -> Self {
        Self {
            heartbeat_period_s: 1.0,
            heartbeat_s: 0.0,
            slow_s: 0.0,
            fast_s: 0.0,
        }
    }
}

impl Streams {
    /// MAV_CMD_SET_MESSAGE_INTERVAL: heard for the heartbeat; the other streams are fast enough for anybody.
    pub(super) fn set_interval(&mut self, message: u32, period_us: f32) {
        if message == HEARTBEAT && period_us > 0.0 {
            self.heartbeat_period_s = (1e-6 * f64::from(period_us)).clamp(0.05, 1.0);
            self.heartbeat_s = 0.0;
        }
    }

    /// The messages that are due.
    pub(super) fn due(&mut self, state: &State, sensed: &Sensed, out: &mut Vec<MavMessage>) {
        let boot_ms = (1e3 * state.since_boot_s) as u32;
        if state.now_s >= self.heartbeat_s {
            self.heartbeat_s = state.now_s + self.heartbeat_period_s;
            out.push(heartbeat(state));
        }
        if state.now_s >= self.slow_s {
            self.slow_s = state.now_s + SLOW_S;
            out.push(MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
                landed_state: match sensed.on_ground {
                    true => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
                    false => MavLandedState::MAV_LANDED_STATE_IN_AIR,
                },
                ..EXTENDED_SYS_STATE_DATA::DEFAULT
            }));
            out.push(MavMessage::SYS_STATUS(SYS_STATUS_DATA {
                voltage_battery: 15_800,
                current_battery: -1,
                battery_remaining: 90,
                ..SYS_STATUS_DATA::DEFAULT
            }));
            out.push(MavMessage::TIMESYNC(TIMESYNC_DATA {
                ts1: (1e9 * state.since_boot_s) as i64,
                ..TIMESYNC_DATA::DEFAULT
            }));
        }
        if state.now_s >= self.fast_s {
            self.fast_s = state.now_s + FAST_S;
            let Pose { position, attitude } = ned_pose(&Pose {
                position: sensed.position,
                attitude: sensed.attitude,
            });
            let [q1, q2, q3, q4] = attitude.map(|q| q as f32);
            out.push(MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                time_boot_ms: boot_ms,
                q1,
                q2,
                q3,
                q4,
                ..ATTITUDE_QUATERNION_DATA::DEFAULT
            }));
            if state.position_valid {
                let [x, y, z] = position.map(|x| x as f32);
                out.push(MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
                    time_boot_ms: boot_ms,
                    x,
                    y,
                    z,
                    ..LOCAL_POSITION_NED_DATA::DEFAULT
                }));
            }
        }
    }
}

fn heartbeat(state: &State) -> MavMessage {
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, state.armed);
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: state.mode,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode,
        system_status: match state.armed {
            true => MavState::MAV_STATE_ACTIVE,
            false => MavState::MAV_STATE_STANDBY,
        },
        mavlink_version: 3,
    })
}
