//! Ordinary least squares and its statistics.

use super::Observations;
use crate::model::error::{ModelError, require_finite, require_len};
use faer::Mat;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{MatRef, Par};
use serde::Serialize;
use statrs::distribution::{Continuous, ContinuousCDF, FisherSnedecor, StudentsT};

/// Diagonal of the equilibrated triangular factor below this: the column depends on those before it.
const DEPENDENT: f64 = 1e-12;

/// What a least-squares fit says about itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Regression {
    /// One per regressor.
    pub coefficients: Vec<CoefficientStatistics>,
    /// Number of observations.
    pub observations: usize,
    /// Observations minus coefficients.
    pub degrees_of_freedom: usize,
    /// 1 − SSE / SST; SST about the mean if there is an intercept, about zero if not.
    pub r_squared: f64,
    /// R² adjusted for the number of coefficients.
    pub adjusted_r_squared: f64,
    /// √(SSE / degrees of freedom), in the response's unit.
    pub rmse: f64,
    /// F statistic of the fit against the constant (or, without intercept, against zero).
    pub f: f64,
    /// Probability of an F at least as large if all coefficients but the intercept were zero.
    pub f_p: f64,
    /// Durbin–Watson statistic of the residuals in their order: 2 if uncorrelated, towards 0 if positively so.
    pub durbin_watson: f64,
    /// Residual of each observation.
    pub residuals: Vec<f64>,
    /// Leverage of each observation: the diagonal of the hat matrix.
    pub leverage: Vec<f64>,
    /// Cook's distance of each observation.
    pub cooks_distance: Vec<f64>,
}

/// What a fit says about one coefficient.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CoefficientStatistics {
    /// Name of the regressor.
    pub name: String,
    /// Estimate.
    pub estimate: f64,
    /// Standard error.
    pub standard_error: f64,
    /// Estimate over standard error.
    pub t: f64,
    /// Two-sided probability of a t at least as large if the coefficient were zero.
    pub p: f64,
    /// 95 % confidence interval.
    pub confidence_95: [f64; 2],
}

/// Least squares by QR of the equilibrated columns.
///
/// # Errors
/// Wrong lengths, values that are not finite, no more observations than regressors, or a regressor that
/// depends on those before it.
pub fn regress(data: &Observations) -> Result<Regression, ModelError> {
    let design = Design::new(data)?;
    let (n, p) = (design.rows(), data.names.len());
    let (estimate, residuals) = design.solve(&data.response);
    let degrees_of_freedom = n - p;
    let dof = degrees_of_freedom as f64;
    let sse: f64 = residuals.iter().map(|r| r * r).sum();
    let mse = sse / dof;

    let center = if data.intercept {
        data.response.iter().sum::<f64>() / n as f64
    } else {
        0.0
    };
    let sst: f64 = data.response.iter().map(|y| (y - center).powi(2)).sum();
    let constants = usize::from(data.intercept);
    let r_squared = 1.0 - sse / sst;
    let f = (sst - sse) / (p - constants) as f64 / mse;

    let leverage = design.leverage();
    let cook = |(r, h): (&f64, &f64)| r * r / (p as f64 * mse) * h / (1.0 - h).powi(2);
    let steps: f64 = residuals.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let student = student(dof);
    let half_width = quantile_975(&student);
    let coefficients = (0..p).map(|j| {
        let standard_error = mse.sqrt() * design.inverse_norm(j);
        let t = estimate[j] / standard_error;
        CoefficientStatistics {
            name: data.names[j].clone(),
            estimate: estimate[j],
            standard_error,
            t,
            p: 2.0 * student.sf(t.abs()),
            confidence_95: [-1.0, 1.0].map(|side| estimate[j] + side * half_width * standard_error),
        }
    });
    Ok(Regression {
        coefficients: coefficients.collect(),
        observations: n,
        degrees_of_freedom,
        r_squared,
        adjusted_r_squared: 1.0 - (1.0 - r_squared) * (n - constants) as f64 / dof,
        rmse: mse.sqrt(),
        f,
        f_p: fisher((p - constants) as f64, dof).sf(f),
        durbin_watson: steps / sse,
        cooks_distance: residuals.iter().zip(&leverage).map(cook).collect(),
        residuals,
        leverage,
    })
}

/// The columns of a regression, equilibrated and factored.
pub(super) struct Design {
    /// Equilibrated (n × p).
    x: Mat<f64>,
    /// Norms of the columns.
    norms: Vec<f64>,
    q: Mat<f64>,
    r: Mat<f64>,
    /// R⁻¹.
    inverse: Mat<f64>,
}

impl Design {
    pub fn new(data: &Observations) -> Result<Self, ModelError> {
        let (n, p) = (data.response.len(), data.names.len());
        require_len("regressors", &data.regressors, n * p)?;
        require_finite("regressors", &data.regressors)?;
        require_finite("response", &data.response)?;
        if n <= p {
            return Err(ModelError::TooFewObservations {
                observations: n,
                coefficients: p,
            });
        }
        let raw = MatRef::from_row_major_slice(&data.regressors, n, p);
        let norms: Vec<f64> = (0..p).map(|j| raw.col(j).norm_l2()).collect();
        let x = Mat::from_fn(n, p, |i, j| {
            if norms[j] > 0.0 {
                raw[(i, j)] / norms[j]
            } else {
                0.0
            }
        });
        let qr = x.qr();
        let r = qr.thin_R().to_owned();
        if let Some(j) = (0..p).find(|&j| r[(j, j)].abs() < DEPENDENT) {
            return Err(ModelError::DependentRegressor {
                name: data.names[j].clone(),
            });
        }
        let mut inverse = Mat::identity(p, p);
        solve_upper_triangular_in_place(r.as_ref(), inverse.as_mut(), Par::Seq);
        Ok(Self {
            q: qr.compute_thin_Q(),
            r,
            x,
            norms,
            inverse,
        })
    }

    pub fn rows(&self) -> usize {
        self.x.nrows()
    }

    /// Coefficients and residuals of `response`.
    pub fn solve(&self, response: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let y = MatRef::from_column_major_slice(response, response.len(), 1);
        let mut theta = self.q.transpose() * y;
        solve_upper_triangular_in_place(self.r.as_ref(), theta.as_mut(), Par::Seq);
        self.in_units(theta, y)
    }

    /// Coefficients and residuals of `response` with the squared residuals weighted.
    pub fn solve_weighted(&self, response: &[f64], weights: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (n, p) = (self.x.nrows(), self.x.ncols());
        let weighted = Mat::from_fn(n, p, |i, j| self.x[(i, j)] * weights[i].sqrt());
        let target = Mat::from_fn(n, 1, |i, _| response[i] * weights[i].sqrt());
        let qr = weighted.qr();
        let mut theta = qr.compute_thin_Q().transpose() * target;
        solve_upper_triangular_in_place(qr.thin_R(), theta.as_mut(), Par::Seq);
        self.in_units(theta, MatRef::from_column_major_slice(response, n, 1))
    }

    fn in_units(&self, theta: Mat<f64>, y: MatRef<'_, f64>) -> (Vec<f64>, Vec<f64>) {
        let residuals = y - &self.x * &theta;
        let estimate = theta
            .col_as_slice(0)
            .iter()
            .zip(&self.norms)
            .map(|(value, norm)| value / norm);
        (estimate.collect(), residuals.col_as_slice(0).to_vec())
    }

    /// √ of the j-th diagonal entry of (XᵀX)⁻¹.
    pub fn inverse_norm(&self, j: usize) -> f64 {
        self.inverse.row(j).norm_l2() / self.norms[j]
    }

    /// Diagonal of the hat matrix Q Qᵀ.
    fn leverage(&self) -> Vec<f64> {
        (0..self.q.nrows())
            .map(|i| self.q.row(i).squared_norm_l2())
            .collect()
    }
}

fn student(dof: f64) -> StudentsT {
    StudentsT::new(0.0, 1.0, dof).expect("positive degrees of freedom")
}

fn fisher(dof_1: f64, dof_2: f64) -> FisherSnedecor {
    FisherSnedecor::new(dof_1, dof_2).expect("positive degrees of freedom")
}

/// 97.5 % quantile, polished by Newton steps on the distribution function.
fn quantile_975(student: &StudentsT) -> f64 {
    let mut t = student.inverse_cdf(0.975);
    for _ in 0..3 {
        t += (student.sf(t) - 0.025) / student.pdf(t);
    }
    t
}
