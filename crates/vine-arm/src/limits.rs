//! What the arm may do. The defaults are the prototype's.

/// Limits and constants of one arm.
///
/// Defaults from the paper, Sec. II-A (growth rate, pumps, spool) where it gives a figure; the others are chosen, and
/// say so.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Greatest growth rate either way, m/s (paper: approximately 2 cm/s).
    pub max_growth_rate_m_s: f32,
    /// Growth rate of the unloaded motor at full duty, m/s (paper: the greatest rate is the motor's).
    pub full_duty_rate_m_s: f32,
    /// End stop inwards, m (chosen: 0.5 m of spooled material (paper) reach around the lengths that were flown).
    pub min_length_m: f32,
    /// End stop outwards, m.
    pub max_length_m: f32,
    /// Distance before an end stop over which growth slows down, m (chosen).
    pub slow_down_m: f32,
    /// Slowest rate while slowing down, m/s (chosen): the stop is reached, not approached for ever.
    pub creep_m_s: f32,
    /// Greatest pressure set-point, kPa gauge (chosen: five times what was flown); above it the arm does not retract,
    /// which would compress the air further.
    pub max_pressure_kpa: f32,
    /// Pressure at which everything stops, kPa gauge (chosen).
    pub over_pressure_kpa: f32,
    /// The pumps start below the set-point minus this and stop above the set-point plus this, kPa (chosen).
    pub hysteresis_kpa: f32,
    /// Shortest run of the pumps or the vent, s (chosen; stopping for safety does not wait).
    pub min_on_s: f32,
    /// Shortest rest between two runs of the pumps, or of the vent, s (chosen: a tube that grows at the paper's deployment's
    /// 1.5 cm/s takes up 0.17 kPa in 0.1 s without pumps, and a hysteresis' worth in this).
    pub min_off_s: f32,
    /// Shortest rest between pumps and vent, s (chosen).
    pub changeover_s: f32,
    /// Longest run of the pumps without reaching the set-point, s (chosen: filling a limp tube of 1 m takes 50 s).
    pub pump_timeout_s: f32,
    /// Whether there is a vent valve or a deflating pump. The prototype has none: it leaks.
    pub has_vent: bool,
    /// Commanded travel after which a spool that has not followed counts as stalled, m (chosen).
    pub stall_travel_m: f32,
    /// Silence after which motor and pumps stop, s. Below the 0.3 s that the base station relies on, so that a control
    /// loop a few steps late still keeps to them.
    pub watchdog_s: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            max_growth_rate_m_s: 0.02,
            full_duty_rate_m_s: 0.02,
            min_length_m: 0.6,
            max_length_m: 1.1,
            slow_down_m: 0.02,
            creep_m_s: 0.001,
            max_pressure_kpa: 2.0,
            over_pressure_kpa: 2.5,
            hysteresis_kpa: 0.02,
            min_on_s: 0.02,
            min_off_s: 0.02,
            changeover_s: 0.1,
            pump_timeout_s: 90.0,
            has_vent: false,
            stall_travel_m: 0.01,
            watchdog_s: 0.25,
        }
    }
}

/// A limit that is not one.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{name} is {found}; expected more than {above} and at most {at_most}")]
pub struct LimitsError {
    /// The field.
    pub name: &'static str,
    /// Its value.
    pub found: f32,
    /// It must be more than this.
    pub above: f32,
    /// And at most this.
    pub at_most: f32,
}

impl Limits {
    /// Checks every field; NaN fails every check.
    pub fn validate(&self) -> Result<(), LimitsError> {
        let check = |name, found: f32, above, at_most| {
            if found > above && found <= at_most {
                Ok(())
            } else {
                Err(LimitsError {
                    name,
                    found,
                    above,
                    at_most,
                })
            }
        };
        check("max_growth_rate_m_s", self.max_growth_rate_m_s, 0.0, 1.0)?;
        check("full_duty_rate_m_s", self.full_duty_rate_m_s, 0.0, 1.0)?;
        check("min_length_m", self.min_length_m, 0.0, 100.0)?;
        check("max_length_m", self.max_length_m, self.min_length_m, 100.0)?;
        check(
            "slow_down_m",
            self.slow_down_m,
            0.0,
            self.max_length_m - self.min_length_m,
        )?;
        check("creep_m_s", self.creep_m_s, 0.0, self.max_growth_rate_m_s)?;
        check("max_pressure_kpa", self.max_pressure_kpa, 0.0, 100.0)?;
        check(
            "over_pressure_kpa",
            self.over_pressure_kpa,
            self.max_pressure_kpa,
            200.0,
        )?;
        check(
            "hysteresis_kpa",
            self.hysteresis_kpa,
            0.0,
            self.over_pressure_kpa - self.max_pressure_kpa,
        )?;
        check("min_on_s", self.min_on_s, 0.0, 10.0)?;
        check("min_off_s", self.min_off_s, 0.0, 10.0)?;
        check("changeover_s", self.changeover_s, 0.0, 10.0)?;
        check("pump_timeout_s", self.pump_timeout_s, self.min_on_s, 3600.0)?;
        check("stall_travel_m", self.stall_travel_m, 0.0, 1.0)?;
        check("watchdog_s", self.watchdog_s, 0.0, 0.3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_prototype_is_possible() {
        Limits::default().validate().unwrap();
    }

    #[test]
    fn impossible_limits_are_named() {
        let spoilt = |spoil: fn(&mut Limits)| {
            let mut limits = Limits::default();
            spoil(&mut limits);
            limits.validate().unwrap_err().name
        };
        assert_eq!(
            spoilt(|l| l.max_growth_rate_m_s = f32::NAN),
            "max_growth_rate_m_s"
        );
        assert_eq!(spoilt(|l| l.max_length_m = 0.5), "max_length_m");
        assert_eq!(spoilt(|l| l.over_pressure_kpa = 2.0), "over_pressure_kpa");
        assert_eq!(spoilt(|l| l.watchdog_s = 0.5), "watchdog_s");
        assert_eq!(spoilt(|l| l.pump_timeout_s = f32::INFINITY), "pump_timeout_s");
    }
}
