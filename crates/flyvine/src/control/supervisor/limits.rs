//! The numbers behind the rules of flight.

use serde::{Deserialize, Serialize};

/// Where the vehicle may be, m, world frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Room {
    /// Quadrotor and end effector, x from, to.
    pub x_m: [f64; 2],
    /// Quadrotor and end effector, y from, to.
    pub y_m: [f64; 2],
    /// Quadrotor, z from, to.
    pub quadrotor_z_m: [f64; 2],
    /// Lowest z of the end effector.
    pub end_effector_z_min_m: f64,
}

impl Default for Room {
    fn default() -> Self {
        Self {
            x_m: [-2.2, 2.2],
            y_m: [-2.2, 2.2],
            quadrotor_z_m: [0.8, 2.4],
            end_effector_z_min_m: 0.15,
        }
    }
}

impl Room {
    /// The three intervals of the quadrotor's position.
    fn quadrotor(&self) -> [[f64; 2]; 3] {
        [self.x_m, self.y_m, self.quadrotor_z_m]
    }

    /// Whether the quadrotor may be at `position`; false for NaN.
    pub fn holds_quadrotor(&self, position: [f64; 3]) -> bool {
        let inside = |(x, [from, to]): (f64, [f64; 2])| from <= x && x <= to;
        position.into_iter().zip(self.quadrotor()).all(inside)
    }

    /// Whether the end effector may be at `position`; false for NaN.
    pub fn holds_end_effector(&self, position: [f64; 3]) -> bool {
        let inside = |x: f64, [from, to]: [f64; 2]| from <= x && x <= to;
        inside(position[0], self.x_m)
            && inside(position[1], self.y_m)
            && position[2] >= self.end_effector_z_min_m
    }

    /// The same room without a floor, for a vehicle on its way up from the ground or down to it.
    pub(super) fn without_floor(&self) -> Self {
        Self {
            quadrotor_z_m: [f64::NEG_INFINITY, self.quadrotor_z_m[1]],
            end_effector_z_min_m: f64::NEG_INFINITY,
            ..*self
        }
    }

    /// The quadrotor position nearest to a finite `position`.
    pub fn clip(&self, position: [f64; 3]) -> [f64; 3] {
        let intervals = self.quadrotor();
        std::array::from_fn(|axis| position[axis].clamp(intervals[axis][0], intervals[axis][1]))
    }
}

/// Limits of the supervisor; the defaults are the rules of flight. In a vehicle's TOML every key is optional.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Where the vehicle may be.
    pub room: Room,
    /// A pose older than this is stale: say so and coast, s.
    pub coast_age_s: f64,
    /// A pose older than this is an abort, s.
    pub abort_age_s: f64,
    /// How much farther than the arm's length the end effector may be from the quadrotor, m.
    pub reach_margin_m: f64,
    /// A quadrotor pose that would need more than this speed is a jump, m/s.
    pub quadrotor_speed_max_m_s: f64,
    /// An end-effector position that would need more than this speed is a jump, m/s.
    pub end_effector_speed_max_m_s: f64,
    /// Fastest velocity that goes with a commanded position, m/s.
    pub command_speed_max_m_s: f64,
    /// Longest silence of the autopilot, s; none where no autopilot is heard, as in lockstep.
    pub autopilot_silence_s: Option<f64>,
    /// Longest silence of the arm, s; none where no arm is heard, as in lockstep.
    pub arm_silence_s: Option<f64>,
    /// After an abort: how long to hold in place with the stream alive before the autopilot's Hold, s.
    pub hold_s: f64,
    /// How long the autopilot holds before Land, s.
    pub autopilot_hold_s: f64,
    /// Longest landing before the stream stops, s.
    pub landing_s: f64,
    /// Longest way from arming to the start, s.
    pub climb_s: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            room: Room::default(),
            coast_age_s: 0.1,
            abort_age_s: 0.4,
            reach_margin_m: 0.1,
            quadrotor_speed_max_m_s: 8.0,
            end_effector_speed_max_m_s: 12.0,
            command_speed_max_m_s: 6.0,
            autopilot_silence_s: None,
            arm_silence_s: None,
            hold_s: 2.0,
            autopilot_hold_s: 5.0,
            landing_s: 20.0,
            climb_s: 20.0,
        }
    }
}

/// Limits that do not make sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key}: found {found}; expected {expected}")]
pub struct LimitsError {
    /// Key of the limit.
    pub key: &'static str,
    /// Its value.
    pub found: String,
    /// What it must be.
    pub expected: &'static str,
}

impl Limits {
    pub(super) fn validate(&self) -> Result<(), LimitsError> {
        for (key, [from, to]) in [
            ("room.x_m", self.room.x_m),
            ("room.y_m", self.room.y_m),
            ("room.quadrotor_z_m", self.room.quadrotor_z_m),
        ] {
            if !(from.is_finite() && to.is_finite() && from < to) {
                let expected = "two finite numbers, the first the smaller";
                return Err(LimitsError {
                    key,
                    found: format!("[{from}, {to}]"),
                    expected,
                });
            }
        }
        if !self.room.end_effector_z_min_m.is_finite() {
            return Err(LimitsError {
                key: "room.end_effector_z_min_m",
                found: self.room.end_effector_z_min_m.to_string(),
                expected: "a finite number",
            });
        }
        for (key, value) in [
            ("coast_age_s", Some(self.coast_age_s)),
            ("abort_age_s", Some(self.abort_age_s)),
            ("reach_margin_m", Some(self.reach_margin_m)),
            ("quadrotor_speed_max_m_s", Some(self.quadrotor_speed_max_m_s)),
            (
                "end_effector_speed_max_m_s",
                Some(self.end_effector_speed_max_m_s),
            ),
            ("command_speed_max_m_s", Some(self.command_speed_max_m_s)),
            ("autopilot_silence_s", self.autopilot_silence_s),
            ("arm_silence_s", self.arm_silence_s),
            ("hold_s", Some(self.hold_s)),
            ("autopilot_hold_s", Some(self.autopilot_hold_s)),
            ("landing_s", Some(self.landing_s)),
            ("climb_s", Some(self.climb_s)),
        ] {
            if value.is_some_and(|value| !(value.is_finite() && value > 0.0)) {
                let found = value.unwrap_or_default().to_string();
                return Err(LimitsError {
                    key,
                    found,
                    expected: "a finite number above 0",
                });
            }
        }
        if self.coast_age_s > self.abort_age_s {
            let found = self.coast_age_s.to_string();
            return Err(LimitsError {
                key: "coast_age_s",
                found,
                expected: "no more than abort_age_s",
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_toml_may_change_one_of_them() {
        Limits::default().validate().unwrap();
        let limits: Limits = toml::from_str("hold_s = 3.0\n[room]\nx_m = [-1.0, 4.0]").unwrap();
        let room = Room {
            x_m: [-1.0, 4.0],
            ..Room::default()
        };
        assert_eq!(
            limits,
            Limits {
                hold_s: 3.0,
                room,
                ..Limits::default()
            }
        );
        toml::from_str::<Limits>("hold = 3.0").unwrap_err();
    }

    #[test]
    fn each_bad_limit_is_named() {
        let refused = |toml: &str| {
            toml::from_str::<Limits>(toml)
                .unwrap()
                .validate()
                .unwrap_err()
                .key
        };
        assert_eq!(refused("room = { x_m = [1.0, -1.0] }"), "room.x_m");
        assert_eq!(
            refused("room = { quadrotor_z_m = [nan, 2.0] }"),
            "room.quadrotor_z_m"
        );
        assert_eq!(
            refused("room = { end_effector_z_min_m = inf }"),
            "room.end_effector_z_min_m"
        );
        assert_eq!(refused("coast_age_s = 0.5"), "coast_age_s");
        assert_eq!(refused("abort_age_s = nan"), "abort_age_s");
        assert_eq!(refused("hold_s = -1.0"), "hold_s");
        assert_eq!(refused("command_speed_max_m_s = inf"), "command_speed_max_m_s");
        assert_eq!(refused("arm_silence_s = 0.0"), "arm_silence_s");
    }
}
