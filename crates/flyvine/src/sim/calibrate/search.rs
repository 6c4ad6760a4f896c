//! The search: Levenberg–Marquardt with bounds on the 0 to 1 scales.

use super::{Point, Problem};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

impl Problem<'_> {
    /// Forward differences, away from the nearer bound.
    fn jacobian(&self, point: &Point) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> = (0..self.free.len())
            .into_par_iter()
            .map(|j| {
                let step = self.free[j].difference * if point.x[j] > 0.5 { -1.0 } else { 1.0 };
                let mut x = point.x.clone();
                x[j] += step;
                match self.residuals(&x) {
                    Some(residuals) => (residuals - &point.residuals) / step,
                    None => DVector::zeros(point.residuals.len()),
                }
            })
            .collect();
        DMatrix::from_columns(&columns)
    }

    /// Levenberg–Marquardt with bounds: coordinates that sit at a bound and want out are held.
    pub(super) fn minimize(
        &self,
        mut point: Point,
        progress: &dyn Fn(usize, &Point),
    ) -> (Point, DMatrix<f64>, usize) {
        let mut damping = 1e-2;
        let mut jacobian = self.jacobian(&point);
        for iteration in 0..self.options.max_iterations {
            progress(iteration, &point);
            let before = point.cost;
            let gradient = jacobian.tr_mul(&point.residuals);
            let held: Vec<bool> = (0..point.x.len())
                .map(|j| (point.x[j] <= 0.0 && gradient[j] > 0.0) || (point.x[j] >= 1.0 && gradient[j] < 0.0))
                .collect();
            let normal = jacobian.tr_mul(&jacobian);
            let mut accepted = None;
            while accepted.is_none() && damping < 1e6 {
                // All damped steps of a ladder are tried at once.
                let ladder: Vec<f64> = (0..4).map(|k| damping * 8.0_f64.powi(k - 1)).collect();
                let trials: Vec<Option<Point>> = ladder
                    .par_iter()
                    .map(|damping| {
                        let mut matrix = normal.clone();
                        let mut rhs = -gradient.clone();
                        for j in 0..point.x.len() {
                            matrix[(j, j)] += damping * (normal[(j, j)] + 1e-3);
                            if held[j] {
                                matrix.row_mut(j).fill(0.0);
                                matrix.column_mut(j).fill(0.0);
                                matrix[(j, j)] = 1.0;
                                rhs[j] = 0.0;
                            }
                        }
                        let x = &point.x + matrix.cholesky()?.solve(&rhs);
                        self.evaluate(x.map(|v| v.clamp(0.0, 1.0)))
                    })
                    .collect();
                let best = trials
                    .into_iter()
                    .zip(&ladder)
                    .filter_map(|(trial, damping)| trial.map(|trial| (trial, *damping)))
                    .min_by(|(a, _), (b, _)| a.cost.total_cmp(&b.cost));
                match best {
                    Some((trial, used)) if trial.cost < point.cost => {
                        damping = (0.5 * used).max(1e-8);
                        accepted = Some(trial);
                    }
                    _ => damping *= 512.0,
                }
            }
            let Some(accepted) = accepted else {
                return (point, jacobian, iteration);
            };
            point = accepted;
            jacobian = self.jacobian(&point);
            if point.cost > (1.0 - self.options.tolerance) * before {
                return (point, jacobian, iteration + 1);
            }
        }
        (point, jacobian, self.options.max_iterations)
    }
}
