//! Linear least squares, plain and with a ridge, through triangular factors (TSQR).
//!
//! The rows `[X | Y]` of one recording are reduced to the triangular factor of their QR decomposition; factors
//! of several recordings merge by stacking and factoring again (Demmel et al., "Communication-optimal parallel
//! and sequential QR and LU factorizations", 2012, Sec. 2). Fits are solved from the merged factor. Trials of a
//! cross-validation, of which there are many, are solved from [`Gram`] matrices, where leaving a recording out
//! is a subtraction; and so are fits of more rows than memory holds, where the conditioning allows it
//! ([`Gram::solution`]).

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, MatRef, Par, Side};

/// Diagonal of an equilibrated triangular factor below this: its columns depend on each other.
const DEPENDENT: f64 = 1e-11;
/// A column that varies by less than this share of its norm is constant.
const NO_VARIATION: f64 = 1e-7;
/// Added to the strengths where columns depend on each other, so that the fit is unique.
const DEPENDENT_RIDGE: f64 = 1e-9;
/// Added to the strengths of a trial, so that the Cholesky factor of its Gram matrix exists.
const TRIAL_RIDGE: f64 = 1e-12;

/// What is held back in `min ‖Y − XΘ‖² + Σ_j strengths_j (‖x_j‖ θ_j)²`, `x_j` being X's columns, centred if there
/// is an intercept. A strength is dimensionless: it compares with the squared norm 1 of an equilibrated column,
/// whatever the number of rows.
#[derive(Debug, Clone)]
pub(crate) struct Penalty {
    /// Whether column 0 of X is the constant; it is not penalized.
    pub intercept: bool,
    /// One per column of X behind the intercept, ≥ 0.
    pub strengths: Vec<f64>,
}

/// Typical error of a sum of products of two equilibrated columns.
const GRAM_ROUNDING: f64 = 1e-15;

/// A solution and how it was determined.
pub(crate) struct Solution {
    /// Regressors × targets.
    pub theta: Mat<f64>,
    /// Condition number of the equilibrated regressors behind the intercept.
    pub condition_number: f64,
    /// Sum of squared residuals per target.
    pub residual_squares: Vec<f64>,
    /// By what share the largest residual's norm may exceed the least one, for rounding.
    pub excess: f64,
}

/// Triangular factor of `[X | Y]`.
pub(crate) struct TriangularFactor {
    /// Observations that went in.
    pub rows: usize,
    /// Columns of X.
    regressors: usize,
    /// Upper triangular (or shorter than wide, if there were few rows).
    r: Mat<f64>,
}

/// `[X | Y]ᵀ [X | Y]`.
#[derive(Clone)]
pub(crate) struct Gram {
    rows: usize,
    regressors: usize,
    g: Mat<f64>,
}

impl TriangularFactor {
    /// Reduces the rows `[X | Y]`, of which the first `regressors` columns are X.
    pub fn of_rows(rows: Mat<f64>, regressors: usize) -> Self {
        let count = rows.nrows();
        let r = if count <= rows.ncols() {
            rows
        } else {
            triangle(rows.as_ref())
        };
        Self {
            rows: count,
            regressors,
            r,
        }
    }

    /// The factor of `rows` rows with these entries, as [`Self::columns`] gives them.
    pub fn from_columns(rows: usize, regressors: usize, width: usize, columns: &[f64]) -> Self {
        let r = MatRef::from_column_major_slice(columns, columns.len() / width, width).to_owned();
        Self { rows, regressors, r }
    }

    /// The number of columns, and the entries, column-major.
    pub fn columns(&self) -> (usize, Vec<f64>) {
        let width = self.r.ncols();
        let entries = (0..width).flat_map(|column| self.r.col_as_slice(column).iter().copied());
        (width, entries.collect())
    }

    /// The factor of all rows behind `parts` (not empty, of equal width), in their order.
    pub fn merge<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        let parts: Vec<&Self> = parts.into_iter().collect();
        let height = parts.iter().map(|part| part.r.nrows()).sum();
        let mut stacked = Mat::zeros(height, parts[0].r.ncols());
        let mut top = 0;
        for part in &parts {
            stacked.subrows_mut(top, part.r.nrows()).copy_from(&part.r);
            top += part.r.nrows();
        }
        Self {
            rows: parts.iter().map(|part| part.rows).sum(),
            regressors: parts[0].regressors,
            r: triangle(stacked.as_ref()),
        }
    }

    /// Columns of X.
    pub fn regressors(&self) -> usize {
        self.regressors
    }

    /// The same rows as a Gram matrix.
    pub fn gram(&self) -> Gram {
        Gram {
            rows: self.rows,
            regressors: self.regressors,
            g: self.r.transpose() * &self.r,
        }
    }

    /// Θ (regressors × targets).
    pub fn solve(&self, penalty: &Penalty) -> Mat<f64> {
        let p = self.regressors;
        let first = usize::from(penalty.intercept);
        // Behind row and column 0 of the factor stands the centred problem.
        let (scale, equilibrated) = self.equilibrated(first);
        let floor = if dependent(&equilibrated, p - first) {
            DEPENDENT_RIDGE
        } else {
            0.0
        };
        let solved = if floor == 0.0 && penalty.strengths.iter().all(|strength| *strength == 0.0) {
            equilibrated
        } else {
            let diagonal = |j: usize| (penalty.strengths[j] + floor).sqrt();
            let width = equilibrated.ncols();
            let held_back = Mat::from_fn(p - first, width, |i, j| if i == j { diagonal(j) } else { 0.0 });
            triangle(faer::concat![[equilibrated], [held_back]].as_ref())
        };
        let mut theta = solved
            .submatrix(0, p - first, p - first, solved.ncols() - (p - first))
            .to_owned();
        let triangular = solved.submatrix(0, 0, p - first, p - first);
        solve_upper_triangular_in_place(triangular, theta.as_mut(), Par::Seq);
        let row = |column: usize| self.r[(0, column)] / self.r[(0, 0)];
        with_intercept(
            theta,
            &scale,
            penalty.intercept.then_some(&row as &dyn Fn(usize) -> f64),
        )
    }

    /// Θ and what it leaves; `None` if the singular values do not converge.
    pub fn solution(&self, penalty: &Penalty) -> Option<Solution> {
        let theta = self.solve(penalty);
        Some(Solution {
            condition_number: self.condition_number(penalty.intercept)?,
            residual_squares: self.residual_squares(&theta),
            excess: 0.0,
            theta,
        })
    }

    /// Sum of squared residuals of `theta` per target.
    fn residual_squares(&self, theta: &Mat<f64>) -> Vec<f64> {
        let (p, width) = (self.regressors, self.r.ncols());
        let residuals = self.r.subcols(p, width - p) - self.r.subcols(0, p) * theta;
        residuals
            .col_iter()
            .map(|target| target.squared_norm_l2())
            .collect()
    }

    /// Largest over smallest singular value of the equilibrated regressors behind the intercept, those that do
    /// not vary left out; infinite if they depend on each other. `None` if the iteration does not converge.
    pub fn condition_number(&self, intercept: bool) -> Option<f64> {
        let first = usize::from(intercept);
        let (scale, equilibrated) = self.equilibrated(first);
        let varying = scale.iter().filter(|scale| **scale > 0.0).count();
        let x = equilibrated.subcols(0, self.regressors - first);
        let singular_values = x.singular_values().ok()?;
        let smallest = varying.checked_sub(1).and_then(|last| singular_values.get(last));
        Some(smallest.map_or(f64::INFINITY, |smallest| singular_values[0] / smallest))
    }

    /// 1 / norms of X's columns behind the first `first`, and the factor behind them with these divided out.
    fn equilibrated(&self, first: usize) -> (Vec<f64>, Mat<f64>) {
        let (height, width) = (self.r.nrows(), self.r.ncols());
        let rest = self.r.submatrix(first, first, height - first, width - first);
        let scale: Vec<f64> = (0..self.regressors - first)
            .map(|j| inverse(rest.col(j).norm_l2(), self.r.col(first + j).norm_l2()))
            .collect();
        let divided = |i: usize, j: usize| rest[(i, j)] * scale.get(j).copied().unwrap_or(1.0);
        let equilibrated = Mat::from_fn(height - first, width - first, divided);
        (scale, equilibrated)
    }
}

impl Gram {
    /// The Gram matrix without the rows of `other`.
    pub fn without(&self, other: &Self) -> Self {
        Self {
            rows: self.rows - other.rows,
            regressors: self.regressors,
            g: &self.g - &other.g,
        }
    }

    /// `[X | Y]ᵀ [X | Y]` of that many rows, the first `regressors` columns being X.
    pub fn new(rows: usize, regressors: usize, g: Mat<f64>) -> Self {
        Self { rows, regressors, g }
    }

    /// The matrix.
    #[cfg(test)]
    pub fn matrix(&self) -> &Mat<f64> {
        &self.g
    }

    /// Θ as [`TriangularFactor::solve`] gives it, with about half the digits: for trials.
    pub fn solve(&self, penalty: &Penalty) -> Mat<f64> {
        let Equilibrated { scale, normal, right } = self.equilibrated(penalty);
        let theta = match held_back(&normal, TRIAL_RIDGE).llt(Side::Lower) {
            Ok(factor) => factor.solve(right),
            // Columns that depend on each other.
            Err(_) => held_back(&normal, DEPENDENT_RIDGE).full_piv_lu().solve(right),
        };
        self.original(theta, &scale, penalty)
    }

    /// Θ, and what rounding may have done to it; `None` if the normal equations are not positive definite in floating
    /// point, or an eigenvalue iteration does not converge.
    ///
    /// An error E of the Gram matrix G of equilibrated columns moves the predictions by `‖X δθ‖² = (Eθ)ᵀ G⁻¹ Eθ`, about
    /// `η² ‖θ‖² tr G⁻¹` for independent errors of size η. What that adds to the residual is orthogonal to it, and so of
    /// second order: `(‖X δθ‖ / ‖r‖)² / 2` of its norm.
    pub fn solution(&self, penalty: &Penalty) -> Option<Solution> {
        let Equilibrated { scale, normal, right } = self.equilibrated(penalty);
        let scaled = normal.llt(Side::Lower).ok()?.solve(right);
        let eigenvalues = normal.self_adjoint_eigenvalues(Side::Lower).ok()?;
        let (smallest, largest) = (*eigenvalues.first()?, *eigenvalues.last()?);
        let condition_number = (largest / smallest).sqrt();
        let spread = eigenvalues.iter().map(|value| value.recip()).sum::<f64>().sqrt();
        // Centring cancels what the columns' means have in common.
        let first = usize::from(penalty.intercept);
        let cancelled = (scale.iter().enumerate())
            .map(|(j, scale)| self.g[(first + j, first + j)] * scale.powi(2))
            .fold(1.0, f64::max);
        let sizes: Vec<f64> = scaled.col_iter().map(|column| column.norm_l2()).collect();
        let theta = self.original(scaled, &scale, penalty);
        let residual_squares = self.residual_squares(&theta);
        let excess = sizes.iter().zip(&residual_squares).map(|(size, square)| {
            let moved = GRAM_ROUNDING * cancelled * size * spread;
            if moved == 0.0 {
                0.0
            } else {
                0.5 * moved.powi(2) / square
            }
        });
        let excess = excess.fold(0.0, f64::max);
        (condition_number.is_finite() && excess.is_finite()).then_some(Solution {
            theta,
            condition_number,
            residual_squares,
            excess,
        })
    }

    /// Sum of squared residuals of `theta` per target.
    fn residual_squares(&self, theta: &Mat<f64>) -> Vec<f64> {
        let targets = theta.ncols();
        let combination = faer::concat![[theta], [-Mat::<f64>::identity(targets, targets)]];
        let product = &self.g * &combination;
        (0..targets)
            .map(|target| (combination.col(target).transpose() * product.col(target)).max(0.0))
            .collect()
    }

    /// The normal equations of equilibrated regressors, centred if there is an intercept.
    fn equilibrated(&self, penalty: &Penalty) -> Equilibrated {
        let (p, width) = (self.regressors, self.g.ncols());
        let first = usize::from(penalty.intercept);
        let mean = |j: usize| self.mean(penalty, j);
        let centred = Mat::from_fn(p - first, width - first, |i, j| {
            self.g[(i + first, j + first)] - mean(i + first) * mean(j + first) * self.g[(0, 0)]
        });
        let norm = |square: f64| square.max(0.0).sqrt();
        let scale: Vec<f64> = (0..p - first)
            .map(|j| inverse(norm(centred[(j, j)]), norm(self.g[(first + j, first + j)])))
            .collect();
        let normal = Mat::from_fn(p - first, p - first, |i, j| {
            let held_back = if i == j { penalty.strengths[i] } else { 0.0 };
            centred[(i, j)] * scale[i] * scale[j] + held_back
        });
        let right = Mat::from_fn(p - first, width - p, |i, j| {
            centred[(i, p - first + j)] * scale[i]
        });
        Equilibrated { scale, normal, right }
    }

    /// Mean of column `j`, or 0 without an intercept.
    fn mean(&self, penalty: &Penalty, j: usize) -> f64 {
        if penalty.intercept {
            self.g[(0, j)] / self.g[(0, 0)]
        } else {
            0.0
        }
    }

    /// Undoes [`Self::equilibrated`].
    fn original(&self, scaled: Mat<f64>, scale: &[f64], penalty: &Penalty) -> Mat<f64> {
        let mean = |j: usize| self.mean(penalty, j);
        with_intercept(
            scaled,
            scale,
            penalty.intercept.then_some(&mean as &dyn Fn(usize) -> f64),
        )
    }
}

/// Normal equations `normal · θ / scale = right`.
struct Equilibrated {
    /// 1 / norms of the regressors behind the intercept.
    scale: Vec<f64>,
    normal: Mat<f64>,
    right: Mat<f64>,
}

/// `normal` with more on its diagonal.
fn held_back(normal: &Mat<f64>, more: f64) -> Mat<f64> {
    let (n, added) = (normal.nrows(), |i, j| if i == j { more } else { 0.0 });
    Mat::from_fn(n, n, |i, j| normal[(i, j)] + added(i, j))
}

/// R of the QR decomposition.
fn triangle(rows: MatRef<'_, f64>) -> Mat<f64> {
    rows.qr().thin_R().to_owned()
}

/// 1 / norm, or 0 for a column that is constant, `whole` being its norm before it was centred: it gets
/// coefficient 0.
fn inverse(norm: f64, whole: f64) -> f64 {
    if norm > NO_VARIATION * whole {
        1.0 / norm
    } else {
        0.0
    }
}

fn dependent(equilibrated: &Mat<f64>, p: usize) -> bool {
    equilibrated.nrows() < p || (0..p).any(|j| equilibrated[(j, j)].abs() < DEPENDENT)
}

/// Undoes the equilibration and puts the intercept `mean(y) − Σ mean(x_j) θ_j` in front.
fn with_intercept(scaled: Mat<f64>, scale: &[f64], mean: Option<&dyn Fn(usize) -> f64>) -> Mat<f64> {
    let first = usize::from(mean.is_some());
    let p = scaled.nrows() + first;
    let mut theta = Mat::from_fn(p, scaled.ncols(), |i, j| {
        if i < first {
            0.0
        } else {
            scale[i - first] * scaled[(i - first, j)]
        }
    });
    if let Some(mean) = mean {
        for target in 0..theta.ncols() {
            let rest: f64 = (1..p).map(|i| mean(i) * theta[(i, target)]).sum();
            theta[(0, target)] = mean(p + target) - rest;
        }
    }
    theta
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const REGRESSORS: usize = 6;

    /// Random `[1, x_1 … x_5 | y_1 y_2]` with columns of very different size.
    fn rows(count: usize, seed: u64) -> Mat<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        Mat::from_fn(count, REGRESSORS + 2, |_, column| match column {
            0 => 1.0,
            _ => 10.0_f64.powi(column as i32 % 4 - 2) * (3.0 + random.random_range(-1.0..1.0)),
        })
    }

    fn penalty(strength: f64) -> Penalty {
        Penalty {
            intercept: true,
            strengths: vec![strength; REGRESSORS - 1],
        }
    }

    /// Gradient of the penalized sum of squares, which vanishes at the solution, per equilibrated column.
    fn largest_gradient(rows: &Mat<f64>, theta: &Mat<f64>, strength: f64) -> f64 {
        let (x, y) = (rows.subcols(0, REGRESSORS), rows.subcols(REGRESSORS, 2));
        let gradient = x.transpose() * (y - x * theta);
        let mut largest: f64 = 0.0;
        for column in 0..REGRESSORS {
            let values: Vec<f64> = x.col(column).iter().copied().collect();
            let mean = if column == 0 {
                0.0
            } else {
                values.iter().sum::<f64>() / values.len() as f64
            };
            let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
            let held_back = if column == 0 { 0.0 } else { strength * square };
            for target in 0..2 {
                let total = gradient[(column, target)] - held_back * theta[(column, target)];
                largest = largest.max(total.abs() / square.sqrt());
            }
        }
        largest
    }

    #[test]
    fn the_solution_is_stationary() {
        let rows = rows(40, 1);
        let factor = TriangularFactor::of_rows(rows.clone(), REGRESSORS);
        for strength in [0.0, 1e-3, 1.0] {
            let theta = factor.solve(&penalty(strength));
            assert!(largest_gradient(&rows, &theta, strength) < 1e-12);
            let trial = factor.gram().solve(&penalty(strength));
            assert!(largest_gradient(&rows, &trial, strength) < 1e-9);
        }
    }

    #[test]
    fn merging_and_leaving_out_are_the_same_fit() {
        let whole = rows(60, 2);
        let part = |from: usize, count: usize| {
            TriangularFactor::of_rows(whole.subrows(from, count).to_owned(), REGRESSORS)
        };
        let parts = [part(0, 20), part(20, 3), part(23, 37)];
        let merged = TriangularFactor::merge(&parts).solve(&penalty(1e-2));
        let direct = TriangularFactor::of_rows(whole.clone(), REGRESSORS).solve(&penalty(1e-2));
        assert!((&merged - &direct).norm_max() < 1e-12);
        let kept = TriangularFactor::merge([&parts[0], &parts[2]]);
        assert_eq!(kept.rows, 57);
        let left_out = TriangularFactor::merge(&parts).gram().without(&parts[1].gram());
        let difference = kept.solve(&penalty(1e-2)) - left_out.solve(&penalty(1e-2));
        assert!(difference.norm_max() < 1e-9);
    }

    #[test]
    fn constant_and_dependent_columns_do_not_blow_up() {
        let mut rows = rows(40, 3);
        for row in 0..40 {
            rows[(row, 2)] = 7.0;
            rows[(row, 4)] = 2.0 * rows[(row, 3)] - 1.0;
        }
        let factor = TriangularFactor::of_rows(rows, REGRESSORS);
        for theta in [factor.solve(&penalty(0.0)), factor.gram().solve(&penalty(0.0))] {
            assert_eq!(theta[(2, 0)], 0.0, "a constant column gets no coefficient");
            assert!(theta.norm_max() < 1e3);
        }
        assert!(factor.condition_number(true).unwrap() > 1e12);
    }

    #[test]
    fn equilibration_makes_units_irrelevant() {
        let rows = rows(50, 4);
        let other_units = Mat::from_fn(50, REGRESSORS + 2, |i, j| {
            rows[(i, j)] * if j == 3 { 1e6 } else { 1.0 }
        });
        let (factor, other) = (
            TriangularFactor::of_rows(rows, REGRESSORS),
            TriangularFactor::of_rows(other_units, REGRESSORS),
        );
        let (theta, other_theta) = (factor.solve(&penalty(0.1)), other.solve(&penalty(0.1)));
        assert!((theta[(3, 0)] - 1e6 * other_theta[(3, 0)]).abs() < 1e-9 * theta[(3, 0)].abs());
        let (condition, other_condition) = (factor.condition_number(true), other.condition_number(true));
        assert!((condition.unwrap() / other_condition.unwrap() - 1.0).abs() < 1e-6);
    }
}
