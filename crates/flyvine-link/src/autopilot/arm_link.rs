//! What the link needs of the arm: two numbers out, how it is back.

use flyvine::DT;
use flyvine::flight::Configuration;

/// What the arm's controller says of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmTelemetry {
    /// When it was last heard, s on the link's clock.
    pub heard_s: f64,
    /// Length from its own estimate, m; `None` of an arm that has none.
    pub length_m: Option<f64>,
    /// Its own number for what is wrong with it.
    pub fault: Option<u8>,
}

/// The line to the arm.
pub trait ArmLink {
    /// Sends the growth rate, m/s (signed), and the pressure set-point, kPa gauge.
    fn command(&mut self, now_s: f64, growth_m_s: f64, pressure_kpa: f64);

    /// The newest telemetry; `None` of an arm that never answers. It never waits.
    fn telemetry(&mut self, now_s: f64) -> Option<ArmTelemetry>;
}

/// No arm on the wire: one that is set by hand, or that another program drives.
pub struct NoArm;

impl ArmLink for NoArm {
    fn command(&mut self, _now_s: f64, _growth_m_s: f64, _pressure_kpa: f64) {}

    fn telemetry(&mut self, _now_s: f64) -> Option<ArmTelemetry> {
        None
    }
}

/// Fastest growth, m/s.
pub const GROWTH_MAX_M_S: f64 = 0.02;
/// Time in which an error of the length is taken back, s.
const LENGTH_TIME_S: f64 = 0.5;
/// An error of the length that is left alone, m.
const LENGTH_DEADBAND_M: f64 = 0.002;

/// The growth rate that takes the arm from the configuration it is told now to the next one, and what its measured length
/// lacks: `ṡ = (l⁺ − l) / dt + (l − l_measured) / T`, within ± 2 cm/s.
pub fn growth_rate(now: Configuration, next: Configuration, measured_m: Option<f64>) -> f64 {
    let planned = (next.length_m - now.length_m) / DT;
    let error_m = measured_m.map_or(0.0, |measured_m| now.length_m - measured_m);
    let correction = match error_m.abs() > LENGTH_DEADBAND_M {
        true => error_m / LENGTH_TIME_S,
        false => 0.0,
    };
    let rate = planned + correction;
    match rate.is_finite() {
        true => rate.clamp(-GROWTH_MAX_M_S, GROWTH_MAX_M_S),
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_follows_the_plan_and_what_is_missing_within_its_limit() {
        let at = |length_m| Configuration {
            length_m,
            pressure_kpa: 0.0,
        };
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(near(growth_rate(at(0.7), at(0.7005), Some(0.7)), 0.01));
        assert!(near(growth_rate(at(0.7), at(0.7005), Some(0.696)), 0.018));
        assert!(near(growth_rate(at(0.7), at(0.7), Some(0.9)), -GROWTH_MAX_M_S));
        assert_eq!(growth_rate(at(0.7), at(0.7), None), 0.0);
        assert_eq!(growth_rate(at(0.7), at(0.7), Some(f64::NAN)), 0.0);
    }
}
