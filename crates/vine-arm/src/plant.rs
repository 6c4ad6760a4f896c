//! A simulated spool and tube, for boards without real ones: what the actuators do to the sensors.
//!
//! Spool: `v' = (duty · v_full − v) / τ`, `l' = v`, between two hard ends. Tube of volume `V = A l`, isothermal with
//! atmosphere p₀: `d(p₀ + p)/dt = ((p₀ (Q_in − Q_leak − Q_vent)) − (p₀ + p) V') / V`, with `Q_leak` and `Q_vent`
//! proportional to p; where growth outruns the pumps the tube goes limp (p = 0) and owes the missing air.

use crate::controller::{Actuators, Sensors};
use crate::pumps::Air;

const ATMOSPHERE_KPA: f32 = 101.325;

/// Constants of the plant. Tube, pumps and rate from the paper, Sec. II-A; the others are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlantParameters {
    /// Growth rate at full duty, m/s.
    pub full_duty_rate_m_s: f32,
    /// Time constant of the geared motor, s.
    pub motor_time_s: f32,
    /// Length at which the spool is full, m.
    pub shortest_m: f32,
    /// Length at which the spool is empty, m.
    pub longest_m: f32,
    /// Cross-section of the tube, m² (8 cm diameter).
    pub area_m2: f32,
    /// Flow of both pumps together, m³/s (2 × 3.2 L/min).
    pub pump_flow_m3_s: f32,
    /// Leak, m³/s per kPa.
    pub leak_m3_s_kpa: f32,
    /// Open vent, m³/s per kPa.
    pub vent_m3_s_kpa: f32,
}

impl Default for PlantParameters {
    fn default() -> Self {
        PlantParameters {
            full_duty_rate_m_s: 0.02,
            motor_time_s: 0.05,
            shortest_m: 0.57,
            longest_m: 1.13,
            area_m2: core::f32::consts::PI * 0.04 * 0.04,
            pump_flow_m3_s: 2.0 * 3.2e-3 / 60.0,
            leak_m3_s_kpa: 1e-5,
            vent_m3_s_kpa: 1e-3,
        }
    }
}

/// State of the simulated arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    /// Its constants.
    pub parameters: PlantParameters,
    /// Length, m.
    pub length_m: f32,
    /// Growth rate, m/s.
    pub rate_m_s: f32,
    /// Gauge pressure, kPa.
    pub pressure_kpa: f32,
    /// Air that a limp tube lacks, m³.
    pub missing_m3: f32,
}

impl Plant {
    /// A full but unpressurised tube at rest.
    pub fn at(parameters: PlantParameters, length_m: f32) -> Plant {
        Plant {
            parameters,
            length_m,
            rate_m_s: 0.0,
            pressure_kpa: 0.0,
            missing_m3: 0.0,
        }
    }

    /// Advances by `dt_s`, small against the motor's time constant.
    pub fn step(&mut self, dt_s: f32, actuators: Actuators) {
        let p = &self.parameters;
        // Semi-implicit, stable for every step.
        let wanted = actuators.growth_duty * p.full_duty_rate_m_s;
        self.rate_m_s += (wanted - self.rate_m_s) * dt_s / (p.motor_time_s + dt_s);
        let before = self.length_m;
        self.length_m = (before + self.rate_m_s * dt_s).clamp(p.shortest_m, p.longest_m);
        if self.length_m == p.shortest_m || self.length_m == p.longest_m {
            self.rate_m_s = 0.0;
        }

        let pumped = if actuators.air == Air::Inflate {
            p.pump_flow_m3_s
        } else {
            0.0
        };
        let vent = if actuators.air == Air::Vent {
            p.vent_m3_s_kpa
        } else {
            0.0
        };
        let volume = p.area_m2 * self.length_m;
        let volume_change = p.area_m2 * (self.length_m - before);
        // Outflow is implicit in the pressure: a wide vent empties the tube, and no more.
        let outflow = (p.leak_m3_s_kpa + vent) * self.pressure_kpa
            / (1.0 + dt_s * ATMOSPHERE_KPA * (p.leak_m3_s_kpa + vent) / volume);
        let surplus = dt_s * (pumped - outflow)
            - (1.0 + self.pressure_kpa / ATMOSPHERE_KPA) * volume_change
            - self.missing_m3;
        let pressure = self.pressure_kpa + ATMOSPHERE_KPA * surplus / volume;
        if pressure < 0.0 {
            self.missing_m3 = (-pressure / ATMOSPHERE_KPA * volume).min(volume);
            self.pressure_kpa = 0.0;
        } else {
            self.missing_m3 = 0.0;
            self.pressure_kpa = pressure;
        }
    }

    /// What an encoder and a pressure sensor would read.
    pub fn sensors(&self) -> Sensors {
        Sensors {
            length_m: Some(self.length_m),
            pressure_kpa: Some(self.pressure_kpa),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spool_grows_at_its_rate() {
        let mut plant = Plant::at(PlantParameters::default(), 0.7);
        for _ in 0..2000 {
            plant.step(
                0.005,
                Actuators {
                    growth_duty: 0.5,
                    air: Air::Off,
                },
            );
        }
        // 10 s at 1 cm/s, less the motor's start: τ · v.
        assert!(
            (plant.length_m - (0.8 - 0.0005)).abs() < 1e-4,
            "{}",
            plant.length_m
        );
    }

    #[test]
    fn the_pumps_fill_the_tube_isothermally() {
        let mut plant = Plant::at(
            PlantParameters {
                leak_m3_s_kpa: 0.0,
                ..PlantParameters::default()
            },
            1.0,
        );
        for _ in 0..200 {
            plant.step(
                0.005,
                Actuators {
                    growth_duty: 0.0,
                    air: Air::Inflate,
                },
            );
        }
        // p = p₀ Q t / V.
        let expected = 101.325 * (6.4e-3 / 60.0) / (core::f32::consts::PI * 0.0016);
        assert!(
            (plant.pressure_kpa - expected).abs() < 1e-3 * expected,
            "{}",
            plant.pressure_kpa
        );
    }

    #[test]
    fn growth_without_pumps_leaves_a_limp_tube_that_must_be_filled_first() {
        let mut plant = Plant::at(PlantParameters::default(), 0.7);
        for _ in 0..2000 {
            plant.step(
                0.005,
                Actuators {
                    growth_duty: 1.0,
                    air: Air::Off,
                },
            );
        }
        assert_eq!(plant.pressure_kpa, 0.0);
        let missing = plant.parameters.area_m2 * (plant.length_m - 0.7);
        assert!((plant.missing_m3 - missing).abs() < 1e-3 * missing);
    }
}
