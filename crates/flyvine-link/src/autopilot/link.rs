//! The link to the autopilot as a state machine: bytes in, bytes out, no clock and no socket of its own.
//!
//! It listens, keeps the autopilot's modes what they are wanted to be (asking until the heartbeat says so), and sends the
//! set-points and poses that it is given. Nothing is sent by itself but heartbeats, requests and answers: a set-point
//! leaves when somebody who knows how old the pose is hands it over, and at no other time.

use flyvine::flight::Pose;
use flyvine::link::{Mode, Setpoint};
use mavlink::dialects::common::{COMMAND_ACK_DATA, MavCmd, MavMessage, MavResult, TIMESYNC_DATA};

use super::codec::{Codec, Identity, SigningKey};
use super::messages::{self, GlobalOrigin};
use super::profile::Profile;
use super::telemetry::Telemetry;

/// Period of our heartbeat, s.
const HEARTBEAT_S: f64 = 1.0;
/// Time after which a request without effect is repeated, s.
const REPEAT_S: f64 = 0.5;
/// Time for the heartbeat to confirm what was acknowledged, s: one period of it and more.
const CONFIRM_S: f64 = 1.5;
/// Refusals to arm or to follow that end the attempt.
const REFUSALS_MAX: u32 = 6;
/// Times that missing parameters are asked for.
const PARAMETER_TRIES: u8 = 8;
/// Time on the ground after which motors that are still armed are switched off, s: the autopilot does it by itself before.
const DISARM_S: f64 = 4.0;
/// What is asked of the autopilot's telemetry: message and period, s.
const INTERVALS: [(u32, f64); 3] = [(0, 0.2), (32, 0.033), (245, 0.2)];
/// Message number of GPS_GLOBAL_ORIGIN.
const GPS_GLOBAL_ORIGIN: f32 = 49.0;

/// Parameters of MAV_CMD_NAV_LAND: no heading, no place, no height but those of now.
const LAND_HERE: [f32; 7] = [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, f32::NAN];

/// How a link is set up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkOptions {
    /// Who we are.
    pub identity: Identity,
    /// Which autopilot is expected.
    pub profile: Profile,
    /// Key of a signed link.
    pub key: Option<SigningKey>,
    /// Where the room is on Earth.
    pub origin: GlobalOrigin,
    /// Heading that every set-point holds, ENU, rad.
    pub yaw: f64,
}

impl Default for LinkOptions {
    fn default() -> Self {
        Self {
            identity: Identity {
                system: 245,
                component: 190,
            },
            profile: Profile::Px4,
            key: None,
            origin: GlobalOrigin::default(),
            yaw: 0.0,
        }
    }
}

/// One thing that is asked for again and again until it is so.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Asking {
    next_s: f64,
    times: u8,
}

impl Asking {
    /// Whether to ask now.
    fn is_due(&mut self, now_s: f64, period_s: f64) -> bool {
        let due = now_s >= self.next_s;
        if due {
            self.next_s = now_s + period_s;
            self.times = self.times.saturating_add(1);
        }
        due
    }
}

/// The link; see the [module](self).
pub struct AutopilotLink {
    options: LinkOptions,
    codec: Codec,
    telemetry: Telemetry,
    wanted: Mode,
    heartbeat: Asking,
    telemetry_rates: Asking,
    parameters: Asking,
    origin: Asking,
    mode: Asking,
    arming: Asking,
    take_off: Asking,
    disarming: Asking,
    landed_s: Option<f64>,
    refusals: u32,
    vision_resets: u8,
    vision_last: Option<(f64, [f64; 3])>,
    outbox: Vec<Vec<u8>>,
    notes: Vec<String>,
}

impl AutopilotLink {
    /// A link that has heard nothing yet and wants the autopilot to stand by.
    pub fn new(options: LinkOptions) -> Self {
        Self {
            codec: Codec::new(options.identity, options.key),
            options,
            telemetry: Telemetry::default(),
            wanted: Mode::Standby,
            heartbeat: Asking::default(),
            telemetry_rates: Asking::default(),
            parameters: Asking::default(),
            origin: Asking::default(),
            mode: Asking::default(),
            arming: Asking::default(),
            take_off: Asking::default(),
            disarming: Asking::default(),
            landed_s: None,
            refusals: 0,
            vision_resets: 0,
            vision_last: None,
            outbox: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// What was heard.
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// How it was set up.
    pub fn options(&self) -> &LinkOptions {
        &self.options
    }

    /// The mode that the autopilot is in, as far as a flight has a word for it. Under a profile with a take-off of its own
    /// it follows set-points only once it has left the ground.
    pub fn mode(&self) -> Option<Mode> {
        let mode = self.options.profile.mode(self.telemetry.custom_mode)?;
        let climbing =
            self.options.profile.take_off_height_m().is_some() && self.telemetry.on_ground != Some(false);
        (mode != Mode::Offboard || !climbing).then_some(mode)
    }

    /// Whether the autopilot refuses to arm or to follow set-points, time and again.
    pub fn is_refused(&self) -> bool {
        self.refusals >= REFUSALS_MAX
    }

    /// What is worth telling the operator, since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    /// The frames to be sent, since the last call.
    pub fn take_frames(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.outbox)
    }

    /// Wants the autopilot in `mode` from now on.
    pub fn set_mode(&mut self, mode: Mode) {
        if mode != self.wanted {
            self.wanted = mode;
            self.mode = Asking::default();
            self.arming = Asking::default();
            self.refusals = 0;
        }
    }

    /// Takes in bytes from the wire.
    pub fn receive(&mut self, now_s: f64, bytes: &[u8]) {
        self.codec.feed(bytes);
        while let Some((header, message)) = self.codec.decode() {
            // System numbers above 255 are for other networks.
            let Ok(system) = u8::try_from(header.system_id) else {
                continue;
            };
            let from = Identity {
                system,
                component: header.component_id,
            };
            let texts = self.telemetry.texts.len();
            self.telemetry.hear(now_s, from, &message, self.options.profile);
            if self.telemetry.identity != Some(from) {
                continue;
            }
            match message {
                MavMessage::COMMAND_ACK(ack) => self.acknowledged(now_s, &ack),
                MavMessage::TIMESYNC(data) if data.tc1 == 0 => self.answer_timesync(now_s, &data),
                MavMessage::STATUSTEXT(_) => {
                    let said = self
                        .telemetry
                        .texts
                        .iter()
                        .skip(texts.min(self.telemetry.texts.len() - 1));
                    self.notes.extend(said.map(|text| format!("autopilot: {text}")));
                }
                _ => (),
            }
        }
    }

    /// Sends what is due at `now_s`: our heartbeat, and requests that have had no effect yet.
    pub fn tick(&mut self, now_s: f64) {
        if self.heartbeat.is_due(now_s, HEARTBEAT_S) {
            self.send(&messages::heartbeat());
        }
        let Some(autopilot) = self.telemetry.identity else {
            return;
        };
        if self.telemetry.on_ground.is_none() || self.telemetry.position.is_none() {
            self.ask_for_telemetry(now_s, autopilot);
        }
        self.ask_for_parameters(now_s, autopilot);
        if !self.telemetry.has_origin && self.origin.is_due(now_s, HEARTBEAT_S) {
            let origin = messages::set_origin(autopilot, &self.options.origin, microseconds(now_s));
            self.send(&origin);
            self.command(
                autopilot,
                MavCmd::MAV_CMD_REQUEST_MESSAGE,
                &[GPS_GLOBAL_ORIGIN],
                0,
            );
        }
        self.pursue_mode(now_s, autopilot);
    }

    /// Sends a set-point, ENU.
    pub fn send_setpoint(&mut self, now_s: f64, setpoint: Setpoint) {
        let Some(autopilot) = self.telemetry.identity else {
            return;
        };
        // A set-point would cancel the take-off of an autopilot that has one of its own.
        let own_take_off = self.options.profile.take_off_height_m().is_some();
        if own_take_off && self.telemetry.armed && self.telemetry.on_ground != Some(false) {
            return;
        }
        let LinkOptions { profile, yaw, .. } = self.options;
        let message = messages::setpoint(autopilot, profile, setpoint, yaw, milliseconds(now_s));
        self.send(&message);
    }

    /// Relays a pose as external vision, if it is newer than the last one, possible, and no farther from it than
    /// `speed_max_m_s` allows; what is refused is for the supervisor to speak about.
    pub fn send_vision(&mut self, pose: &Pose, captured_s: f64, speed_max_m_s: f64) {
        let numbers = pose.position.iter().chain(&pose.attitude);
        if !captured_s.is_finite() || !numbers.clone().all(|x| x.is_finite()) {
            return;
        }
        if let Some((last_s, last)) = self.vision_last {
            let moved_m = (0..3)
                .map(|i| (pose.position[i] - last[i]).powi(2))
                .sum::<f64>()
                .sqrt();
            if captured_s <= last_s || moved_m > speed_max_m_s * (captured_s - last_s).max(flyvine::DT) {
                return;
            }
            if captured_s - last_s > HEARTBEAT_S {
                self.vision_resets = self.vision_resets.wrapping_add(1);
            }
        }
        self.vision_last = Some((captured_s, pose.position));
        let message = messages::vision(pose, microseconds(captured_s), self.vision_resets);
        self.send(&message);
    }

    /// Asks for the wanted mode and, to follow set-points, for arming, until the heartbeat says that it is so.
    fn pursue_mode(&mut self, now_s: f64, autopilot: Identity) {
        let profile = self.options.profile;
        let Some([main, sub]) = profile.mode_parameters(self.wanted) else {
            return;
        };
        let in_mode = profile.mode(self.telemetry.custom_mode) == Some(self.wanted);
        if !in_mode && !self.is_refused() && self.mode.is_due(now_s, REPEAT_S) {
            let confirmation = self.mode.times - 1;
            // Some autopilots have landing as a mode, some as a command: every other try is the other one.
            if self.wanted == Mode::Land && confirmation % 2 == 1 {
                self.command(autopilot, MavCmd::MAV_CMD_NAV_LAND, &LAND_HERE, 0);
            } else {
                let parameters = [1.0, main, sub];
                self.command(autopilot, MavCmd::MAV_CMD_DO_SET_MODE, &parameters, confirmation);
            }
        }
        let armed = self.telemetry.armed;
        match self.wanted {
            Mode::Offboard if in_mode && !armed && !self.is_refused() => {
                if self.arming.is_due(now_s, REPEAT_S) {
                    self.command(
                        autopilot,
                        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
                        &[1.0],
                        self.arming.times - 1,
                    );
                }
            }
            Mode::Offboard if in_mode && self.telemetry.on_ground != Some(false) => {
                if let Some(height_m) = profile.take_off_height_m()
                    && self.take_off.is_due(now_s, CONFIRM_S)
                {
                    let parameters = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m as f32];
                    self.command(autopilot, MavCmd::MAV_CMD_NAV_TAKEOFF, &parameters, 0);
                }
            }
            Mode::Land if armed && self.telemetry.on_ground == Some(true) => {
                let landed_s = *self.landed_s.get_or_insert(now_s);
                if now_s - landed_s >= DISARM_S && self.disarming.is_due(now_s, REPEAT_S) {
                    self.command(autopilot, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[0.0], 0);
                }
            }
            _ => self.landed_s = None,
        }
    }

    fn acknowledged(&mut self, now_s: f64, ack: &COMMAND_ACK_DATA) {
        let asking = match ack.command {
            MavCmd::MAV_CMD_DO_SET_MODE | MavCmd::MAV_CMD_NAV_LAND => &mut self.mode,
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => &mut self.arming,
            _ => return,
        };
        match ack.result {
            MavResult::MAV_RESULT_ACCEPTED | MavResult::MAV_RESULT_IN_PROGRESS => {
                asking.next_s = now_s + CONFIRM_S;
            }
            result => {
                if self.wanted == Mode::Offboard {
                    self.refusals += 1;
                }
                let what = match ack.command {
                    MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => "arming",
                    _ => self.options.profile.mode_name(self.wanted),
                };
                self.notes.push(format!("autopilot refuses {what}: {result:?}"));
            }
        }
    }

    /// PX4 learns our clock from these answers and turns capture times into its own.
    fn answer_timesync(&mut self, now_s: f64, data: &TIMESYNC_DATA) {
        self.send(&MavMessage::TIMESYNC(TIMESYNC_DATA {
            tc1: (1e9 * now_s) as i64,
            ts1: data.ts1,
            ..TIMESYNC_DATA::DEFAULT
        }));
    }

    fn ask_for_telemetry(&mut self, now_s: f64, autopilot: Identity) {
        if self.telemetry_rates.is_due(now_s, HEARTBEAT_S) {
            for (message, period_s) in INTERVALS {
                let parameters = [message as f32, (1e6 * period_s) as f32];
                self.command(autopilot, MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, &parameters, 0);
            }
        }
    }

    fn ask_for_parameters(&mut self, now_s: f64, autopilot: Identity) {
        let rules = self.options.profile.rules();
        let known = &self.telemetry.parameters;
        let complete = rules.iter().all(|rule| known.contains_key(rule.name));
        // A parameter that this version does not have is never answered.
        let given_up = self.parameters.times >= PARAMETER_TRIES;
        if complete || given_up || !self.parameters.is_due(now_s, REPEAT_S) {
            return;
        }
        let missing: Vec<&str> = rules
            .iter()
            .map(|rule| rule.name)
            .filter(|name| !known.contains_key(*name))
            .collect();
        for name in missing {
            self.send(&messages::read_parameter(autopilot, name));
        }
    }

    fn command(&mut self, autopilot: Identity, command: MavCmd, parameters: &[f32], confirmation: u8) {
        let mut all = [0.0; 7];
        all[..parameters.len()].copy_from_slice(parameters);
        self.send(&messages::command(autopilot, command, all, confirmation));
    }

    fn send(&mut self, message: &MavMessage) {
        let frame = self.codec.encode(message);
        self.outbox.push(frame);
    }
}

fn microseconds(time_s: f64) -> u64 {
    (1e6 * time_s.max(0.0)) as u64
}

fn milliseconds(time_s: f64) -> u32 {
    (1e3 * time_s.max(0.0)) as u64 as u32
}

#[cfg(test)]
#[path = "link_tests.rs"]
mod tests;
