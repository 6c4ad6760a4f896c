//! A simulated PX4 at the other end of a link: its protocol, its refusals and its failsafes; no flight dynamics.
//!
//! What it does, it does as PX4's documentation says (docs.px4.io: offboard mode, safety, external position estimation;
//! mavlink.io: command, parameter and signing protocols). It knows nothing of our own link.

use std::collections::BTreeMap;

use mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, COMMAND_LONG_DATA, GPS_GLOBAL_ORIGIN_DATA, HOME_POSITION_DATA,
    MavCmd, MavMessage, MavParamType, MavProtocolCapability, MavResult, MavSeverity, PARAM_VALUE_DATA,
    SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA, TIMESYNC_DATA,
};

use flyvine::link::Setpoint;

use super::px4_telemetry::{Sensed, Streams};
use crate::autopilot::{Codec, Identity, SigningKey, ned_from_enu, px4_mode};

/// A set-point older than this does not count as a stream, s.
const STREAM_S: f64 = 0.5;
/// Vision older than this does not count when arming, s.
const VISION_S: f64 = 0.5;
/// MPC_LAND_SPEED, m/s.
const LAND_M_S: f64 = 0.6;
/// COM_DISARM_LAND: time on the ground after which the motors stop, s.
const DISARM_S: f64 = 1.0;
/// Time that a restart takes, s.
const REBOOT_S: f64 = 3.0;
/// MIS_TAKEOFF_ALT, m.
const TAKE_OFF_M: f64 = 1.5;
/// Bits of a set-point's mask that ignore its position and its velocity.
const POSITION_IGNORED: u16 = 0b111;
const VELOCITY_IGNORED: u16 = 0b111_000;

/// Main mode and, within AUTO, sub-mode.
type CustomMode = (u8, u8);
const OFFBOARD: CustomMode = (px4_mode::OFFBOARD, 0);
const POSCTL: CustomMode = (px4_mode::POSCTL, 0);
const LOITER: CustomMode = (px4_mode::AUTO, px4_mode::LOITER);
const LAND: CustomMode = (px4_mode::AUTO, px4_mode::LAND);
const TAKE_OFF: CustomMode = (px4_mode::AUTO, 2);

/// A parameter: value, and whether it is an integer.
type Parameter = (f64, bool);

/// Who the autopilot is.
pub const IDENTITY: Identity = Identity {
    system: 1,
    component: 1,
};

/// A set-point as it arrived: for judging the sender.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceivedSetpoint {
    /// When, s.
    pub t_s: f64,
    /// Position, m, ENU.
    pub position: [f64; 3],
    /// Velocity, m/s, ENU, where the mask has one.
    pub velocity: Option<[f64; 3]>,
    /// Whether it was followed: armed, in OFFBOARD.
    pub followed: bool,
}

/// The autopilot; see the [module](self).
pub struct SimulatedPx4 {
    codec: Codec,
    key: Option<SigningKey>,
    pub(super) parameters: BTreeMap<&'static str, Parameter>,
    mode: CustomMode,
    armed: bool,
    setpoint: Option<(f64, Setpoint)>,
    vision_s: f64,
    /// Where the local frame's origin is on Earth: latitude and longitude, 1e-7 degrees, altitude, mm.
    origin: Option<[i32; 3]>,
    /// Where Hold holds, and where Land descends from, m, ENU.
    anchor: [f64; 3],
    landed_s: Option<f64>,
    sensed: Sensed,
    /// Time of the last start, s; the time before it is spent starting.
    up_s: f64,
    streams: Streams,
    outbox: Vec<Vec<u8>>,
    received: Vec<ReceivedSetpoint>,
}

impl SimulatedPx4 {
    /// Switched on at `now_s`; with a key, it speaks to nobody who does not sign.
    pub fn new(now_s: f64, key: Option<SigningKey>) -> Self {
        Self {
            codec: Codec::new(IDENTITY, key),
            key,
            parameters: defaults(),
            mode: POSCTL,
            armed: false,
            setpoint: None,
            vision_s: f64::NEG_INFINITY,
            origin: None,
            anchor: [0.0; 3],
            landed_s: None,
            sensed: Sensed::default(),
            up_s: now_s,
            streams: Streams::default(),
            outbox: Vec::new(),
            received: Vec::new(),
        }
    }

    /// Changes a parameter that there is, as a user would have done before the flight; whether there is one.
    pub fn set_parameter(&mut self, name: &str, value: f64) -> bool {
        match self.parameters.get_mut(name) {
            Some(parameter) => {
                parameter.0 = value;
                true
            }
            None => false,
        }
    }

    /// Whether the motors are armed.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether it is landing.
    pub fn is_landing(&self) -> bool {
        self.armed && self.mode == LAND
    }

    /// Whether it follows set-points.
    pub fn is_offboard(&self) -> bool {
        self.armed && self.mode == OFFBOARD
    }

    /// The position of the newest set-point, m, ENU.
    pub fn setpoint(&self) -> Option<[f64; 3]> {
        self.setpoint.map(|(_, setpoint)| setpoint.position)
    }

    /// All set-points that arrived since the last call.
    pub fn take_received(&mut self) -> Vec<ReceivedSetpoint> {
        std::mem::take(&mut self.received)
    }

    /// The frames to be sent, since the last call.
    pub fn take_frames(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.outbox)
    }

    /// The pilot takes the vehicle with the sticks.
    pub fn take_over(&mut self) {
        self.enter(POSCTL);
    }

    /// Starts anew: nothing is remembered but the parameters, nothing is said for a while.
    pub fn reboot(&mut self, now_s: f64) {
        let parameters = std::mem::take(&mut self.parameters);
        *self = Self {
            parameters,
            sensed: self.sensed,
            received: std::mem::take(&mut self.received),
            ..Self::new(now_s + REBOOT_S, self.key)
        };
    }

    /// Where the position controller is to go, ENU; `None` with the motors off.
    pub fn target(&self) -> Option<Setpoint> {
        if !self.armed {
            return None;
        }
        match self.mode {
            OFFBOARD => Some(self.setpoint.map_or(self.anchor.into(), |(_, setpoint)| setpoint)),
            _ => Some(self.anchor.into()),
        }
    }

    /// Takes in bytes from the wire.
    pub fn receive(&mut self, now_s: f64, bytes: &[u8]) {
        self.codec.feed(bytes);
        while let Some((_, message)) = self.codec.decode() {
            if now_s >= self.up_s {
                self.hear(now_s, &message);
            }
        }
    }

    /// One period of the commander, at least every 50 ms: failsafes, landing, telemetry.
    pub fn tick(&mut self, now_s: f64, sensed: Sensed, elapsed_s: f64) {
        self.sensed = sensed;
        if now_s < self.up_s {
            return;
        }
        self.watch_failsafes(now_s);
        if self.armed && self.mode == LAND {
            self.anchor[2] -= LAND_M_S * elapsed_s;
        }
        self.watch_landing(now_s);
        let mut out = Vec::new();
        let state = super::px4_telemetry::State {
            armed: self.armed,
            mode: px4_mode::custom(self.mode.0, self.mode.1),
            position_valid: self.has_position(now_s),
            since_boot_s: now_s - self.up_s,
            now_s,
        };
        self.streams.due(&state, &self.sensed, &mut out);
        for message in out {
            self.send(&message);
        }
    }

    #[expect(deprecated, reason = "released autopilots hear SET_GPS_GLOBAL_ORIGIN")]
    fn hear(&mut self, now_s: f64, message: &MavMessage) {
        match message {
            MavMessage::COMMAND_LONG(command) => self.command(now_s, command),
            MavMessage::COMMAND_INT(command) => {
                let result = match command.command {
                    MavCmd::MAV_CMD_DO_SET_GLOBAL_ORIGIN => {
                        self.set_origin([command.x, command.y, (1e3 * command.z) as i32])
                    }
                    _ => MavResult::MAV_RESULT_UNSUPPORTED,
                };
                self.acknowledge(command.command, result);
            }
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(data) => self.hear_setpoint(now_s, data),
            MavMessage::ODOMETRY(data) => {
                let numbers = [data.x, data.y, data.z].into_iter().chain(data.q);
                self.fuse(now_s, numbers);
            }
            MavMessage::VISION_POSITION_ESTIMATE(data) => {
                self.fuse(now_s, [data.x, data.y, data.z, data.roll, data.pitch, data.yaw]);
            }
            MavMessage::SET_GPS_GLOBAL_ORIGIN(data) => {
                self.set_origin([data.latitude, data.longitude, data.altitude]);
            }
            MavMessage::PARAM_REQUEST_READ(data) => match data.param_id.to_str() {
                Ok(name) if data.param_index < 0 => self.send_parameter(name),
                _ => {
                    let index = usize::try_from(data.param_index).unwrap_or(usize::MAX);
                    if let Some(&name) = self.parameters.keys().nth(index) {
                        self.send_parameter(name);
                    }
                }
            },
            MavMessage::PARAM_REQUEST_LIST(_) => {
                for name in self.parameters.keys().copied().collect::<Vec<_>>() {
                    self.send_parameter(name);
                }
            }
            MavMessage::PARAM_SET(data) => {
                if let Ok(name) = data.param_id.to_str() {
                    let value = match data.param_type {
                        MavParamType::MAV_PARAM_TYPE_REAL32 => f64::from(data.param_value),
                        _ => f64::from(data.param_value.to_bits().cast_signed()),
                    };
                    self.set_parameter(name, value);
                    self.send_parameter(name);
                }
            }
            MavMessage::TIMESYNC(data) if data.tc1 == 0 => self.send(&MavMessage::TIMESYNC(TIMESYNC_DATA {
                tc1: (1e9 * now_s) as i64,
                ts1: data.ts1,
                ..TIMESYNC_DATA::DEFAULT
            })),
            // The key is taken over an unsigned link only: afterwards nobody unsigned is heard.
            MavMessage::SETUP_SIGNING(data) => {
                let key = SigningKey(data.secret_key);
                self.key = (data.secret_key != [0; 32]).then_some(key);
                self.codec = Codec::new(IDENTITY, self.key);
            }
            _ => (),
        }
    }

    /// A set-point counts only if it has a position and is for us.
    fn hear_setpoint(&mut self, now_s: f64, data: &SET_POSITION_TARGET_LOCAL_NED_DATA) {
        // NED to ENU is ENU to NED.
        let position = ned_from_enu([data.x, data.y, data.z].map(f64::from));
        let ignored = data.type_mask.bits() & POSITION_IGNORED != 0;
        let is_for_us = data.target_system == IDENTITY.system || data.target_system == 0;
        if ignored || !is_for_us || !position.iter().all(|x| x.is_finite()) {
            return;
        }
        // A velocity that is ignored, wholly or in part, or is not finite, is none.
        let velocity = ned_from_enu([data.vx, data.vy, data.vz].map(f64::from));
        let is_heard =
            data.type_mask.bits() & VELOCITY_IGNORED == 0 && velocity.iter().all(|v| v.is_finite());
        let setpoint = Setpoint {
            position,
            velocity: is_heard.then_some(velocity),
        };
        self.setpoint = Some((now_s, setpoint));
        self.received.push(ReceivedSetpoint {
            t_s: now_s,
            position,
            velocity: setpoint.velocity,
            followed: self.is_offboard(),
        });
    }

    /// Takes in external vision, if the filter is set to it and it is possible.
    fn fuse(&mut self, now_s: f64, numbers: impl IntoIterator<Item = f32>) {
        let fused = self.parameter("EKF2_EV_CTRL") as u32 & 0b1001 == 0b1001;
        if fused && numbers.into_iter().all(f32::is_finite) {
            self.vision_s = now_s;
        }
    }

    fn parameter(&self, name: &str) -> f64 {
        self.parameters.get(name).map_or(0.0, |parameter| parameter.0)
    }

    fn has_position(&self, now_s: f64) -> bool {
        now_s - self.vision_s <= 1e-6 * self.parameter("EKF2_NOAID_TOUT")
    }

    fn streams_setpoints(&self, now_s: f64) -> bool {
        self.setpoint
            .is_some_and(|(heard_s, _)| now_s - heard_s <= STREAM_S)
    }

    fn command(&mut self, now_s: f64, data: &COMMAND_LONG_DATA) {
        if data.target_system != IDENTITY.system && data.target_system != 0 {
            return;
        }
        let result = match data.command {
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if data.param1 == 1.0 => self.arm(now_s),
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => self.disarm(),
            MavCmd::MAV_CMD_DO_SET_MODE => {
                let mode = (data.param2 as u8, data.param3 as u8);
                self.request_mode(now_s, mode)
            }
            MavCmd::MAV_CMD_NAV_LAND => self.request_mode(now_s, LAND),
            MavCmd::MAV_CMD_NAV_TAKEOFF => self.request_mode(now_s, TAKE_OFF),
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                self.streams.set_interval(data.param1 as u32, data.param2);
                MavResult::MAV_RESULT_ACCEPTED
            }
            MavCmd::MAV_CMD_REQUEST_MESSAGE => self.send_requested(data.param1 as u32),
            MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN if !self.armed => {
                self.reboot(now_s);
                return;
            }
            MavCmd::MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN => MavResult::MAV_RESULT_DENIED,
            _ => MavResult::MAV_RESULT_UNSUPPORTED,
        };
        self.acknowledge(data.command, result);
    }

    fn acknowledge(&mut self, command: MavCmd, result: MavResult) {
        self.send(&MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command,
            result,
            ..COMMAND_ACK_DATA::DEFAULT
        }));
    }

    fn arm(&mut self, now_s: f64) -> MavResult {
        if self.armed {
            return MavResult::MAV_RESULT_ACCEPTED;
        }
        let refusal = if now_s - self.vision_s > VISION_S {
            Some("Preflight Fail: no position or heading from vision")
        } else if self.mode == OFFBOARD && !self.streams_setpoints(now_s) {
            Some("Arming denied: no offboard signal")
        } else {
            None
        };
        if let Some(text) = refusal {
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
            return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        }
        self.armed = true;
        self.landed_s = None;
        self.anchor = self.sensed.position;
        self.say(MavSeverity::MAV_SEVERITY_INFO, "Armed by external command");
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn disarm(&mut self) -> MavResult {
        if self.armed && !self.sensed.on_ground {
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, "Disarming denied: not landed");
            return MavResult::MAV_RESULT_DENIED;
        }
        self.armed = false;
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn request_mode(&mut self, now_s: f64, mode: CustomMode) -> MavResult {
        let refusal = match mode {
            OFFBOARD if !self.streams_setpoints(now_s) => {
                Some("Switch to Offboard denied: no offboard signal")
            }
            LOITER | TAKE_OFF if self.origin.is_none() => {
                Some("Switching to Hold denied: no global position")
            }
            _ if mode != POSCTL && !self.has_position(now_s) => {
                Some("Switching mode denied: no local position")
            }
            OFFBOARD | LOITER | LAND | POSCTL | TAKE_OFF => None,
            _ => Some("Switching mode denied: unknown mode"),
        };
        if let Some(text) = refusal {
            self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
            return MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        }
        self.enter(mode);
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn enter(&mut self, mode: CustomMode) {
        self.anchor = self.sensed.position;
        if mode == TAKE_OFF {
            self.anchor[2] += TAKE_OFF_M;
        }
        self.mode = mode;
    }

    /// Offboard loss after COM_OF_LOSS_T, and position loss.
    fn watch_failsafes(&mut self, now_s: f64) {
        if !self.armed {
            return;
        }
        let silence_s = self
            .setpoint
            .map_or(f64::INFINITY, |(heard_s, _)| now_s - heard_s);
        if self.mode == OFFBOARD && silence_s > self.parameter("COM_OF_LOSS_T") {
            let hold = self.parameter("COM_OBL_RC_ACT") == 5.0 && self.origin.is_some();
            self.say(
                MavSeverity::MAV_SEVERITY_CRITICAL,
                "Failsafe: offboard control lost",
            );
            self.enter(if hold { LOITER } else { LAND });
        }
        if self.mode != LAND && !self.has_position(now_s) {
            self.say(
                MavSeverity::MAV_SEVERITY_CRITICAL,
                "Failsafe: position lost, descending",
            );
            self.enter(LAND);
        }
    }

    fn watch_landing(&mut self, now_s: f64) {
        if !(self.armed && self.mode == LAND && self.sensed.on_ground) {
            self.landed_s = None;
            return;
        }
        if now_s - *self.landed_s.get_or_insert(now_s) >= DISARM_S {
            self.armed = false;
            self.say(MavSeverity::MAV_SEVERITY_INFO, "Disarmed by landing");
        }
    }

    fn send_requested(&mut self, message: u32) -> MavResult {
        match message {
            148 => self.send(&MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
                capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED,
                // 1.16.0, release.
                flight_sw_version: 0x0110_00ff,
                ..AUTOPILOT_VERSION_DATA::DEFAULT
            })),
            242 if self.origin.is_some() => {
                self.send(&MavMessage::HOME_POSITION(HOME_POSITION_DATA::DEFAULT))
            }
            49 if self.origin.is_some() => self.send_origin(),
            _ => return MavResult::MAV_RESULT_DENIED,
        }
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn set_origin(&mut self, origin: [i32; 3]) -> MavResult {
        self.origin = Some(origin);
        self.send_origin();
        MavResult::MAV_RESULT_ACCEPTED
    }

    fn send_origin(&mut self) {
        let Some([latitude, longitude, altitude]) = self.origin else {
            return;
        };
        self.send(&MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
            latitude,
            longitude,
            altitude,
            ..GPS_GLOBAL_ORIGIN_DATA::DEFAULT
        }));
    }

    fn send_parameter(&mut self, name: &str) {
        let count = self.parameters.len() as u16;
        let Some((index, (name, &(value, integer)))) = self
            .parameters
            .iter()
            .enumerate()
            .find(|(_, (key, _))| **key == name)
        else {
            return;
        };
        let (param_value, param_type) = match integer {
            true => (
                f32::from_bits((value as i32).cast_unsigned()),
                MavParamType::MAV_PARAM_TYPE_INT32,
            ),
            false => (value as f32, MavParamType::MAV_PARAM_TYPE_REAL32),
        };
        let message = MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value,
            param_count: count,
            param_index: index as u16,
            param_id: (*name).into(),
            param_type,
        });
        self.send(&message);
    }

    fn say(&mut self, severity: MavSeverity, text: &str) {
        self.send(&MavMessage::STATUSTEXT(STATUSTEXT_DATA {
            severity,
            text: text.into(),
            ..STATUSTEXT_DATA::DEFAULT
        }));
    }

    fn send(&mut self, message: &MavMessage) {
        let frame = self.codec.encode(message);
        self.outbox.push(frame);
    }
}

fn defaults() -> BTreeMap<&'static str, Parameter> {
    BTreeMap::from([
        ("COM_ARM_WO_GPS", (1.0, true)),
        ("COM_OBL_RC_ACT", (4.0, true)),
        ("COM_OF_LOSS_T", (0.5, false)),
        ("COM_RC_OVERRIDE", (3.0, true)),
        ("EKF2_EV_CTRL", (11.0, true)),
        ("EKF2_EV_DELAY", (0.0, false)),
        ("EKF2_GPS_CTRL", (0.0, true)),
        ("EKF2_HGT_REF", (3.0, true)),
        ("EKF2_MAG_TYPE", (5.0, true)),
        ("EKF2_NOAID_TOUT", (500_000.0, true)),
    ])
}
