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
use crate::kernel::{self, Entries};
use crate::trajopt::Dynamics;
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
        self.linear_step(w, fresh);
        for quadratic in &self.quadratic {
            let mut slope = [0.0; MAX_REGRESSOR_LEN];
            fresh[quadratic.row] += quadratic.value(w, &mut slope[..w.len()]);
        }
    }

    fn linearize(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        let p = self.regressor_len();
        self.linear_step(w, fresh);
        let rows = jacobian.chunks_exact_mut(p);
        for (row, linear) in rows.zip(self.linear.chunks_exact(w.len())) {
            row.copy_from_slice(&linear[..p]);
        }
        for quadratic in &self.quadratic {
            let mut slope = [0.0; MAX_REGRESSOR_LEN];
            fresh[quadratic.row] += quadratic.value(w, &mut slope[..w.len()]);
            add(&mut jacobian[quadratic.row * p..][..p], &slope);
        }
    }

    fn linearize_padded(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        stride: usize,
        jacobian: &mut [f64],
    ) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        self.linear_step(w, fresh);
        // Its rows are padded like those of `jacobian`.
        jacobian.copy_from_slice(&self.linear);
        for quadratic in &self.quadratic {
            let rows = quadratic.row * stride..(quadratic.row + 1) * stride;
            let slope = &mut jacobian[rows.clone()];
            slope.fill(0.0);
            fresh[quadratic.row] += quadratic.value(w, slope);
            add(slope, &self.linear[rows]);
        }
    }

    fn add_curvature(
        &self,
        _knot: usize,
        _state: &[f64],
        _command: &[f64],
        adjoint: &[f64],
        _stride: usize,
        hessian: &mut [f64],
    ) {
        for quadratic in &self.quadratic {
            // Its rows are padded like those of `hessian`.
            kernel::add_transpose_vector(&quadratic.hessian, &[adjoint[quadratic.row]], hessian);
        }
    }
}

impl LagModel {
    /// `c + L w`, with w padded.
    fn linear_step(&self, w: &[f64], fresh: &mut [f64]) {
        kernel::multiply(&self.linear, w, fresh);
        for (entry, offset) in fresh.iter_mut().zip(&self.offset) {
            *entry += offset;
        }
    }
}

/// `to += from`, as far as `to` goes.
fn add(to: &mut [f64], from: &[f64]) {
    for (entry, addend) in to.iter_mut().zip(from) {
        *entry += addend;
    }
}

impl QuadraticRow {
    /// `½ wᵀ H w`, with w padded; adds its gradient `H w` to `slope`.
    fn value(&self, w: &[f64], slope: &mut [f64]) -> f64 {
        kernel::add_transpose_vector(&self.hessian, &w[..self.hessian.len() / w.len()], slope);
        0.5 * w.iter().zip(slope).map(|(w, slope)| w * *slope).sum::<f64>()
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

/// `w = (z, u, 0…)` in `buffer`, padded.
fn regressor<'a>(state: &[f64], command: &[f64], buffer: &'a mut [f64; MAX_REGRESSOR_LEN]) -> &'a [f64] {
    let (n, m) = (state.len(), command.len());
    buffer[..n].copy_from_slice(state);
    buffer[n..n + m].copy_from_slice(command);
    &buffer[..kernel::padded(n + m)]
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
                .linear()
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A model with random coefficients and quadratic terms in `quadratic_rows`.
    pub(crate) fn random_model(
        lags: usize,
        inputs: CommandInputs,
        quadratic_rows: &[usize],
        seed: u64,
    ) -> LagModel {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |count: usize| {
            (0..count)
                .map(|_| random.random_range(-1.0..1.0))
                .collect::<Vec<f64>>()
        };
        let p = lags * STATE_LEN + inputs.len();
        let (offset, linear) = (draw(STATE_LEN), draw(STATE_LEN * p));
        let quadratic: Vec<QuadraticTerms> = quadratic_rows
            .iter()
            .map(|&row| QuadraticTerms {
                row,
                upper_triangle: draw(p * (p + 1) / 2),
            })
            .collect();
        LagModel::new(lags, inputs, offset, linear, &quadratic).unwrap()
    }

    fn random_point(model: &LagModel, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |count: usize| (0..count).map(|_| random.random_range(-1.0..1.0)).collect();
        (draw(model.state_len()), draw(model.command_len()))
    }

    #[test]
    fn step_is_the_polynomial() {
        let model = random_model(3, CommandInputs::Position, &[HEIGHT_ROW], 1);
        let (z, u) = random_point(&model, 2);
        let w = [z.clone(), u.clone()].concat();
        let mut fresh = [0.0; STATE_LEN];
        model.step(0, &z, &u, &mut fresh);
        let terms = &model.quadratic()[0].upper_triangle;
        let pairs = (0..30).flat_map(|i| (i..30).map(move |j| (i, j)));
        let products: f64 = pairs.zip(terms).map(|((i, j), a)| a * w[i] * w[j]).sum();
        for row in 0..STATE_LEN {
            let linear: f64 = w
                .iter()
                .zip(&model.linear()[row * 30..])
                .map(|(w, l)| w * l)
                .sum();
            let expected = model.offset()[row] + linear + if row == HEIGHT_ROW { products } else { 0.0 };
            assert!(
                (fresh[row] - expected).abs() < 1e-12,
                "row {row}: {} against {expected}",
                fresh[row]
            );
        }
        assert_eq!(
            terms.len() + 30 + 1,
            496,
            "coefficients of the paper's height row"
        );
    }

    #[test]
    fn jacobian_and_curvature_agree_with_finite_differences() {
        for (lags, inputs, rows) in [
            (3, CommandInputs::Position, vec![HEIGHT_ROW]),
            (5, CommandInputs::PositionAndVelocity, vec![0, 6, HEIGHT_ROW]),
            (1, CommandInputs::Position, vec![]),
        ] {
            let model = random_model(lags, inputs, &rows, 3);
            let (z, u) = random_point(&model, 4);
            let (n, p) = (model.state_len(), model.regressor_len());
            let adjoint: Vec<f64> = (0..STATE_LEN).map(|i| 0.3 * i as f64 - 1.0).collect();
            let mut jacobian = vec![0.0; STATE_LEN * p];
            model.jacobian(0, &z, &u, &mut jacobian);
            let stride = kernel::padded(p);
            let mut curvature = vec![0.0; p * stride];
            model.add_curvature(0, &z, &u, &adjoint, stride, &mut curvature);
            // Polynomials of degree two: central differences are exact but for rounding.
            let h = 1e-3;
            let at = |column: usize, delta: f64| {
                let mut w = [z.clone(), u.clone()].concat();
                w[column] += delta;
                let (mut fresh, mut jacobian) = (vec![0.0; STATE_LEN], vec![0.0; STATE_LEN * p]);
                model.step(0, &w[..n], &w[n..], &mut fresh);
                model.jacobian(0, &w[..n], &w[n..], &mut jacobian);
                (fresh, jacobian)
            };
            for column in 0..p {
                let ((plus, jacobian_plus), (minus, jacobian_minus)) = (at(column, h), at(column, -h));
                for row in 0..STATE_LEN {
                    let difference = (plus[row] - minus[row]) / (2.0 * h);
                    let exact = jacobian[row * p + column];
                    assert!(
                        (difference - exact).abs() < 1e-6 * exact.abs().max(1.0),
                        "row {row}, {column}"
                    );
                }
                for other in 0..p {
                    let along = |jacobian: &[f64]| -> f64 {
                        (0..STATE_LEN)
                            .map(|row| adjoint[row] * jacobian[row * p + other])
                            .sum()
                    };
                    let difference = (along(&jacobian_plus) - along(&jacobian_minus)) / (2.0 * h);
                    let exact = curvature[column * stride + other];
                    assert!(
                        (difference - exact).abs() < 1e-6 * exact.abs().max(1.0),
                        "{column}, {other}"
                    );
                }
            }
        }
    }

    #[test]
    fn json_keeps_every_bit() {
        let model = random_model(3, CommandInputs::Position, &[HEIGHT_ROW], 5);
        let text = serde_json::to_string(&model).unwrap();
        assert_eq!(serde_json::from_str::<LagModel>(&text).unwrap(), model);
    }

    #[test]
    fn wrong_shapes_and_values_are_named() {
        let message = |offset: usize, linear: usize, terms: usize, value: f64| {
            let quadratic = QuadraticTerms {
                row: HEIGHT_ROW,
                upper_triangle: vec![0.0; terms],
            };
            LagModel::new(
                3,
                CommandInputs::Position,
                vec![value; offset],
                vec![0.0; linear],
                &[quadratic],
            )
            .unwrap_err()
            .to_string()
        };
        assert!(message(8, 270, 465, 0.0).contains("offset: found 8 values, expected 9"));
        assert!(message(9, 269, 465, 0.0).contains("found 269 values, expected 270"));
        assert!(message(9, 270, 464, 0.0).contains("row 8: found 464 values, expected 465"));
        assert!(message(9, 270, 465, f64::NAN).contains("offset: value 0 is not a finite number"));
        let lags = LagModel::new(0, CommandInputs::Position, vec![], vec![], &[]).unwrap_err();
        assert!(lags.to_string().contains("lags: found 0, expected 1 to 12"));
        let terms = QuadraticTerms {
            row: 8,
            upper_triangle: vec![0.0; 465],
        };
        let twice = [terms.clone(), terms];
        let duplicate = LagModel::new(3, CommandInputs::Position, vec![0.0; 9], vec![0.0; 270], &twice);
        assert!(duplicate.unwrap_err().to_string().contains("at most once"));
    }
}
