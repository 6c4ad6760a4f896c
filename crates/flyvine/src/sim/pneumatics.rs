//! Air in the tube: two pumps under on-off control, a leak, and a volume that grows with the arm.
//!
//! The tube holds `V = π d²/4 · L`. Isothermally, with gauge pressure p and atmosphere p₀,
//! `d(p₀ + p)/dt = ((p₀ Q − leak · p) − (p₀ + p) V̇) / V`; where growth outruns the pumps the tube goes limp
//! (p = 0) and keeps the missing volume as a debt that the pumps must fill first.

use super::parameters::{Checker, ParameterError};
use serde::{Deserialize, Serialize};

/// Atmospheric pressure, kPa.
const ATMOSPHERE_KPA: f64 = 101.325;

/// Pumps, leak and pressure control. Flows from the paper, Sec. II-A; band and leak are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PneumaticsParameters {
    /// Flow of both pumps together at atmospheric pressure, m³/s (2 × 3.2 L/min).
    pub pump_flow_m3_s: f64,
    /// The pumps start below the setpoint minus this and stop above the setpoint plus this, kPa.
    pub hysteresis_kpa: f64,
    /// Air lost through seams and rollers per gauge pressure, m³/s per kPa at atmospheric pressure.
    pub leak_m3_s_kpa: f64,
    /// Period of the on-off controller, s.
    pub control_period_s: f64,
    /// Greatest pressure that may be commanded, kPa.
    pub max_pressure_kpa: f64,
}

impl Default for PneumaticsParameters {
    fn default() -> Self {
        PneumaticsParameters {
            pump_flow_m3_s: 2.0 * 3.2e-3 / 60.0,
            hysteresis_kpa: 0.01,
            leak_m3_s_kpa: 1e-5,
            control_period_s: 0.005,
            max_pressure_kpa: 2.0,
        }
    }
}

impl PneumaticsParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("pneumatics");
        check.range("pump_flow_m3_s", self.pump_flow_m3_s, 0.0, 0.1, "m³/s")?;
        check.range("hysteresis_kpa", self.hysteresis_kpa, 0.0, 1.0, "kPa")?;
        check.range("leak_m3_s_kpa", self.leak_m3_s_kpa, 0.0, 0.01, "m³/s per kPa")?;
        check.range("control_period_s", self.control_period_s, 1e-4, 1.0, "s")?;
        check.range("max_pressure_kpa", self.max_pressure_kpa, 1e-3, 100.0, "kPa")
    }
}

/// State of the air in the tube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pneumatics {
    /// Gauge pressure, kPa.
    pub pressure_kpa: f64,
    /// Volume that a limp tube still misses, m³.
    pub missing_volume_m3: f64,
    /// True while the pumps run.
    pub pumping: bool,
    since_control_s: f64,
}

impl Pneumatics {
    /// A full tube at `pressure_kpa` with the pumps off.
    pub fn at(pressure_kpa: f64) -> Pneumatics {
        Pneumatics {
            pressure_kpa,
            missing_volume_m3: 0.0,
            pumping: false,
            since_control_s: f64::INFINITY,
        }
    }

    /// Advances by `step` seconds with the tube at `volume_m3`, growing by `volume_rate_m3_s`.
    pub fn step(
        &mut self,
        parameters: &PneumaticsParameters,
        setpoint_kpa: f64,
        volume_m3: f64,
        volume_rate_m3_s: f64,
        step: f64,
    ) {
        self.since_control_s += step;
        if self.since_control_s >= parameters.control_period_s {
            self.since_control_s = 0.0;
            // A setpoint of zero is "off": otherwise the pumps would idle around a limp tube.
            if setpoint_kpa <= 0.0 || self.pressure_kpa > setpoint_kpa + parameters.hysteresis_kpa {
                self.pumping = false;
            } else if self.pressure_kpa < setpoint_kpa - parameters.hysteresis_kpa {
                self.pumping = true;
            }
        }
        let pump = if self.pumping {
            parameters.pump_flow_m3_s
        } else {
            0.0
        };
        // Net air at atmospheric pressure beyond what the growing volume takes up, m³.
        let surplus = step
            * (pump
                - parameters.leak_m3_s_kpa * self.pressure_kpa
                - (1.0 + self.pressure_kpa / ATMOSPHERE_KPA) * volume_rate_m3_s)
            - self.missing_volume_m3;
        let pressure = self.pressure_kpa + ATMOSPHERE_KPA * surplus / volume_m3;
        if pressure < 0.0 {
            // Less than nothing in the tube: what lacks, and never more than the whole tube.
            self.missing_volume_m3 = (-pressure / ATMOSPHERE_KPA * volume_m3).min(volume_m3);
            self.pressure_kpa = 0.0;
        } else {
            self.missing_volume_m3 = 0.0;
            self.pressure_kpa = pressure;
        }
    }
}
