//! Small motions about hover: the modes of quadrotor, arm and autopilot together.
//!
//! A mode of low or negative damping is what swings on its own in slow flight. The arm's drag grows with the square of the
//! speed and takes no part in small motions, so a mode that grows does not do so without bound: it settles into a swing at
//! which drag takes what the loop gives.
//!
//! # Method
//!
//! About hover, sampled with the commands, the closed loop is linear and does not change with time: after a nudge too small
//! for anything else to matter, positions move as `y_k = Σ_j c_j λ_jᵏ`. The eigensystem realization algorithm (Juang and
//! Pappa, "An Eigensystem Realization Algorithm for Modal Parameter Identification and Model Reduction", J. Guidance 8,
//! 1985) finds the λ_j from the matrices `H₀ = (y_{i+j})`, `H₁ = (y_{i+j+1})`: with `H₀ ≈ U Σ Vᵀ` cut where the singular
//! values fall to what is not linear in the response, they are the eigenvalues of `Σ^{−½} Uᵀ H₁ V Σ^{−½}`. It needs no access to the
//! state of controller, filters and delays, and the same would do for a recorded response.

use super::parameters::ParameterError;
use super::{SimulatedVehicle, VehicleParameters};
use crate::DT;
use crate::flight::Configuration;
use crate::link::{Vehicle, VehicleError};
use nalgebra::{Complex, DMatrix, Vector2};

/// An oscillation of the closed loop about hover.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Natural frequency |s| / 2π, Hz.
    pub frequency_hz: f64,
    /// Damping ratio ζ = −Re s / |s|; negative for one that grows.
    pub damping_ratio: f64,
}

/// Why there are no modes to report.
#[derive(Debug, thiserror::Error)]
pub enum HoverError {
    /// The vehicle cannot be made.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// The vehicle cannot hover there.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// The nudge, m: small enough for limits and turned axes not to matter, far above the rounding.
const NUDGE_M: f64 = 1e-3;
/// Commands until the nudge has left every delay, and rows of the response: 8 s.
const SETTLED: usize = 30;
const ROWS: usize = 160;
/// Singular values below this share of the greatest are not the linear response's.
const RANK_TOLERANCE: f64 = 1e-4;
/// What takes less than this share in the response is no mode of it.
const PART_TOLERANCE: f64 = 2e-3;

/// Oscillations along x about hover in calm air, the least damped first.
pub fn modes(parameters: &VehicleParameters, configuration: Configuration) -> Result<Vec<Mode>, HoverError> {
    let mut parameters = parameters.clone();
    // What changes with time or by chance, and drag, which small motions do not feel.
    parameters.arm.drag_coefficient_normal = 0.0;
    parameters.arm.drag_coefficient_tangential = 0.0;
    parameters.arm.tip_drag_area_m2 = 0.0;
    parameters.wind = VehicleParameters::default().wind;
    parameters.quadrotor.battery_sag_per_minute = 0.0;
    parameters.autopilot.command_dropout_probability = 0.0;
    parameters.autopilot.yaw_drift_deg_s = 0.0;
    let mut vehicle = SimulatedVehicle::new(parameters)?;
    vehicle.reset(configuration, 0)?;
    let mut response = Vec::with_capacity(ROWS);
    for row in 0..SETTLED + ROWS {
        let x = if row < SETTLED / 2 { NUDGE_M } else { 0.0 };
        vehicle.step([x, 0.0, crate::HOVER_HEIGHT_M].into(), configuration)?;
        if row >= SETTLED {
            let (quadrotor, end_effector) = vehicle.positions();
            response.push(Vector2::new(quadrotor.x, end_effector.x));
        }
    }
    Ok(oscillations(&response, DT))
}

/// The oscillations in a free response of two signals sampled every `period` seconds, the least damped first: of a recorded
/// one, too, as far as its noise lets them be told.
pub fn oscillations(response: &[Vector2<f64>], period: f64) -> Vec<Mode> {
    let eigenvalues = transition(response).complex_eigenvalues();
    // Each one's part in the response: y_k = Σ_j c_j λ_jᵏ by least squares.
    let powers = DMatrix::from_fn(response.len(), eigenvalues.len(), |k, j| {
        eigenvalues[j].powu(k as u32)
    });
    let measured = DMatrix::from_fn(response.len(), 2, |k, i| Complex::from(response[k][i]));
    let Ok(parts) = powers.clone().svd(true, true).solve(&measured, f64::EPSILON) else {
        return vec![];
    };
    let greatest = response.iter().map(Vector2::amax).fold(0.0, f64::max);
    let mut modes: Vec<Mode> = (0..eigenvalues.len())
        .filter(|&j| {
            let part = parts.row(j).camax() * powers.column(j).camax();
            eigenvalues[j].im > 0.0 && part > PART_TOLERANCE * greatest
        })
        .map(|j| {
            let s = eigenvalues[j].ln() / period;
            Mode {
                frequency_hz: s.norm() / std::f64::consts::TAU,
                damping_ratio: -s.re / s.norm(),
            }
        })
        .collect();
    modes.sort_by(|a, b| a.damping_ratio.total_cmp(&b.damping_ratio));
    modes
}

/// The matrix whose eigenvalues are the response's λ_j, from its Hankel matrices.
fn transition(response: &[Vector2<f64>]) -> DMatrix<f64> {
    let half = response.len() / 2;
    let hankel =
        |shift: usize| DMatrix::from_fn(2 * half, half - 1, |i, j| response[i / 2 + j + shift][i % 2]);
    let svd = hankel(0).svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return DMatrix::zeros(0, 0);
    };
    let greatest = svd.singular_values.max();
    let rank = svd
        .singular_values
        .iter()
        .filter(|value| **value > RANK_TOLERANCE * greatest)
        .count();
    let scale = DMatrix::from_diagonal(&svd.singular_values.rows(0, rank).map(|value| 1.0 / value.sqrt()));
    &scale * u.columns(0, rank).tr_mul(&hankel(1)) * v_t.rows(0, rank).transpose() * &scale
}
