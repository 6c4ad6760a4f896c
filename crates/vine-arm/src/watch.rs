//! What tells a fault: readings that cannot be, and a spool that does not follow its motor.

use crate::controller::Sensors;
use crate::limits::Limits;
use crate::state::Fault;

/// How far outside the end stops a length can be read at all, m: a spool goes a little past them by hand.
const LENGTH_MARGIN_M: f32 = 0.2;
/// Greatest change of the length between two readings, beyond what the motor can do, m.
const LENGTH_JUMP_M: f32 = 0.02;
/// Gauge pressures below this are a broken sensor, kPa.
const LEAST_PRESSURE_KPA: f32 = -5.0;
/// Share of the commanded travel that a healthy spool covers at least.
const LEAST_FOLLOWED: f32 = 0.2;

/// Watches the readings of one arm. A sensor that was there once must stay there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct SensorWatch {
    has_length: bool,
    has_pressure: bool,
    /// The last possible length, m.
    last_length_m: Option<f32>,
    now: Sensors,
}

impl SensorWatch {
    /// The fault that `sensors` show, `dt_s` after the last ones.
    pub(crate) fn check(&mut self, limits: &Limits, dt_s: f32, sensors: Sensors) -> Option<Fault> {
        self.now = sensors;
        self.has_length |= sensors.length_m.is_some();
        self.has_pressure |= sensors.pressure_kpa.is_some();
        let last_length_m = self.last_length_m;
        if self.length_is_possible(limits) {
            self.last_length_m = sensors.length_m;
        }
        if !self.pressure_is_possible(limits) {
            return Some(Fault::PressureSensor);
        }
        if sensors
            .pressure_kpa
            .is_some_and(|pressure| pressure > limits.over_pressure_kpa)
        {
            return Some(Fault::OverPressure);
        }
        let farthest = LENGTH_JUMP_M + 2.0 * limits.max_growth_rate_m_s * dt_s;
        let jumped = match (last_length_m, sensors.length_m) {
            (Some(last), Some(now)) => (now - last).abs() > farthest,
            _ => false,
        };
        (jumped || !self.length_is_possible(limits)).then_some(Fault::LengthSensor)
    }

    /// Whether the newest readings are good enough to leave `fault`.
    pub(crate) fn has_gone(&self, limits: &Limits, fault: Fault) -> bool {
        match fault {
            Fault::OverPressure => self
                .now
                .pressure_kpa
                .is_none_or(|pressure| pressure <= limits.max_pressure_kpa),
            Fault::PressureSensor => self.pressure_is_possible(limits),
            Fault::LengthSensor => self.length_is_possible(limits),
            Fault::MotorStalled | Fault::PumpsIneffective | Fault::Clock => true,
        }
    }

    /// The newest length if it is measured and possible, m.
    pub(crate) fn length_m(&self, limits: &Limits) -> Option<f32> {
        self.now.length_m.filter(|_| self.length_is_possible(limits))
    }

    /// Whether this arm measures its length.
    pub(crate) fn measures_length(&self) -> bool {
        self.has_length
    }

    // NaN is in no range, and so is impossible.

    fn pressure_is_possible(&self, limits: &Limits) -> bool {
        match self.now.pressure_kpa {
            // Up to far beyond over-pressure, which has its own fault, it is a reading; then a broken wire.
            Some(now) => (LEAST_PRESSURE_KPA..=10.0 * limits.over_pressure_kpa).contains(&now),
            None => !self.has_pressure,
        }
    }

    fn length_is_possible(&self, limits: &Limits) -> bool {
        match self.now.length_m {
            Some(now) => {
                (limits.min_length_m - LENGTH_MARGIN_M..=limits.max_length_m + LENGTH_MARGIN_M).contains(&now)
            }
            None => !self.has_length,
        }
    }
}

/// Compares the travel that the motor was asked for with the travel that was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct StallWatch {
    start_m: Option<f32>,
    asked_m: f32,
}

impl StallWatch {
    /// Whether the motor has stalled, after `dt_s` at `rate_m_s` and now at `measured_m`.
    pub(crate) fn check(
        &mut self,
        limits: &Limits,
        dt_s: f32,
        rate_m_s: f32,
        measured_m: Option<f32>,
    ) -> bool {
        let (Some(length_m), true) = (measured_m, rate_m_s != 0.0 && self.asked_m * rate_m_s >= 0.0) else {
            // Nothing to compare, at rest, or turned round: begin again.
            *self = StallWatch::default();
            return false;
        };
        let start_m = *self.start_m.get_or_insert(length_m);
        self.asked_m += rate_m_s * dt_s;
        if self.asked_m.abs() < limits.stall_travel_m {
            return false;
        }
        let followed = (length_m - start_m) / self.asked_m;
        *self = StallWatch::default();
        followed < LEAST_FOLLOWED
    }
}
