//! The arm's numbers: sizes, masses and air, and the beam at the corners of the configuration grid.

use super::check::{Checker, ParameterError};
use serde::{Deserialize, Serialize};

/// The inflated arm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmParameters {
    /// Mass of tip mount and spool with the tube fully wound up, kg.
    pub tip_mass_kg: f64,
    /// Moment of inertia of the tip about its centre across the arm, kg m².
    pub tip_inertia_transverse_kg_m2: f64,
    /// Moment of inertia of the tip about the arm's axis, kg m².
    pub tip_inertia_axial_kg_m2: f64,
    /// Distance from the end of the bending tube to the end effector, m.
    pub tip_offset_m: f64,
    /// Mass of the deployed tube with its coil and wires per length, kg/m. Fed from the spool.
    pub linear_density_kg_m: f64,
    /// Diameter of the tube, m.
    pub diameter_m: f64,
    /// Drag coefficient across the tube (cylinder in cross flow).
    pub drag_coefficient_normal: f64,
    /// Drag coefficient along the tube, on its lateral surface.
    pub drag_coefficient_tangential: f64,
    /// Drag area of the tip (coefficient times frontal area), m².
    pub tip_drag_area_m2: f64,
    /// Axial damping of the tube, N s/m.
    pub axial_damping_n_s_m: f64,
    /// Bending moment at which folds and layers of the tube slip on each other (hysteresis), N m; zero for none.
    pub slip_moment_n_m: f64,
    /// Bending stiffness that they add as long as they stick, N m².
    pub slip_stiffness_n_m2: f64,
    /// Greatest growth rate, m/s.
    pub max_growth_rate_m_s: f64,
    /// First-order lag of the growth motor, s.
    pub growth_time_constant_s: f64,
    /// Shortest and longest rest distance from quadrotor to end effector, m.
    pub length_range_m: [f64; 2],
    /// Beam properties at the four corners of the configuration grid, interpolated bilinearly between them
    /// and held beyond.
    pub corners: Corners,
}

/// Lengths of the short and the long arm of the configuration grid, m.
pub const CORNER_LENGTHS_M: [f64; 2] = [0.7, 1.0];
/// Pressures of the empty and the inflated arm of the configuration grid, kPa.
pub const CORNER_PRESSURES_KPA: [f64; 2] = [0.0, 0.4];

/// Beam properties at the corners of the configuration grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Corners {
    /// 0.7 m, 0 kPa.
    pub empty_short: Beam,
    /// 0.7 m, 0.4 kPa.
    pub inflated_short: Beam,
    /// 1.0 m, 0 kPa.
    pub empty_long: Beam,
    /// 1.0 m, 0.4 kPa.
    pub inflated_long: Beam,
}

/// Bending of the tube at one length and pressure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beam {
    /// Bending stiffness EI, N m².
    pub stiffness_n_m2: f64,
    /// Bending damping (torque per rate of curvature), N m² s.
    pub damping_n_m2_s: f64,
    /// Moment at which the tube wrinkles and its stiffness saturates, N m.
    pub collapse_moment_n_m: f64,
    /// Shortening per loss of tension below the hanging tip's weight, m/N: limp fabric folds, the coil pulls.
    pub slack_m_n: f64,
    /// Lengthening per tension above the hanging tip's weight, m/N.
    pub stretch_m_n: f64,
}

impl Default for ArmParameters {
    fn default() -> Self {
        ArmParameters {
            tip_mass_kg: 0.1304,
            tip_inertia_transverse_kg_m2: 0.002,
            tip_inertia_axial_kg_m2: 2e-4,
            tip_offset_m: 0.03,
            linear_density_kg_m: 0.04971,
            diameter_m: 0.08,
            drag_coefficient_normal: 1.603,
            drag_coefficient_tangential: 0.02,
            tip_drag_area_m2: 0.001263,
            axial_damping_n_s_m: 0.03,
            slip_moment_n_m: 0.0,
            slip_stiffness_n_m2: 0.05,
            max_growth_rate_m_s: 0.02,
            growth_time_constant_s: 0.1,
            length_range_m: [0.45, 1.2],
            corners: Corners {
                empty_short: Beam {
                    stiffness_n_m2: 0.05648,
                    damping_n_m2_s: 0.01041,
                    collapse_moment_n_m: 0.1102,
                    slack_m_n: 0.05599,
                    stretch_m_n: 0.001152,
                },
                inflated_short: Beam {
                    stiffness_n_m2: 0.05841,
                    damping_n_m2_s: 0.007237,
                    collapse_moment_n_m: 10.0,
                    slack_m_n: 0.04206,
                    stretch_m_n: 0.008,
                },
                empty_long: Beam {
                    stiffness_n_m2: 0.06524,
                    damping_n_m2_s: 0.04484,
                    collapse_moment_n_m: 0.1516,
                    slack_m_n: 0.1473,
                    stretch_m_n: 0.003107,
                },
                inflated_long: Beam {
                    stiffness_n_m2: 0.01725,
                    damping_n_m2_s: 0.02417,
                    collapse_moment_n_m: 0.2314,
                    slack_m_n: 0.06096,
                    stretch_m_n: 0.002086,
                },
            },
        }
    }
}

impl Corners {
    /// The beam at a length (m) and pressure (kPa).
    pub fn at(&self, length_m: f64, pressure_kpa: f64) -> Beam {
        let fraction = |value: f64, [low, high]: [f64; 2]| ((value - low) / (high - low)).clamp(0.0, 1.0);
        let (s, t) = (
            fraction(length_m, CORNER_LENGTHS_M),
            fraction(pressure_kpa, CORNER_PRESSURES_KPA),
        );
        let blend = |value: fn(&Beam) -> f64| {
            (1.0 - t) * ((1.0 - s) * value(&self.empty_short) + s * value(&self.empty_long))
                + t * ((1.0 - s) * value(&self.inflated_short) + s * value(&self.inflated_long))
        };
        Beam {
            stiffness_n_m2: blend(|beam| beam.stiffness_n_m2),
            damping_n_m2_s: blend(|beam| beam.damping_n_m2_s),
            collapse_moment_n_m: blend(|beam| beam.collapse_moment_n_m),
            slack_m_n: blend(|beam| beam.slack_m_n),
            stretch_m_n: blend(|beam| beam.stretch_m_n),
        }
    }
}

impl ArmParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("arm");
        check.range("tip_mass_kg", self.tip_mass_kg, 0.005, 10.0, "kg")?;
        check.range(
            "tip_inertia_transverse_kg_m2",
            self.tip_inertia_transverse_kg_m2,
            1e-7,
            0.1,
            "kg m²",
        )?;
        check.range(
            "tip_inertia_axial_kg_m2",
            self.tip_inertia_axial_kg_m2,
            1e-7,
            0.1,
            "kg m²",
        )?;
        check.range("tip_offset_m", self.tip_offset_m, 0.0, 0.5, "m")?;
        check.range("linear_density_kg_m", self.linear_density_kg_m, 1e-4, 5.0, "kg/m")?;
        check.range("diameter_m", self.diameter_m, 1e-3, 0.5, "m")?;
        check.range(
            "drag_coefficient_normal",
            self.drag_coefficient_normal,
            0.0,
            5.0,
            "",
        )?;
        check.range(
            "drag_coefficient_tangential",
            self.drag_coefficient_tangential,
            0.0,
            5.0,
            "",
        )?;
        check.range("tip_drag_area_m2", self.tip_drag_area_m2, 0.0, 1.0, "m²")?;
        check.range(
            "axial_damping_n_s_m",
            self.axial_damping_n_s_m,
            0.0,
            1000.0,
            "N s/m",
        )?;
        check.range("slip_moment_n_m", self.slip_moment_n_m, 0.0, 100.0, "N m")?;
        check.range(
            "slip_stiffness_n_m2",
            self.slip_stiffness_n_m2,
            1e-4,
            100.0,
            "N m²",
        )?;
        check.range("max_growth_rate_m_s", self.max_growth_rate_m_s, 0.0, 0.5, "m/s")?;
        check.range(
            "growth_time_constant_s",
            self.growth_time_constant_s,
            1e-3,
            10.0,
            "s",
        )?;
        for length in self.length_range_m {
            check.range("length_range_m", length, 0.05, 10.0, "m")?;
        }
        let corners = &self.corners;
        for (name, beam) in [
            ("corners.empty_short", corners.empty_short),
            ("corners.inflated_short", corners.inflated_short),
            ("corners.empty_long", corners.empty_long),
            ("corners.inflated_long", corners.inflated_long),
        ] {
            check.range(
                &format!("{name}.stiffness_n_m2"),
                beam.stiffness_n_m2,
                0.0,
                100.0,
                "N m²",
            )?;
            check.range(
                &format!("{name}.damping_n_m2_s"),
                beam.damping_n_m2_s,
                0.0,
                100.0,
                "N m² s",
            )?;
            check.range(
                &format!("{name}.collapse_moment_n_m"),
                beam.collapse_moment_n_m,
                1e-4,
                1e6,
                "N m",
            )?;
            check.range(&format!("{name}.slack_m_n"), beam.slack_m_n, 1e-5, 1.0, "m/N")?;
            check.range(&format!("{name}.stretch_m_n"), beam.stretch_m_n, 1e-5, 1.0, "m/N")?;
        }
        Ok(())
    }
}
