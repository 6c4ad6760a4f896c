//! How well the flights determine what was found.

use super::{Estimate, FreeParameter, Point, Problem};
use nalgebra::DMatrix;

/// Residuals that are taken as one when standard errors are found: a second of a position.
const CLUSTER: usize = 60;

impl Problem<'_> {
    /// Standard errors from the covariance `N⁺ (Σ_c g_c g_cᵀ) N⁺`, with `N = JᵀJ` and `g_c = J_cᵀ r_c` summed over
    /// clusters c of neighbouring residuals, which are far from independent (Liang and Zeger, "Longitudinal data
    /// analysis using generalized linear models", Biometrika 1986). Directions that the data do not see
    /// (eigenvalue below 1e-6 of the greatest) make every parameter that they contain unidentified.
    pub(super) fn estimates(&self, point: &Point, jacobian: &DMatrix<f64>) -> Vec<Estimate> {
        let free = self.free.len();
        // The flights alone: what only the prior tells is not identified.
        let rows = point.residuals.len() - self.prior_rows();
        let (jacobian, residuals) = (jacobian.rows(0, rows), point.residuals.rows(0, rows));
        let eigen = jacobian.tr_mul(&jacobian).symmetric_eigen();
        let greatest = eigen.eigenvalues.max();
        let mut inverse = DMatrix::zeros(free, free);
        let mut unseen = vec![0.0; free];
        for (k, eigenvalue) in eigen.eigenvalues.iter().enumerate() {
            let direction = eigen.eigenvectors.column(k);
            if *eigenvalue > 1e-6 * greatest {
                inverse += direction * direction.transpose() / *eigenvalue;
            } else {
                for (unseen, component) in unseen.iter_mut().zip(&direction) {
                    *unseen += component * component;
                }
            }
        }
        let mut clusters = DMatrix::zeros(free, free);
        for first in (0..rows).step_by(CLUSTER) {
            let count = CLUSTER.min(rows - first);
            let gradient = jacobian.rows(first, count).tr_mul(&residuals.rows(first, count));
            clusters += &gradient * gradient.transpose();
        }
        let covariance = &inverse * clusters * &inverse;
        let estimate = |(j, parameter): (usize, &FreeParameter)| {
            let x = point.x[j];
            let slope = (parameter.unscaled(x + 1e-4) - parameter.unscaled(x - 1e-4)) / 2e-4;
            let on_scale = if unseen[j] > 1e-2 {
                f64::INFINITY
            } else {
                covariance[(j, j)].max(0.0).sqrt()
            };
            Estimate {
                name: parameter.name,
                value: parameter.unscaled(x),
                standard_error: slope * on_scale,
                at_bound: x <= 0.0 || x >= 1.0,
            }
        };
        self.free.iter().enumerate().map(estimate).collect()
    }
}
