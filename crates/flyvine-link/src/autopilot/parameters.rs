//! The autopilot's parameters that a flight by motion capture depends on: what each must be, and why.

use std::fmt;

use mavlink::dialects::common::{MavParamType, PARAM_VALUE_DATA};

use super::checklist::Weight;

/// What a parameter must be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// One of these.
    OneOf(&'static [f64]),
    /// From, to.
    Range(f64, f64),
    /// An integer with all of these bits.
    Bits(u32),
}

impl Expected {
    /// Whether `value` is as expected; never of a NaN.
    pub fn holds(self, value: f64) -> bool {
        match self {
            Expected::OneOf(values) => values.contains(&value),
            Expected::Range(from, to) => from <= value && value <= to,
            Expected::Bits(bits) => {
                value >= 0.0 && value <= f64::from(u32::MAX) && value as u32 & bits == bits
            }
        }
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Expected::OneOf(values) => {
                let values: Vec<String> = values.iter().map(f64::to_string).collect();
                f.write_str(&values.join(" or "))
            }
            Expected::Range(from, to) => write!(f, "{from} to {to}"),
            Expected::Bits(bits) => write!(f, "bits {bits} set"),
        }
    }
}

/// One parameter, what it must be, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterRule {
    /// Its name.
    pub name: &'static str,
    /// What it must be.
    pub expected: Expected,
    /// Whether a flight without it is refused or warned about.
    pub weight: Weight,
    /// Why it matters.
    pub why: &'static str,
}

const fn must(name: &'static str, expected: Expected, why: &'static str) -> ParameterRule {
    let weight = Weight::Blocking;
    ParameterRule {
        name,
        expected,
        weight,
        why,
    }
}

const fn should(name: &'static str, expected: Expected, why: &'static str) -> ParameterRule {
    let weight = Weight::Warning;
    ParameterRule {
        name,
        expected,
        weight,
        why,
    }
}

/// PX4 (docs.px4.io: external position estimation, parameter reference, safety).
pub const PX4_RULES: &[ParameterRule] = &[
    must(
        "EKF2_EV_CTRL",
        Expected::Bits(0b1011),
        "external vision must be fused in horizontal position (1), height (2) and yaw (8): indoors there is nothing else",
    ),
    must(
        "EKF2_HGT_REF",
        Expected::OneOf(&[3.0]),
        "height must come from vision (3): a barometer drifts by decimetres in a room",
    ),
    must(
        "EKF2_EV_DELAY",
        Expected::Range(0.0, 100.0),
        "the age that the filter gives to vision, ms: a wrong one shows as overshoot in fast flight",
    ),
    must(
        "COM_OF_LOSS_T",
        Expected::Range(0.05, 1.0),
        "how long the autopilot flies on after the last set-point, s: this is what catches a dead base station",
    ),
    must(
        "COM_OBL_RC_ACT",
        Expected::OneOf(&[4.0, 5.0]),
        "what it does then: Land (4) or Hold (5); the others need a pilot's sticks or a global position",
    ),
    should(
        "EKF2_GPS_CTRL",
        Expected::OneOf(&[0.0]),
        "a satellite position found by a window pulls the vehicle away from motion capture",
    ),
    should(
        "EKF2_MAG_TYPE",
        Expected::OneOf(&[5.0]),
        "a compass among steel and motors disagrees with the yaw from vision",
    ),
    should(
        "EKF2_NOAID_TOUT",
        Expected::Range(0.0, 1_000_000.0),
        "how long the filter believes itself without vision, µs: the default of 5 s is a wall away",
    ),
    should(
        "COM_RC_OVERRIDE",
        Expected::Bits(0b10),
        "the pilot's sticks must take the vehicle out of OFFBOARD (2)",
    ),
    should(
        "COM_ARM_WO_GPS",
        Expected::OneOf(&[1.0, 2.0]),
        "without it a vehicle without satellites does not arm",
    ),
];

/// ArduPilot Copter 4.x (ardupilot.org: non-GPS navigation, GUIDED mode).
pub const ARDUPILOT_RULES: &[ParameterRule] = &[
    must(
        "VISO_TYPE",
        Expected::OneOf(&[1.0]),
        "vision must come over MAVLink (1), or the poses are thrown away",
    ),
    must(
        "EK3_SRC1_POSXY",
        Expected::OneOf(&[6.0]),
        "horizontal position must come from external navigation (6): indoors there is nothing else",
    ),
    must(
        "EK3_SRC1_POSZ",
        Expected::OneOf(&[6.0]),
        "height must come from external navigation (6): a barometer drifts by decimetres in a room",
    ),
    must(
        "EK3_SRC1_YAW",
        Expected::OneOf(&[6.0]),
        "yaw must come from external navigation (6): compasses fail among steel and motors",
    ),
    should(
        "GUID_TIMEOUT",
        Expected::Range(0.1, 1.0),
        "how long GUIDED flies on after the last set-point, s: the default of 3 s is a wall away",
    ),
    should(
        "FS_GCS_ENABLE",
        Expected::OneOf(&[5.0]),
        "land (5) when the base station dies; 0 does nothing",
    ),
];

/// The value in a PARAM_VALUE.
pub fn value(data: &PARAM_VALUE_DATA, bytewise: bool) -> f64 {
    let bits = data.param_value.to_bits();
    if !bytewise {
        return f64::from(data.param_value);
    }
    match data.param_type {
        MavParamType::MAV_PARAM_TYPE_INT32 => f64::from(bits as i32),
        MavParamType::MAV_PARAM_TYPE_UINT32 => f64::from(bits),
        MavParamType::MAV_PARAM_TYPE_INT16 => f64::from(bits as i16),
        MavParamType::MAV_PARAM_TYPE_UINT16 => f64::from(bits as u16),
        MavParamType::MAV_PARAM_TYPE_INT8 => f64::from(bits as i8),
        MavParamType::MAV_PARAM_TYPE_UINT8 => f64::from(bits as u8),
        _ => f64::from(data.param_value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expectations_refuse_nan_and_missing_bits() {
        for expected in [
            Expected::Bits(3),
            Expected::Range(0.0, 1.0),
            Expected::OneOf(&[1.0]),
        ] {
            assert!(!expected.holds(f64::NAN), "{expected}");
        }
        assert!(
            Expected::Bits(11).holds(15.0)
                && !Expected::Bits(11).holds(3.0)
                && !Expected::Bits(1).holds(-1.0)
        );
    }

    #[test]
    fn integers_travel_as_their_bytes_or_as_a_value() {
        let mut data = PARAM_VALUE_DATA {
            param_value: f32::from_bits((-7_i32).cast_unsigned()),
            param_type: MavParamType::MAV_PARAM_TYPE_INT32,
            ..PARAM_VALUE_DATA::DEFAULT
        };
        assert_eq!(value(&data, true), -7.0);
        data.param_value = 3.0;
        assert_eq!(value(&data, false), 3.0);
        data.param_type = MavParamType::MAV_PARAM_TYPE_REAL32;
        assert_eq!(value(&data, true), 3.0);
    }

    #[test]
    fn names_fit_their_field() {
        for rule in PX4_RULES.iter().chain(ARDUPILOT_RULES) {
            assert!(rule.name.len() <= 16, "{}", rule.name);
        }
    }
}
