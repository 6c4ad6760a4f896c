//! The parameters that a calibration may change, with bounds from physics: the paper's masses and sizes, and
//! what a quadrotor of this kind can have.

use super::VehicleParameters;
use super::calibrate::FreeParameter;

/// One [`FreeParameter`] (lower and upper bound, spread of the prior) whose TOML path is also its place in the structs.
macro_rules! free {
    ($low:expr, $high:expr, $spread:expr, $($path:ident).+) => {
        FreeParameter {
            name: stringify!($($path).+),
            low: $low,
            high: $high,
            spread: $spread,
            difference: 1e-3,
            get: |parameters: &VehicleParameters| parameters.$($path).+,
            set: |parameters: &mut VehicleParameters, value: f64| parameters.$($path).+ = value,
        }
    };
}

impl FreeParameter {
    /// The same parameter, to be searched within a factor of its value in `start`; `None` where that is zero.
    /// Delays, which may well be zero, keep their bounds.
    pub fn around(&self, start: &VehicleParameters, factor: f64) -> Option<FreeParameter> {
        if self.name.ends_with("delay_s") {
            return Some(*self);
        }
        let value = (self.get)(start);
        (value > 0.0).then_some(FreeParameter {
            low: value / factor,
            high: value * factor,
            ..*self
        })
    }
}

/// Everything that replays of the paper's flights can say something about.
pub fn all() -> Vec<FreeParameter> {
    [autopilot(), airframe(), arm(), corner_beams()].concat()
}

/// The same with [`tied_beams`] instead of a beam of its own at every corner: fewer parameters, which say what an arm of
/// the other length is like.
pub fn all_tied() -> Vec<FreeParameter> {
    [autopilot(), airframe(), arm(), tied_beams()].concat()
}

/// Gains, limits and delays of the flight controller. Tilt and speed limits are left at PX4's defaults: the flights
/// hardly reach them, so that the replays do not identify them.
pub fn autopilot() -> Vec<FreeParameter> {
    vec![
        // The position loop sees a command at one of its periods: a step of a whole period shows it.
        FreeParameter {
            difference: 0.0834,
            ..free!(0.0, 0.12, 0.03, autopilot.command_delay_s)
        },
        free!(0.0, 0.12, 0.03, autopilot.estimate_delay_s),
        free!(0.5, 2.5, 0.6, autopilot.position.xy_p),
        free!(0.5, 4.0, 0.6, autopilot.position.z_p),
        free!(1.0, 10.0, 0.6, autopilot.position.xy_vel_p),
        free!(0.05, 4.0, 0.6, autopilot.position.xy_vel_i),
        free!(0.02, 2.0, 0.6, autopilot.position.xy_vel_d),
        free!(1.5, 20.0, 0.6, autopilot.position.z_vel_p),
        free!(0.1, 8.0, 0.6, autopilot.position.z_vel_i),
        free!(1.0, 40.0, 0.6, autopilot.position.velocity_derivative_cutoff_hz),
        free!(4.0, 16.0, 0.6, autopilot.attitude.tilt_p),
        free!(80.0, 400.0, 0.6, autopilot.attitude.tilt_rate_max_deg_s),
        free!(8.0, 50.0, 0.6, autopilot.rate.tilt_p),
    ]
}

/// Motors, inertia and drag of the quadrotor.
pub fn airframe() -> Vec<FreeParameter> {
    vec![
        free!(0.02, 0.06, 0.6, quadrotor.motor_time_constant_s),
        FreeParameter {
            name: "quadrotor.drag_n_s_m",
            low: 0.05,
            high: 1.2,
            spread: 0.6,
            difference: 1e-3,
            get: |parameters| parameters.quadrotor.drag_n_s_m[0],
            set: |parameters, value| parameters.quadrotor.drag_n_s_m = [value; 3],
        },
        FreeParameter {
            name: "quadrotor.inertia_kg_m2",
            low: 0.005,
            high: 0.03,
            spread: 0.3,
            difference: 1e-3,
            get: |parameters| parameters.quadrotor.inertia_kg_m2[0],
            set: |parameters, value| parameters.quadrotor.inertia_kg_m2 = [value, value, 1.5 * value],
        },
        free!(0.04, 0.2, 0.3, quadrotor.clamp_offset_m),
    ]
}

/// Masses and drag of the arm.
pub fn arm() -> Vec<FreeParameter> {
    vec![
        free!(0.13, 0.22, 0.3, arm.tip_mass_kg),
        free!(0.03, 0.14, 0.3, arm.tip_offset_m),
        free!(0.015, 0.05, 0.3, arm.linear_density_kg_m),
        free!(1e-4, 2e-3, 0.3, arm.tip_inertia_transverse_kg_m2),
        free!(0.2, 3.0, 0.6, arm.drag_coefficient_normal),
        free!(0.001, 0.05, 0.6, arm.tip_drag_area_m2),
        free!(0.03, 10.0, 0.6, arm.axial_damping_n_s_m),
    ]
}

/// Bending and axial give of the four corners' beams.
pub fn corner_beams() -> Vec<FreeParameter> {
    vec![
        free!(0.003, 0.5, 1.5, arm.corners.empty_short.stiffness_n_m2),
        free!(0.003, 0.5, 1.5, arm.corners.inflated_short.stiffness_n_m2),
        free!(0.003, 0.5, 1.5, arm.corners.empty_long.stiffness_n_m2),
        free!(0.002, 0.5, 1.5, arm.corners.inflated_long.stiffness_n_m2),
        free!(0.0003, 0.3, 1.5, arm.corners.empty_short.damping_n_m2_s),
        free!(0.0003, 0.3, 1.5, arm.corners.inflated_short.damping_n_m2_s),
        free!(0.0003, 0.3, 1.5, arm.corners.empty_long.damping_n_m2_s),
        free!(0.0003, 0.3, 1.5, arm.corners.inflated_long.damping_n_m2_s),
        free!(0.01, 10.0, 1.5, arm.corners.empty_short.collapse_moment_n_m),
        free!(0.01, 10.0, 1.5, arm.corners.inflated_short.collapse_moment_n_m),
        free!(0.01, 10.0, 1.5, arm.corners.empty_long.collapse_moment_n_m),
        free!(0.01, 10.0, 1.5, arm.corners.inflated_long.collapse_moment_n_m),
        free!(0.001, 0.008, 1.5, arm.corners.empty_short.stretch_m_n),
        free!(0.001, 0.008, 1.5, arm.corners.inflated_short.stretch_m_n),
        free!(0.001, 0.06, 1.5, arm.corners.empty_long.stretch_m_n),
        free!(0.001, 0.06, 1.5, arm.corners.inflated_long.stretch_m_n),
        free!(0.001, 0.06, 1.5, arm.corners.empty_short.slack_m_n),
        free!(0.001, 0.06, 1.5, arm.corners.inflated_short.slack_m_n),
        free!(0.001, 0.3, 1.5, arm.corners.empty_long.slack_m_n),
        free!(0.001, 0.3, 1.5, arm.corners.inflated_long.slack_m_n),
    ]
}

/// One [`FreeParameter`] of the short beam at a pressure, which the long one follows.
macro_rules! tied {
    ($low:expr, $high:expr, $short:ident, $long:ident, $property:ident, $long_over_short:expr) => {
        FreeParameter {
            name: concat!("arm.corners.", stringify!($short), ".", stringify!($property)),
            low: $low,
            high: $high,
            spread: 1.5,
            difference: 1e-3,
            get: |parameters: &VehicleParameters| parameters.arm.corners.$short.$property,
            set: |parameters: &mut VehicleParameters, value: f64| {
                parameters.arm.corners.$short.$property = value;
                parameters.arm.corners.$long.$property = value * $long_over_short;
            },
        }
    };
}

/// Damping of the long beam over the short one's, (1.0 m / 0.7 m)^2.5: as a pendulum of length l with the tip's mass m has
/// the stiffness m g l and the inertia m l², one damping ratio at every length takes a torque per rate ∝ l^1.5, which a
/// beam of that length has with a damping ∝ l^2.5.
const DAMPING_LONG_OVER_SHORT: f64 = 2.44;
/// Length of tube, hence slack and stretch, of the long arm over the short one's: what clamp and tip leave.
const TUBE_LONG_OVER_SHORT: f64 = 1.6;

/// One beam per pressure, its properties at the short arm's length. Stiffness and wrinkling belong to the tube's section;
/// slack and stretch add up along the tube; damping gives the swing one damping ratio.
pub fn tied_beams() -> Vec<FreeParameter> {
    macro_rules! beam {
        ($short:ident, $long:ident) => {
            [
                tied!(0.002, 0.5, $short, $long, stiffness_n_m2, 1.0),
                tied!(
                    0.0003,
                    0.1,
                    $short,
                    $long,
                    damping_n_m2_s,
                    DAMPING_LONG_OVER_SHORT
                ),
                tied!(0.01, 10.0, $short, $long, collapse_moment_n_m, 1.0),
                tied!(0.001, 0.2, $short, $long, slack_m_n, TUBE_LONG_OVER_SHORT),
                tied!(
                    0.001,
                    0.03,
                    $short,
                    $long,
                    stretch_m_n,
                    TUBE_LONG_OVER_SHORT
                ),
            ]
        };
    }
    [
        beam!(empty_short, empty_long),
        beam!(inflated_short, inflated_long),
    ]
    .concat()
}
