//! Growth-rate control: end stops, slow-down before them, and the motor's duty.

use crate::limits::Limits;

/// How far the reference may run ahead of a measured length, m.
const MAX_LEAD_M: f32 = 0.003;
/// Duty per metre of lead: a quarter of full duty at the greatest lead.
const LEAD_GAIN: f32 = 80.0;

/// The rate that the end stops allow of `wanted_m_s` at `length_m`, m/s.
///
/// Within [`Limits::slow_down_m`] before a stop the rate falls linearly with the distance, down to
/// [`Limits::creep_m_s`]; at the stop and past it, only the way back is allowed. Without a length nothing moves.
pub fn allowed_rate(limits: &Limits, length_m: Option<f32>, wanted_m_s: f32) -> f32 {
    let Some(length_m) = length_m else { return 0.0 };
    let distance = if wanted_m_s > 0.0 {
        limits.max_length_m - length_m
    } else {
        length_m - limits.min_length_m
    };
    if distance <= 0.0 || distance.is_nan() {
        return 0.0;
    }
    let fastest = (limits.max_growth_rate_m_s * distance / limits.slow_down_m)
        .clamp(limits.creep_m_s, limits.max_growth_rate_m_s);
    wanted_m_s.clamp(-fastest, fastest)
}

/// The motor's controller.
///
/// Feed-forward `duty = rate / full_duty_rate`; where the length is measured, a reference that grows at the rate is
/// tracked as well, `duty += 80 m⁻¹ · (reference − length)`, so that a loaded motor keeps the rate. The correction never
/// turns the motor against the command.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Growth {
    /// Length that a motor keeping the rate would have reached, m; `None` at rest.
    reference_m: Option<f32>,
}

impl Growth {
    /// The duty, −1 to 1, that drives the arm at `rate_m_s` (as [allowed](allowed_rate)) for the next `dt_s`.
    pub fn duty(&mut self, limits: &Limits, dt_s: f32, rate_m_s: f32, measured_m: Option<f32>) -> f32 {
        if rate_m_s == 0.0 {
            self.reference_m = None;
            return 0.0;
        }
        let lead = match measured_m {
            Some(length_m) => {
                let reference = self.reference_m.unwrap_or(length_m) + rate_m_s * dt_s;
                let lead = (reference - length_m).clamp(-MAX_LEAD_M, MAX_LEAD_M);
                self.reference_m = Some(length_m + lead);
                lead
            }
            None => 0.0,
        };
        let duty = rate_m_s / limits.full_duty_rate_m_s + LEAD_GAIN * lead;
        if rate_m_s > 0.0 {
            duty.clamp(0.0, 1.0)
        } else {
            duty.clamp(-1.0, 0.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_slows_down_and_stops_at_the_ends() {
        let limits = Limits::default();
        let at = |length_m, rate| allowed_rate(&limits, Some(length_m), rate);
        assert_eq!(at(0.8, 0.02), 0.02);
        assert_eq!(at(0.8, -0.02), -0.02);
        assert!((at(1.09, 0.02) - 0.01).abs() < 1e-6);
        assert!((at(0.61, -0.02) + 0.01).abs() < 1e-6);
        assert_eq!(at(1.0999, 0.02), limits.creep_m_s);
        assert_eq!(at(1.0999, 0.0005), 0.0005);
        assert_eq!(at(1.1, 0.02), 0.0);
        assert_eq!(at(1.2, 0.02), 0.0);
        assert_eq!(at(1.2, -0.02), -0.02);
        assert_eq!(at(0.5, -0.02), 0.0);
        assert_eq!(allowed_rate(&limits, None, 0.02), 0.0);
        assert_eq!(at(f32::NAN, 0.02), 0.0);
    }

    #[test]
    fn a_loaded_motor_keeps_the_rate() {
        // The motor turns at 80 % of its unloaded speed.
        let limits = Limits::default();
        let (mut growth, mut length) = (Growth::default(), 0.7);
        for _ in 0..2000 {
            let duty = growth.duty(&limits, 0.005, 0.01, Some(length));
            length += 0.005 * 0.8 * limits.full_duty_rate_m_s * duty;
        }
        // 10 s at 1 cm/s, less the lead that holds the duty up, 0.125 / 80, as it is after a step.
        let expected = 0.8 - 0.125 / LEAD_GAIN + 0.01 * 0.005;
        assert!((length - expected).abs() < 3e-5, "{length}");
    }

    #[test]
    fn the_correction_never_reverses() {
        let limits = Limits::default();
        let mut growth = Growth::default();
        growth.duty(&limits, 0.005, 0.001, Some(0.7));
        // The length has jumped ahead of the reference.
        assert_eq!(growth.duty(&limits, 0.005, 0.001, Some(0.8)), 0.0);
    }
}
