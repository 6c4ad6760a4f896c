//! The link against a hand-driven autopilot.

use mavlink::dialects::common::{
    EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavFrame, MavLandedState,
    MavModeFlag, MavParamType, MavState, MavType, PARAM_VALUE_DATA,
};

use super::*;
use crate::autopilot::px4_mode;

const AUTOPILOT: Identity = Identity {
    system: 1,
    component: 1,
};

/// The link, and what the autopilot says and hears.
struct Wire {
    link: AutopilotLink,
    codec: Codec,
    now_s: f64,
}

impl Wire {
    fn new(profile: Profile) -> Self {
        Self {
            link: AutopilotLink::new(LinkOptions {
                profile,
                ..LinkOptions::default()
            }),
            codec: Codec::new(AUTOPILOT, None),
            now_s: 100.0,
        }
    }

    fn say(&mut self, message: &MavMessage) {
        let frame = self.codec.encode(message);
        self.link.receive(self.now_s, &frame);
    }

    fn heartbeat(&mut self, custom_mode: u32, armed: bool) {
        let autopilot = self.link.options().profile.autopilot();
        self.say(&heartbeat(autopilot, custom_mode, armed));
    }

    fn ground(&mut self, on_ground: bool) {
        self.say(&MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state: match on_ground {
                true => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
                false => MavLandedState::MAV_LANDED_STATE_IN_AIR,
            },
            ..EXTENDED_SYS_STATE_DATA::DEFAULT
        }));
    }

    /// What the link sends in `duration_s`.
    fn run(&mut self, duration_s: f64) -> Vec<MavMessage> {
        let until_s = self.now_s + duration_s;
        while self.now_s < until_s {
            self.now_s += 0.02;
            self.link.tick(self.now_s);
        }
        self.sent()
    }

    fn sent(&mut self) -> Vec<MavMessage> {
        let mut other = Codec::new(AUTOPILOT, None);
        for frame in self.link.take_frames() {
            other.feed(&frame);
        }
        std::iter::from_fn(|| other.decode())
            .map(|(_, message)| message)
            .collect()
    }

    fn acknowledge(&mut self, command: MavCmd, result: MavResult) {
        self.say(&MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command,
            result,
            ..COMMAND_ACK_DATA::DEFAULT
        }));
    }
}

fn heartbeat(autopilot: MavAutopilot, custom_mode: u32, armed: bool) -> MavMessage {
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, armed);
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot,
        base_mode,
        system_status: MavState::MAV_STATE_STANDBY,
        mavlink_version: 3,
    })
}

/// The commands among `messages`: number and first three parameters.
fn commands(messages: &[MavMessage]) -> Vec<(MavCmd, [f32; 3])> {
    let command = |message: &MavMessage| match message {
        MavMessage::COMMAND_LONG(data) => Some((data.command, [data.param1, data.param2, data.param3])),
        _ => None,
    };
    messages.iter().filter_map(command).collect()
}

fn setpoints(messages: &[MavMessage]) -> usize {
    let is_setpoint = |message: &&MavMessage| matches!(message, MavMessage::SET_POSITION_TARGET_LOCAL_NED(_));
    messages.iter().filter(is_setpoint).count()
}

const SET_MODE: MavCmd = MavCmd::MAV_CMD_DO_SET_MODE;
const ARM: MavCmd = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;

#[test]
fn an_autopilot_that_is_heard_is_asked_for_everything_and_for_no_mode() {
    let mut wire = Wire::new(Profile::Px4);
    assert!(
        wire.run(3.0)
            .iter()
            .all(|message| matches!(message, MavMessage::HEARTBEAT(_))),
        "nobody is there to be asked"
    );
    wire.heartbeat(px4_mode::custom(px4_mode::POSCTL, 0), false);
    let sent = wire.run(1.0);
    let asked = |name: &str| {
        sent.iter().any(|message| match message {
            MavMessage::PARAM_REQUEST_READ(data) => {
                data.param_id.to_str() == Ok(name) && data.param_index == -1
            }
            _ => false,
        })
    };
    assert!(Profile::Px4.rules().iter().all(|rule| asked(rule.name)));
    let commands = commands(&sent);
    assert!(
        commands
            .iter()
            .any(|(command, _)| *command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL)
    );
    assert!(
        commands
            .iter()
            .all(|(command, _)| *command != SET_MODE && *command != ARM)
    );
}

#[test]
fn the_mode_comes_before_arming_and_both_are_asked_for_until_the_heartbeat_says_so() {
    let mut wire = Wire::new(Profile::Px4);
    wire.heartbeat(px4_mode::custom(px4_mode::POSCTL, 0), false);
    wire.run(1.0);
    wire.link.set_mode(Mode::Offboard);
    let asked = commands(&wire.run(1.2));
    let modes = asked.iter().filter(|(command, _)| *command == SET_MODE);
    assert_eq!(modes.clone().count(), 3, "every half second: {asked:?}");
    assert!(
        modes
            .clone()
            .all(|(_, parameters)| *parameters == [1.0, 6.0, 0.0])
    );
    assert!(asked.iter().all(|(command, _)| *command != ARM));
    // Acknowledged, but not in the heartbeat yet: it has its time.
    wire.acknowledge(SET_MODE, MavResult::MAV_RESULT_ACCEPTED);
    assert!(
        commands(&wire.run(1.0))
            .iter()
            .all(|(command, _)| *command != SET_MODE)
    );
    wire.heartbeat(px4_mode::custom(px4_mode::OFFBOARD, 0), false);
    assert!(commands(&wire.run(0.1)).contains(&(ARM, [1.0, 0.0, 0.0])));
    wire.heartbeat(px4_mode::custom(px4_mode::OFFBOARD, 0), true);
    assert!(
        commands(&wire.run(2.0))
            .iter()
            .all(|(command, _)| *command != ARM)
    );
    assert_eq!(wire.link.mode(), Some(Mode::Offboard));
    wire.link.set_mode(Mode::Land);
    assert!(commands(&wire.run(0.1)).contains(&(SET_MODE, [1.0, 4.0, 6.0])));
}

#[test]
fn refusals_end_the_attempt_to_fly_but_never_the_one_to_land() {
    let mut wire = Wire::new(Profile::Px4);
    wire.heartbeat(px4_mode::custom(px4_mode::POSCTL, 0), false);
    wire.link.set_mode(Mode::Offboard);
    for _ in 0..REFUSALS_MAX {
        assert!(!wire.link.is_refused());
        wire.run(0.6);
        wire.acknowledge(SET_MODE, MavResult::MAV_RESULT_TEMPORARILY_REJECTED);
    }
    assert!(wire.link.is_refused());
    assert!(
        wire.link
            .take_notes()
            .iter()
            .any(|note| note.contains("refuses OFFBOARD"))
    );
    assert!(
        commands(&wire.run(2.0)).is_empty() || !commands(&wire.run(2.0)).iter().any(|(c, _)| *c == SET_MODE)
    );
    wire.link.set_mode(Mode::Land);
    let land = [SET_MODE, MavCmd::MAV_CMD_NAV_LAND];
    for _ in 0..2 * REFUSALS_MAX {
        let asked = commands(&wire.run(0.6));
        assert!(
            asked.iter().any(|(command, _)| land.contains(command)),
            "{asked:?}"
        );
        for command in land {
            wire.acknowledge(command, MavResult::MAV_RESULT_DENIED);
        }
    }
}

#[test]
fn guided_takes_off_by_itself_before_it_is_given_set_points() {
    let (stabilize, guided) = (0, 4);
    let mut wire = Wire::new(Profile::ArduPilot);
    wire.heartbeat(stabilize, false);
    wire.ground(true);
    wire.link.set_mode(Mode::Offboard);
    assert!(commands(&wire.run(0.1)).contains(&(SET_MODE, [1.0, 4.0, 0.0])));
    wire.heartbeat(guided, false);
    assert!(commands(&wire.run(0.1)).contains(&(ARM, [1.0, 0.0, 0.0])));
    wire.heartbeat(guided, true);
    wire.link.send_setpoint(wire.now_s, [0.0, 0.0, 1.5].into());
    let sent = wire.run(0.1);
    let take_off = sent.iter().find_map(|message| match message {
        MavMessage::COMMAND_LONG(data) if data.command == MavCmd::MAV_CMD_NAV_TAKEOFF => Some(data.param7),
        _ => None,
    });
    assert_eq!(
        (take_off, setpoints(&sent), wire.link.mode()),
        (Some(0.8), 0, None)
    );
    wire.ground(false);
    wire.link.send_setpoint(wire.now_s, [0.0, 0.0, 1.5].into());
    let sent = wire.run(2.0);
    assert_eq!((setpoints(&sent), wire.link.mode()), (1, Some(Mode::Offboard)));
    assert!(
        commands(&sent)
            .iter()
            .all(|(command, _)| *command != MavCmd::MAV_CMD_NAV_TAKEOFF)
    );
}

#[test]
fn ardupilot_comes_down_by_its_own_modes_and_says_its_parameters_as_numbers() {
    let mut wire = Wire::new(Profile::ArduPilot);
    wire.heartbeat(0, false);
    // An integer parameter travels as a float's value, not as the bytes of an integer.
    let rule = Profile::ArduPilot.rules()[0].name;
    wire.say(&MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value: 3.0,
        param_count: 1,
        param_index: 0,
        param_id: rule.into(),
        param_type: MavParamType::MAV_PARAM_TYPE_INT8,
    }));
    assert_eq!(wire.link.telemetry().parameters[rule], 3.0);

    // In the air, in GUIDED: set-points go out, and only while it is there.
    wire.heartbeat(4, true);
    wire.ground(false);
    assert_eq!(wire.link.mode(), Some(Mode::Offboard));
    wire.sent();
    wire.link.send_setpoint(wire.now_s, [0.0, 0.0, 1.5].into());
    assert_eq!(setpoints(&wire.sent()), 1);

    // The abort ladder: BRAKE, which it may refuse, and LAND all the same.
    wire.link.set_mode(Mode::Hold);
    let asked = |messages: &[MavMessage], number: f32| {
        let set_mode =
            |(command, parameters): &(MavCmd, [f32; 3])| *command == SET_MODE && parameters[1] == number;
        commands(messages).iter().any(set_mode)
    };
    assert!(asked(&wire.run(0.1), 17.0), "BRAKE");
    for _ in 0..10 {
        wire.acknowledge(SET_MODE, MavResult::MAV_RESULT_FAILED);
    }
    wire.link.set_mode(Mode::Land);
    assert!(asked(&wire.run(0.1), 9.0), "LAND");
    wire.heartbeat(9, true);
    assert_eq!(wire.link.mode(), Some(Mode::Land));
    wire.ground(true);
    let on_the_ground = wire.run(10.0);
    assert!(
        commands(&on_the_ground).contains(&(ARM, [0.0, 0.0, 0.0])),
        "motors off"
    );
    assert!(!asked(&on_the_ground, 4.0) && setpoints(&on_the_ground) == 0);
}

#[test]
fn a_set_point_is_in_ned_with_the_mask_of_its_position() {
    let mut wire = Wire::new(Profile::Px4);
    wire.heartbeat(0, false);
    wire.sent();
    wire.link.send_setpoint(wire.now_s, [1.0, 2.0, 1.5].into());
    let sent = wire.sent();
    let [MavMessage::SET_POSITION_TARGET_LOCAL_NED(data)] = &sent[..] else {
        panic!("{sent:?}")
    };
    assert_eq!([data.x, data.y, data.z], [2.0, 1.0, -1.5]);
    assert_eq!(data.coordinate_frame, MavFrame::MAV_FRAME_LOCAL_NED);
    assert!(
        (data.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-6,
        "facing east"
    );
    assert_eq!((data.target_system, data.type_mask.bits()), (1, 0x9F8));
    assert_eq!([data.vx, data.vy, data.vz], [0.0; 3]);
}

#[test]
fn a_velocity_goes_along_in_ned_and_the_mask_says_so() {
    for profile in [Profile::Px4, Profile::ArduPilot] {
        let mut wire = Wire::new(profile);
        wire.heartbeat(0, false);
        wire.sent();
        let setpoint = Setpoint {
            position: [1.0, 2.0, 1.5],
            velocity: Some([0.5, -0.25, 0.125]),
        };
        wire.link.send_setpoint(wire.now_s, setpoint);
        let sent = wire.sent();
        let [MavMessage::SET_POSITION_TARGET_LOCAL_NED(data)] = &sent[..] else {
            panic!("{sent:?}")
        };
        assert_eq!([data.x, data.y, data.z], [2.0, 1.0, -1.5]);
        assert_eq!([data.vx, data.vy, data.vz], [-0.25, 0.5, -0.125]);
        assert_eq!([data.afx, data.afy, data.afz, data.yaw_rate], [0.0; 4]);
        assert_eq!(data.type_mask.bits(), 0x9C0);
    }
}

#[test]
fn landing_is_asked_for_as_a_mode_and_as_a_command() {
    let mut wire = Wire::new(Profile::Px4);
    wire.heartbeat(0, true);
    wire.link.set_mode(Mode::Land);
    let sent = wire.run(2.0 * REPEAT_S);
    let asked = commands(&sent).into_iter().map(|(command, _)| command);
    let land: Vec<MavCmd> = asked
        .filter(|command| [SET_MODE, MavCmd::MAV_CMD_NAV_LAND].contains(command))
        .collect();
    assert_eq!(land, [SET_MODE, MavCmd::MAV_CMD_NAV_LAND]);
    let place = sent.iter().find_map(|message| match message {
        MavMessage::COMMAND_LONG(data) if data.command == MavCmd::MAV_CMD_NAV_LAND => {
            Some([data.param5, data.param6])
        }
        _ => None,
    });
    assert!(
        place.unwrap().iter().all(|x| x.is_nan()),
        "here, not at 0° N 0° E"
    );
}

#[test]
fn vision_is_new_possible_and_near_or_not_sent() {
    let mut wire = Wire::new(Profile::Px4);
    let pose = |x: f64| Pose {
        position: [x, 0.0, 1.5],
        attitude: [1.0, 0.0, 0.0, 0.0],
    };
    let mut relayed = |pose: &Pose, captured_s: f64| {
        wire.link.send_vision(pose, captured_s, 8.0);
        wire.sent()
    };
    let sent = relayed(&pose(0.1), 10.0);
    let [MavMessage::ODOMETRY(data)] = &sent[..] else {
        panic!("{sent:?}")
    };
    assert_eq!(
        (data.time_usec, [data.x, data.y, data.z]),
        (10_000_000, [0.0, 0.1, -1.5])
    );
    assert!(data.vx.is_nan() && data.velocity_covariance[0].is_nan() && data.pose_covariance[0] > 0.0);
    assert_eq!(
        (data.frame_id, data.child_frame_id),
        (MavFrame::MAV_FRAME_LOCAL_FRD, MavFrame::MAV_FRAME_BODY_FRD)
    );
    assert!(relayed(&pose(0.1), 10.0).is_empty(), "the same again");
    assert!(relayed(&pose(f64::NAN), 10.02).is_empty());
    assert!(relayed(&pose(1.1), 10.02).is_empty(), "a metre in 20 ms");
    assert_eq!(relayed(&pose(0.2), 10.04).len(), 1);
}

#[test]
fn only_the_first_autopilot_of_the_right_make_is_listened_to() {
    let mut wire = Wire::new(Profile::Px4);
    wire.say(&heartbeat(MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, 4, true));
    assert_eq!(wire.link.telemetry().identity, None);
    wire.heartbeat(7, false);
    let mut stranger = Codec::new(
        Identity {
            system: 2,
            component: 1,
        },
        None,
    );
    wire.now_s += 1.0;
    let frame = stranger.encode(&heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4, 9, true));
    wire.link.receive(wire.now_s, &frame);
    let telemetry = wire.link.telemetry();
    assert_eq!(
        (telemetry.identity, telemetry.custom_mode, telemetry.heard_s),
        (Some(AUTOPILOT), 7, 100.0)
    );
}

#[test]
fn a_restart_shows_in_the_time_since_boot() {
    let mut wire = Wire::new(Profile::Px4);
    wire.heartbeat(0, false);
    let mut position = |time_boot_ms: u32| {
        wire.say(&MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            time_boot_ms,
            ..LOCAL_POSITION_NED_DATA::DEFAULT
        }));
        wire.link.telemetry().restarted
    };
    // A datagram that was overtaken by the next is no restart.
    assert_eq!(
        [50_000, 50_033, 50_000, 200].map(&mut position),
        [false, false, false, true]
    );
}
