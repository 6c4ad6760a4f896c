//! Robust regression by iteratively reweighted least squares (Huber, "Robust Statistics", 1981, Ch. 7).

use super::Observations;
use super::ordinary::Design;
use crate::model::error::ModelError;
use serde::Serialize;

/// Median absolute deviation of the standard normal distribution.
const NORMAL_MAD: f64 = 0.674_489_750_196_081_7;
/// Reweightings before it is given up.
const MAX_ITERATIONS: usize = 2000;
/// Largest relative change of a residual at which the weights have settled.
const SETTLED: f64 = 1e-13;

/// How outliers lose weight; z is the residual over the scale. The tuning constants give 95 % of the efficiency
/// of least squares on normal residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum RobustLoss {
    /// Weight 1 up to |z| = 1.345, then 1.345 / |z|.
    Huber,
    /// Weight (1 − (z / 4.685)²)² up to |z| = 4.685, then 0.
    Bisquare,
}

/// A robust fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobustRegression {
    /// Estimates, one per regressor.
    pub estimates: Vec<f64>,
    /// Asymptotic standard errors (Huber 1981, eq. 7.6.5).
    pub standard_errors: Vec<f64>,
    /// Scale of the residuals: their median absolute value over that of a standard normal, response's unit.
    pub scale: f64,
    /// Final weight of each observation, 0 to 1.
    pub weights: Vec<f64>,
    /// Whether the weights settled.
    pub converged: bool,
}

/// Robust regression: least squares, reweighted until the weights settle.
///
/// # Errors
/// As [`super::regress`].
pub fn regress_robustly(data: &Observations, loss: RobustLoss) -> Result<RobustRegression, ModelError> {
    let design = Design::new(data)?;
    let (n, p) = (design.rows() as f64, data.names.len() as f64);
    let (mut estimates, mut residuals) = design.solve(&data.response);
    let mut scale = scale_of(&residuals);
    let mut weights = vec![1.0; residuals.len()];
    let mut converged = scale == 0.0;
    for _ in 0..MAX_ITERATIONS {
        if converged {
            break;
        }
        weights = residuals.iter().map(|r| loss.weight(r / scale)).collect();
        let (next_estimates, next_residuals) = design.solve_weighted(&data.response, &weights);
        let change = residuals
            .iter()
            .zip(&next_residuals)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        converged = change <= SETTLED * scale;
        (estimates, residuals) = (next_estimates, next_residuals);
        scale = scale_of(&residuals);
        converged |= scale == 0.0;
    }

    // Covariance k² (Σψ² s² / (n − p)) / (mean ψ')² (XᵀX)⁻¹ with k = 1 + p/n · var ψ' / (mean ψ')².
    let z = || {
        residuals
            .iter()
            .map(|r| if scale > 0.0 { r / scale } else { 0.0 })
    };
    let squares: f64 = z().map(|z| (z * loss.weight(z)).powi(2)).sum();
    let mean = z().map(|z| loss.influence_slope(z)).sum::<f64>() / n;
    let variance = z().map(|z| (loss.influence_slope(z) - mean).powi(2)).sum::<f64>() / n;
    let correction = 1.0 + p / n * variance / mean.powi(2);
    let factor = correction * scale * (squares / (n - p)).sqrt() / mean;
    let standard_errors = (0..data.names.len())
        .map(|j| factor * design.inverse_norm(j))
        .collect();
    Ok(RobustRegression {
        estimates,
        standard_errors,
        scale,
        weights,
        converged,
    })
}

impl RobustLoss {
    /// ψ(z) / z.
    fn weight(self, z: f64) -> f64 {
        match self {
            Self::Huber => 1.345 / z.abs().max(1.345),
            Self::Bisquare => (1.0 - (z / 4.685).powi(2)).max(0.0).powi(2),
        }
    }

    /// ψ'(z).
    fn influence_slope(self, z: f64) -> f64 {
        match self {
            Self::Huber => f64::from(u8::from(z.abs() <= 1.345)),
            Self::Bisquare => {
                let square = (z / 4.685).powi(2);
                let inside = (1.0 - square).max(0.0);
                inside.powi(2) - 4.0 * square * inside
            }
        }
    }
}

fn scale_of(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let (lower, upper) = (sizes[(sizes.len() - 1) / 2], sizes[sizes.len() / 2]);
    0.5 * (lower + upper) / NORMAL_MAD
}
