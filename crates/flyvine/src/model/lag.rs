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

use super::error::{ModelError, require_finite, require_len};
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};

/// Length of the state x: quadrotor position, attitude vector part, end-effector position.
pub const STATE_LEN: usize = 9;
/// Row of the end-effector height in the state.
pub const HEIGHT_ROW: usize = 8;
/// Most lags a model may have.
pub const MAX_LAGS: usize = 12;
/// Longest regressor `w = (z, u)`.
const MAX_REGRESSOR_LEN: usize = MAX_LAGS * STATE_LEN + 6;

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
    /// p × p, row-major, symmetric.
    hessian: Vec<f64>,
}

/// One fitted predictor at one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "LagModelFile", into = "LagModelFile")]
pub struct LagModel {
    lags: usize,
    inputs: CommandInputs,
    /// c (9).
    offset: Vec<f64>,
    /// l (9 × p), row-major.
    linear: Vec<f64>,
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
            let hessian = hessian_from_upper_triangle(&terms.upper_triangle, p);
            rows.push(QuadraticRow {
                row: terms.row,
                hessian,
            });
        }
        Ok(Self {
            lags,
            inputs,
            offset,
            linear,
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
    pub fn linear(&self) -> &[f64] {
        &self.linear
    }

    /// Quadratic coefficients of the rows that have them.
    pub fn quadratic(&self) -> Vec<QuadraticTerms> {
        let p = self.regressor_len();
        let upper_triangle = |hessian: &[f64]| {
            (0..p)
                .flat_map(|i| (i..p).map(move |j| (i, j)))
                .map(|(i, j)| hessian[i * p + j] * if i == j { 0.5 } else { 1.0 })
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
        let mix = |array: &dyn Fn(&Self) -> &[f64]| -> Vec<f64> {
            let value = |index: usize| {
                parts
                    .iter()
                    .map(|(weight, model)| weight * array(model)[index])
                    .sum()
            };
            (0..array(first).len()).map(value).collect()
        };
        let quadratic_row = |(index, quadratic): (usize, &QuadraticRow)| QuadraticRow {
            row: quadratic.row,
            hessian: mix(&|model| &model.quadratic[index].hessian),
        };
        Self {
            lags: first.lags,
            inputs: first.inputs,
            offset: mix(&|model| &model.offset),
            linear: mix(&|model| &model.linear),
            quadratic: first.quadratic.iter().enumerate().map(quadratic_row).collect(),
        }
    }
}

impl Dynamics for LagModel {
    fn state_len(&self) -> usize {
        self.lags * STATE_LEN
    }

    fn command_len(&self) -> usize {
        self.inputs.len()
    }

    fn fresh_len(&self) -> usize {
        STATE_LEN
    }

    fn step(&self, _knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        let p = w.len();
        for row in 0..STATE_LEN {
            fresh[row] = self.offset[row] + dot(&self.linear[row * p..(row + 1) * p], w);
        }
        for QuadraticRow { row, hessian } in &self.quadratic {
            let doubled: f64 = (0..p).map(|i| w[i] * dot(&hessian[i * p..(i + 1) * p], w)).sum();
            fresh[*row] += 0.5 * doubled;
        }
    }

    fn jacobian(&self, _knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        let p = w.len();
        jacobian.copy_from_slice(&self.linear);
        for QuadraticRow { row, hessian } in &self.quadratic {
            for i in 0..p {
                jacobian[row * p + i] += dot(&hessian[i * p..(i + 1) * p], w);
            }
        }
    }

    fn add_curvature(
        &self,
        _knot: usize,
        _state: &[f64],
        _command: &[f64],
        adjoint: &[f64],
        scale: f64,
        hessian: &mut [f64],
    ) {
        for quadratic in &self.quadratic {
            let factor = scale * adjoint[quadratic.row];
            for (sum, value) in hessian.iter_mut().zip(&quadratic.hessian) {
                *sum += factor * value;
            }
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

/// `w = (z, u)` in `buffer`.
fn regressor<'a>(state: &[f64], command: &[f64], buffer: &'a mut [f64; MAX_REGRESSOR_LEN]) -> &'a [f64] {
    let (n, m) = (state.len(), command.len());
    buffer[..n].copy_from_slice(state);
    buffer[n..n + m].copy_from_slice(command);
    &buffer[..n + m]
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

/// Four partial sums, so that the compiler can use vector registers.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a_blocks, b_blocks) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = a_blocks
        .remainder()
        .iter()
        .zip(b_blocks.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a_blocks.zip(b_blocks) {
        for lane in 0..4 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}

/// A model as it stands in a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LagModelFile {
    lags: usize,
    inputs: CommandInputs,
    offset: Vec<f64>,
    /// 9 rows of p.
    linear: Vec<Vec<f64>>,
    quadratic: Vec<QuadraticTerms>,
}

impl From<LagModel> for LagModelFile {
    fn from(model: LagModel) -> Self {
        Self {
            lags: model.lags,
            inputs: model.inputs,
            linear: model
                .linear
                .chunks(model.regressor_len())
                .map(<[f64]>::to_vec)
                .collect(),
            quadratic: model.quadratic(),
            offset: model.offset,
        }
    }
}

impl TryFrom<LagModelFile> for LagModel {
    type Error = ModelError;

    fn try_from(file: LagModelFile) -> Result<Self, ModelError> {
        require_lags(file.lags)?;
        let p = file.lags * STATE_LEN + file.inputs.len();
        for (row, values) in file.linear.iter().enumerate() {
            require_len(&format!("linear coefficients of row {row}"), values, p)?;
        }
        Self::new(
            file.lags,
            file.inputs,
            file.offset,
            file.linear.concat(),
            &file.quadratic,
        )
    }
}
