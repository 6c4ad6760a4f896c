//! What the autopilot says of itself.

use std::collections::{BTreeMap, VecDeque};

use mavlink::dialects::common::{MavLandedState, MavMessage, MavModeFlag};

use super::codec::Identity;
use super::frames::ned_from_enu;
use super::parameters;
use super::pose_source::Stamped;
use super::profile::Profile;

/// Boot time that runs back by more than this is a restart, ms; less is a late datagram.
const RESTART_MS: u32 = 1000;
/// Texts kept.
const TEXTS: usize = 20;

/// The newest of everything that was heard.
#[derive(Debug, Clone, PartialEq)]
pub struct Telemetry {
    /// Who the autopilot is, once it was heard.
    pub identity: Option<Identity>,
    /// When anything was last heard of it, s.
    pub heard_s: f64,
    /// Whether the motors are armed.
    pub armed: bool,
    /// Its mode, as it numbers it.
    pub custom_mode: u32,
    /// When its last heartbeat came, s.
    pub heartbeat_s: f64,
    /// Whether it says that it is on the ground; `None` before it says anything.
    pub on_ground: Option<bool>,
    /// Its own estimate of its position, m, ENU, when it came.
    pub position: Option<Stamped<[f64; 3]>>,
    /// Battery left, percent.
    pub battery_percent: Option<f64>,
    /// Whether it knows where its origin is on Earth.
    pub has_origin: bool,
    /// Whether it started anew since it was first heard.
    pub restarted: bool,
    /// Parameters read so far.
    pub parameters: BTreeMap<String, f64>,
    /// Its last words, oldest first.
    pub texts: VecDeque<String>,
    boot_ms: Option<u32>,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self {
            identity: None,
            heard_s: f64::NEG_INFINITY,
            armed: false,
            custom_mode: 0,
            heartbeat_s: f64::NEG_INFINITY,
            on_ground: None,
            position: None,
            battery_percent: None,
            has_origin: false,
            restarted: false,
            parameters: BTreeMap::new(),
            texts: VecDeque::new(),
            boot_ms: None,
        }
    }
}

impl Telemetry {
    /// Takes in a message of `from`; the first autopilot of the right make is the one that is listened to.
    pub(super) fn hear(&mut self, now_s: f64, from: Identity, message: &MavMessage, profile: Profile) {
        if let (None, MavMessage::HEARTBEAT(data)) = (self.identity, message)
            && data.autopilot == profile.autopilot()
        {
            self.identity = Some(from);
        }
        if self.identity != Some(from) {
            return;
        }
        self.heard_s = now_s;
        match message {
            MavMessage::HEARTBEAT(data) => {
                self.armed = data.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
                self.custom_mode = data.custom_mode;
                self.heartbeat_s = now_s;
            }
            MavMessage::EXTENDED_SYS_STATE(data) => {
                self.on_ground = match data.landed_state {
                    MavLandedState::MAV_LANDED_STATE_UNDEFINED => None,
                    state => Some(state == MavLandedState::MAV_LANDED_STATE_ON_GROUND),
                };
            }
            MavMessage::LOCAL_POSITION_NED(data) => {
                self.watch_boot(data.time_boot_ms);
                // NED to ENU is ENU to NED.
                let value = ned_from_enu([data.x, data.y, data.z].map(f64::from));
                self.position = value.iter().all(|x| x.is_finite()).then_some(Stamped {
                    value,
                    captured_s: now_s,
                });
            }
            MavMessage::SYS_STATUS(data) => {
                self.battery_percent =
                    (data.battery_remaining >= 0).then(|| f64::from(data.battery_remaining));
            }
            MavMessage::GPS_GLOBAL_ORIGIN(_) => self.has_origin = true,
            MavMessage::PARAM_VALUE(data) => {
                if let Ok(name) = data.param_id.to_str() {
                    let value = parameters::value(data, profile.parameters_are_bytewise());
                    self.parameters.insert(name.to_owned(), value);
                }
            }
            MavMessage::STATUSTEXT(data) => {
                if let Ok(text) = data.text.to_str() {
                    if self.texts.len() == TEXTS {
                        self.texts.pop_front();
                    }
                    self.texts.push_back(text.to_owned());
                }
            }
            _ => (),
        }
    }

    fn watch_boot(&mut self, boot_ms: u32) {
        self.restarted |= self
            .boot_ms
            .is_some_and(|last| boot_ms.saturating_add(RESTART_MS) < last);
        self.boot_ms = Some(boot_ms);
    }
}
