//! What differs between autopilots.

use flyvine::link::Mode;
use mavlink::dialects::common::{MavAutopilot, PositionTargetTypemask};

use super::parameters::{ARDUPILOT_RULES, PX4_RULES, ParameterRule};

/// Which autopilot flies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Profile {
    /// PX4, flown in OFFBOARD.
    #[default]
    Px4,
    /// ArduPilot Copter, flown in GUIDED.
    ArduPilot,
}

/// `custom_mode` of PX4: main mode and, within AUTO, sub-mode (`px4_custom_mode.h`).
pub mod px4_mode {
    /// AUTO, the main mode that has sub-modes.
    pub const AUTO: u8 = 4;
    /// OFFBOARD.
    pub const OFFBOARD: u8 = 6;
    /// POSCTL: the pilot's sticks.
    pub const POSCTL: u8 = 3;
    /// AUTO.LOITER, called Hold.
    pub const LOITER: u8 = 3;
    /// AUTO.LAND.
    pub const LAND: u8 = 6;

    /// The word in a heartbeat.
    pub fn custom(main: u8, sub: u8) -> u32 {
        u32::from(main) << 16 | u32::from(sub) << 24
    }
}

/// `custom_mode` of ArduPilot Copter.
mod copter_mode {
    pub const GUIDED: u32 = 4;
    pub const LAND: u32 = 9;
    pub const BRAKE: u32 = 17;
}

impl Profile {
    /// What the autopilot calls itself in its heartbeat.
    pub fn autopilot(self) -> MavAutopilot {
        match self {
            Profile::Px4 => MavAutopilot::MAV_AUTOPILOT_PX4,
            Profile::ArduPilot => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        }
    }

    /// Our word for a heartbeat's `custom_mode`; `None` for a mode that a flight never asks for.
    pub fn mode(self, custom_mode: u32) -> Option<Mode> {
        use px4_mode::{AUTO, LAND, LOITER, OFFBOARD, custom};
        match self {
            Profile::Px4 if custom_mode == custom(OFFBOARD, 0) => Some(Mode::Offboard),
            Profile::Px4 if custom_mode == custom(AUTO, LOITER) => Some(Mode::Hold),
            Profile::Px4 if custom_mode == custom(AUTO, LAND) => Some(Mode::Land),
            Profile::ArduPilot if custom_mode == copter_mode::GUIDED => Some(Mode::Offboard),
            Profile::ArduPilot if custom_mode == copter_mode::BRAKE => Some(Mode::Hold),
            Profile::ArduPilot if custom_mode == copter_mode::LAND => Some(Mode::Land),
            _ => None,
        }
    }

    /// Second and third parameter of MAV_CMD_DO_SET_MODE; none for standing by, which is no mode.
    pub fn mode_parameters(self, mode: Mode) -> Option<[f32; 2]> {
        use px4_mode::{AUTO, LAND, LOITER, OFFBOARD};
        let px4 = |main: u8, sub: u8| [f32::from(main), f32::from(sub)];
        let copter = |mode: u32| [mode as f32, 0.0];
        Some(match (self, mode) {
            (_, Mode::Standby) => return None,
            (Profile::Px4, Mode::Offboard) => px4(OFFBOARD, 0),
            (Profile::Px4, Mode::Hold) => px4(AUTO, LOITER),
            (Profile::Px4, Mode::Land) => px4(AUTO, LAND),
            (Profile::ArduPilot, Mode::Offboard) => copter(copter_mode::GUIDED),
            (Profile::ArduPilot, Mode::Hold) => copter(copter_mode::BRAKE),
            (Profile::ArduPilot, Mode::Land) => copter(copter_mode::LAND),
        })
    }

    /// The mode's name, for messages.
    pub fn mode_name(self, mode: Mode) -> &'static str {
        match (self, mode) {
            (_, Mode::Standby) => "stand by",
            (Profile::Px4, Mode::Offboard) => "OFFBOARD",
            (Profile::Px4, Mode::Hold) => "AUTO.LOITER",
            (Profile::Px4, Mode::Land) => "AUTO.LAND",
            (Profile::ArduPilot, Mode::Offboard) => "GUIDED",
            (Profile::ArduPilot, Mode::Hold) => "BRAKE",
            (Profile::ArduPilot, Mode::Land) => "LAND",
        }
    }

    /// Fields of a set-point that the autopilot shall ignore: all but position and yaw, and velocity where one is sent. The
    /// ignored fields are zero: it is the mask that counts, and a NaN is refused by some versions.
    pub fn setpoint_mask(self, with_velocity: bool) -> PositionTargetTypemask {
        use PositionTargetTypemask as Mask;
        let velocity = Mask::POSITION_TARGET_TYPEMASK_VX_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_VY_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_VZ_IGNORE;
        let others = Mask::POSITION_TARGET_TYPEMASK_AX_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_AY_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_AZ_IGNORE
            | Mask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE;
        if with_velocity { others } else { velocity | others }
    }

    /// Height of a take-off command that must come before set-points, m above the ground: GUIDED ignores set-points on the
    /// ground, OFFBOARD climbs after them.
    pub fn take_off_height_m(self) -> Option<f64> {
        match self {
            Profile::Px4 => None,
            Profile::ArduPilot => Some(0.8),
        }
    }

    /// Whether integer parameters travel as the bytes of an integer in the float's place, or as a float's value.
    pub fn parameters_are_bytewise(self) -> bool {
        self == Profile::Px4
    }

    /// The parameters that matter.
    pub fn rules(self) -> &'static [ParameterRule] {
        match self {
            Profile::Px4 => PX4_RULES,
            Profile::ArduPilot => ARDUPILOT_RULES,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mode_that_is_asked_for_is_known_when_it_comes_back() {
        for mode in [Mode::Offboard, Mode::Hold, Mode::Land] {
            let [main, sub] = Profile::Px4.mode_parameters(mode).unwrap();
            assert_eq!(
                Profile::Px4.mode(px4_mode::custom(main as u8, sub as u8)),
                Some(mode)
            );
            let [number, _] = Profile::ArduPilot.mode_parameters(mode).unwrap();
            assert_eq!(Profile::ArduPilot.mode(number as u32), Some(mode));
        }
        assert_eq!(Profile::Px4.mode(px4_mode::custom(px4_mode::POSCTL, 0)), None);
    }

    #[test]
    fn the_mask_is_the_one_that_ground_stations_send() {
        assert_eq!(Profile::Px4.setpoint_mask(false).bits(), 0x9F8);
        assert_eq!(Profile::Px4.setpoint_mask(true).bits(), 0x9C0);
    }
}
