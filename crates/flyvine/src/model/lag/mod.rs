//! The lag family: `x_{k+1}` as a polynomial of the last few states and the command.
//!
//! With `w = (z, u) ∈ R^p`, `z = (x_k, x_{k-1}, …) ∈ R^{9·lags}`, row i of the prediction is
//!
//! ```text
//! f_i(w) = c_i + l_iᵀ w + ½ wᵀ H_i w
//! ```
//!
//! In the paper's structure (Jitosho et al., Sec. III-A) `c_i = 0` and `H_i = 0` in all rows but the
//! end-effector height, whose 1 + 30 + 465 coefficients are all free.

mod dynamics;
mod file;
#[cfg(test)]
pub(crate) mod tests;

use super::error::{ModelError, require_finite, require_len};
use crate::kernel::{self, Entries};
use file::LagModelFile;
use serde::{Deserialize, Serialize};

/// Length of the state x: quadrotor position, attitude vector part, end-effector position.
pub const STATE_LEN: usize = 9;
/// Row of the end-effector height in the state.
pub const HEIGHT_ROW: usize = 8;
/// Most lags a model may have.
pub const MAX_LAGS: usize = 12;
/// Room for the longest regressor `w = (z, u)`, padded.
pub(super) const MAX_REGRESSOR_LEN: usize = 120;

/// What a model takes as its command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommandInputs {
    /// Commanded quadrotor position, m (3 inputs).
    Position,
    /// Commanded position, m, then commanded velocity, m/s (6 inputs).
    PositionAndVelocity,
}

impl CommandInputs {
    /// Number of inputs.
    pub fn len(self) -> usize {
        match self {
            Self::Position => 3,
            Self::PositionAndVelocity => 6,
        }
    }

    /// Never: every model takes a command.
    pub fn is_empty(self) -> bool {
        false
    }
}

/// A quadratic row: its state row and the symmetric matrix `H = ∂²f_row/∂w²`.
#[derive(Debug, Clone, PartialEq)]
struct QuadraticRow {
    row: usize,
    /// p rows of p, symmetric; rows padded as [`kernel`] wants them.
    hessian: Entries,
}

/// One fitted predictor at one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "LagModelFile", into = "LagModelFile")]
pub struct LagModel {
    lags: usize,
    inputs: CommandInputs,
    /// c (9).
    offset: Vec<f64>,
    /// l (9 rows of p), rows padded as [`kernel`] wants them.
    linear: Entries,
    quadratic: Vec<QuadraticRow>,
}

/// The quadratic coefficients `a_ij` of `Σ_{i ≤ j} a_ij w_i w_j` in one row of the state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuadraticTerms {
    /// Row of the state that they belong to.
    pub row: usize,
    /// `a_00, a_01, …, a_0p, a_11, …`: p (p + 1) / 2 values.
    pub upper_triangle: Vec<f64>,
}

impl LagModel {
    /// Builds a model from its coefficients: `offset` (9), `linear` (9 × p, row-major, columns `w = (z, u)`,
    /// newest state first) and quadratic terms for the rows that have them.
    pub fn new(
        lags: usize,
        inputs: CommandInputs,
        offset: Vec<f64>,
        linear: Vec<f64>,
        quadratic: &[QuadraticTerms],
    ) -> Result<Self, ModelError> {
        require_lags(lags)?;
        let p = lags * STATE_LEN + inputs.len();
        require_len("model offset", &offset, STATE_LEN)?;
        require_len("model linear coefficients (9 rows)", &linear, STATE_LEN * p)?;
        require_finite("model offset", &offset)?;
        require_finite("model linear coefficients", &linear)?;
        let mut rows: Vec<QuadraticRow> = Vec::new();
        for terms in quadratic {
            if terms.row >= STATE_LEN || rows.iter().any(|known| known.row == terms.row) {
                return Err(ModelError::Unsupported {
                    what: "row of quadratic terms",
                    found: terms.row.to_string(),
                    expected: "each of 0 to 8 at most once".into(),
                });
            }
            let what = format!("quadratic coefficients of row {}", terms.row);
            require_len(&what, &terms.upper_triangle, p * (p + 1) / 2)?;
            require_finite(&what, &terms.upper_triangle)?;
            let hessian = padded_rows(&hessian_from_upper_triangle(&terms.upper_triangle, p), p);
            rows.push(QuadraticRow {
                row: terms.row,
                hessian,
            });
        }
        Ok(Self {
            lags,
            inputs,
            offset,
            linear: padded_rows(&linear, p),
            quadratic: rows,
        })
    }

    /// Number of states in z.
    pub fn lags(&self) -> usize {
        self.lags
    }

    /// What the model takes as its command.
    pub fn inputs(&self) -> CommandInputs {
        self.inputs
    }

    /// Length p of the regressor `w = (z, u)`.
    pub fn regressor_len(&self) -> usize {
        self.lags * STATE_LEN + self.inputs.len()
    }

    /// Offsets c (9).
    pub fn offset(&self) -> &[f64] {
        &self.offset
    }

    /// Linear coefficients (9 × p), row-major.
    pub fn linear(&self) -> Vec<f64> {
        let p = self.regressor_len();
        let rows = self.linear.chunks_exact(kernel::padded(p));
        rows.flat_map(|row| &row[..p]).copied().collect()
    }

    /// Quadratic coefficients of the rows that have them.
    pub fn quadratic(&self) -> Vec<QuadraticTerms> {
        let p = self.regressor_len();
        let upper_triangle = |hessian: &[f64]| {
            (0..p)
                .flat_map(|i| (i..p).map(move |j| (i, j)))
                .map(|(i, j)| hessian[i * kernel::padded(p) + j] * if i == j { 0.5 } else { 1.0 })
                .collect()
        };
        self.quadratic
            .iter()
            .map(|q| QuadraticTerms {
                row: q.row,
                upper_triangle: upper_triangle(&q.hessian),
            })
            .collect()
    }

    /// What keeps this model's coefficients from being mixed with those of `other`, if anything does.
    pub(crate) fn structure_difference(&self, other: &Self) -> Option<String> {
        let rows = |model: &Self| model.quadratic.iter().map(|q| q.row).collect::<Vec<_>>();
        if self.lags != other.lags {
            Some(format!("{} lags, not {}", other.lags, self.lags))
        } else if self.inputs != other.inputs {
            Some(format!("inputs {:?}, not {:?}", other.inputs, self.inputs))
        } else if rows(self) != rows(other) {
            Some(format!("quadratic rows {:?}, not {:?}", rows(other), rows(self)))
        } else {
            None
        }
    }

    /// `Σ_i weight_i · model_i`, coefficient by coefficient: the prediction is linear in its coefficients, so
    /// this interpolates predictions. All models must have one structure; `parts` must not be empty.
    pub(crate) fn combination(parts: &[(f64, &Self)]) -> Self {
        let first = parts[0].1;
        let mix = |array: &dyn Fn(&Self) -> &[f64]| {
            let value = |index: usize| -> f64 {
                parts
                    .iter()
                    .map(|(weight, model)| weight * array(model)[index])
                    .sum()
            };
            kernel::entries((0..array(first).len()).map(value))
        };
        let quadratic_row = |(index, quadratic): (usize, &QuadraticRow)| QuadraticRow {
            row: quadratic.row,
            hessian: mix(&|model| &model.quadratic[index].hessian),
        };
        Self {
            lags: first.lags,
            inputs: first.inputs,
            offset: mix(&|model| &model.offset).to_vec(),
            linear: mix(&|model| &model.linear),
            quadratic: first.quadratic.iter().enumerate().map(quadratic_row).collect(),
        }
    }
}

/// Refuses lag counts outside 1 to [`MAX_LAGS`].
pub(crate) fn require_lags(lags: usize) -> Result<(), ModelError> {
    if (1..=MAX_LAGS).contains(&lags) {
        return Ok(());
    }
    Err(ModelError::Unsupported {
        what: "lags",
        found: lags.to_string(),
        expected: format!("1 to {MAX_LAGS}"),
    })
}

/// Rows of `len`, each padded.
fn padded_rows(rows: &[f64], len: usize) -> Entries {
    let mut padded = kernel::zeros(rows.len() / len * kernel::padded(len));
    for (to, from) in padded
        .chunks_exact_mut(kernel::padded(len))
        .zip(rows.chunks_exact(len))
    {
        to[..len].copy_from_slice(from);
    }
    padded
}

fn hessian_from_upper_triangle(upper_triangle: &[f64], p: usize) -> Vec<f64> {
    let mut hessian = vec![0.0; p * p];
    let mut next = upper_triangle.iter();
    for i in 0..p {
        for (j, a) in (i..p).zip(&mut next) {
            hessian[i * p + j] += a;
            hessian[j * p + i] += a;
        }
    }
    hessian
}
