//! Linear least squares through triangular factors (TSQR).
//!
//! The rows `[X | Y]` of one recording are reduced to the triangular factor of their QR decomposition; factors
//! of several recordings merge by stacking and factoring again (Demmel et al., "Communication-optimal parallel
//! and sequential QR and LU factorizations", 2012, Sec. 2). Leaving a recording out, or scanning ridge
//! strengths, then never touches the rows again, and nothing is ever squared as in the normal equations.

use faer::{Mat, MatRef};

/// Triangular factor of `[X | Y]`.
pub(crate) struct TriangularFactor {
    /// Observations that went in.
    pub rows: usize,
    /// Columns of X.
    regressors: usize,
    /// Upper triangular (or shorter than wide, if there were few rows).
    r: Mat<f64>,
}

impl TriangularFactor {
    /// Reduces the rows `[X | Y]`, of which the first `regressors` columns are X.
    pub fn of_rows(rows: Mat<f64>, regressors: usize) -> Self {
        let count = rows.nrows();
        Self {
            rows: count,
            regressors,
            r: triangle(rows),
        }
    }

    /// The factor of all rows behind `parts` (not empty, of equal shape), in their order.
    pub fn merge<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        let parts: Vec<&Self> = parts.into_iter().collect();
        let (columns, regressors) = (parts[0].r.ncols(), parts[0].regressors);
        let height = parts.iter().map(|part| part.r.nrows()).sum();
        let mut stacked = Mat::zeros(height, columns);
        let mut top = 0;
        for part in &parts {
            stacked.subrows_mut(top, part.r.nrows()).copy_from(&part.r);
            top += part.r.nrows();
        }
        Self {
            rows: parts.iter().map(|part| part.rows).sum(),
            regressors,
            r: triangle(stacked),
        }
    }

    /// Columns of X.
    pub fn regressors(&self) -> usize {
        self.regressors
    }

    /// Root-mean-square residual of each column of Y under `coefficients` (regressors × targets).
    pub fn residual_rms(&self, coefficients: &Mat<f64>) -> Vec<f64> {
        let x = self.r.subcols(0, self.regressors);
        let y = self.r.subcols(self.regressors, self.r.ncols() - self.regressors);
        let residual = y - x * coefficients;
        let rows = self.rows.max(1) as f64;
        (0..residual.ncols())
            .map(|target| residual.col(target).norm_l2() / rows.sqrt())
            .collect()
    }
}

/// R of the QR decomposition; the rows themselves where there are no more of them than columns.
fn triangle(rows: Mat<f64>) -> Mat<f64> {
    if rows.nrows() <= rows.ncols() {
        return rows;
    }
    rows.qr().thin_R().to_owned()
}

/// `min ‖Y − XΘ‖² + λ‖DΘ‖²` for any λ, D being the norms of X's columns: the singular value decomposition of
/// the equilibrated `X D⁻¹`.
///
/// λ is dimensionless: it compares with the squared norm 1 of an equilibrated column, whatever the number of
/// rows. With an intercept, column 0 of X is the constant; it is not penalized, and the other columns are
/// centred.
pub(crate) struct RidgeSolver {
    singular_values: Vec<f64>,
    v: Mat<f64>,
    /// Uᵀ Y.
    uty: Mat<f64>,
    /// 1 / column norm; 0 for a column without variation, which gets coefficient 0.
    scale: Vec<f64>,
    intercept: Option<Intercept>,
}

/// Row 0 of the factor: `r00 θ_0 + rowᵀ θ = y`.
struct Intercept {
    r00: f64,
    row: Vec<f64>,
    y: Vec<f64>,
}

impl RidgeSolver {
    /// Decomposes `factor`; `None` if the iteration does not converge.
    pub fn new(factor: &TriangularFactor, intercept: bool) -> Option<Self> {
        let skip = usize::from(intercept);
        let (r, p) = (&factor.r, factor.regressors);
        let targets = r.ncols() - p;
        // Without an intercept, or in triangular form, rows from `skip` on hold the (centred) problem.
        let triangular = if r.nrows() <= r.ncols() {
            r.as_ref().qr().thin_R().to_owned()
        } else {
            r.clone()
        };
        let height = triangular.nrows();
        let x = triangular.submatrix(skip, skip, height - skip, p - skip);
        let y = triangular.submatrix(skip, p, height - skip, targets);
        let scale: Vec<f64> = (0..x.ncols()).map(|column| inverse_norm(x, column)).collect();
        let equilibrated = Mat::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] * scale[j]);
        let svd = equilibrated.thin_svd().ok()?;
        let intercept = intercept.then(|| Intercept {
            r00: triangular[(0, 0)],
            row: (1..p).map(|j| triangular[(0, j)]).collect(),
            y: (p..p + targets).map(|j| triangular[(0, j)]).collect(),
        });
        Some(Self {
            singular_values: svd.S().column_vector().iter().copied().collect(),
            v: svd.V().to_owned(),
            uty: svd.U().transpose() * y,
            scale,
            intercept,
        })
    }

    /// Θ (regressors × targets) for the ridge strength `ridge` ≥ 0.
    pub fn solve(&self, ridge: f64) -> Mat<f64> {
        let cutoff = f64::EPSILON * self.singular_values.len() as f64 * self.singular_values[0];
        let filter = |s: f64| if s <= cutoff { 0.0 } else { s / (s * s + ridge) };
        let filtered = Mat::from_fn(self.uty.nrows(), self.uty.ncols(), |i, j| {
            filter(self.singular_values[i]) * self.uty[(i, j)]
        });
        let scaled = &self.v * filtered;
        let skip = usize::from(self.intercept.is_some());
        let mut theta = Mat::zeros(scaled.nrows() + skip, scaled.ncols());
        for target in 0..scaled.ncols() {
            for i in 0..scaled.nrows() {
                theta[(i + skip, target)] = self.scale[i] * scaled[(i, target)];
            }
            if let Some(Intercept { r00, row, y }) = &self.intercept {
                let rest: f64 = row
                    .iter()
                    .enumerate()
                    .map(|(i, r)| r * theta[(i + 1, target)])
                    .sum();
                theta[(0, target)] = (y[target] - rest) / r00;
            }
        }
        theta
    }

    /// Largest over smallest singular value of the equilibrated regressors that vary; infinite if dependent.
    pub fn condition_number(&self) -> f64 {
        let varying = self.scale.iter().filter(|scale| **scale > 0.0).count();
        match self.singular_values.get(varying.wrapping_sub(1)) {
            Some(smallest) => self.singular_values[0] / smallest,
            None => f64::INFINITY,
        }
    }
}

/// 1 / ‖column‖, or 0 for a column that is nothing but rounding.
fn inverse_norm(x: MatRef<'_, f64>, column: usize) -> f64 {
    let norm = x.col(column).norm_l2();
    if norm > 1e-12 * x.norm_max() {
        1.0 / norm
    } else {
        0.0
    }
}
