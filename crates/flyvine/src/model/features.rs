//! Regressors of a fit.
//!
//! Linear terms are `w = (z, u)` itself. States 50 ms apart are nearly equal, so products of w's entries are
//! hopelessly collinear. Products are therefore taken of `v = T w`, an invertible change of coordinates: the
//! newest state with the end effector relative to the quadrotor, the first difference, second differences, and
//! the commanded position relative to the quadrotor. Plain least squares is the same fit in either; but a ridge
//! on products of v holds back what motion adds, and leaves alone where the arm is at rest.

use super::lag::{CommandInputs, STATE_LEN};
use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;

/// Where the end-effector position begins in x.
const TIP: usize = 6;
/// Entries of v, its first, that say where in the room the vehicle is: the quadrotor's newest position. A function of
/// the others alone is translation-equivariant: shifting the whole room shifts what it predicts.
pub(crate) const PLACE_LEN: usize = 3;

/// Number of terms of a full quadratic in p variables: 1 + p + p (p + 1) / 2.
pub(crate) fn quadratic_len(p: usize) -> usize {
    1 + p + p * (p + 1) / 2
}

/// Writes `1, w_0, …, w_{p−1}, v_0², v_0 v_1, …, v_{p−1}²` into `terms`.
pub(crate) fn quadratic_terms(w: &[f64], v: &[f64], terms: &mut [f64]) {
    let p = v.len();
    terms[0] = 1.0;
    terms[1..=p].copy_from_slice(w);
    let mut next = terms[1 + p..].iter_mut();
    for i in 0..p {
        for (&factor, term) in v[i..].iter().zip(&mut next) {
            *term = v[i] * factor;
        }
    }
}

/// The change of coordinates `v = T w`.
#[derive(Debug, Clone)]
pub(crate) struct Coordinates {
    /// p × p, entries −2 … 1.
    t: Mat<f64>,
}

impl Coordinates {
    pub fn new(lags: usize, inputs: CommandInputs) -> Self {
        let p = lags * STATE_LEN + inputs.len();
        let mut t = Mat::zeros(p, p);
        for signal in 0..STATE_LEN {
            let at = |lag: usize| lag * STATE_LEN + signal;
            t[(at(0), at(0))] = 1.0;
            for lag in 1..lags {
                // x_k − x_{k−1}, then x_{k−l+2} − 2 x_{k−l+1} + x_{k−l}.
                let stencil: &[f64] = if lag == 1 { &[-1.0, 1.0] } else { &[1.0, -2.0, 1.0] };
                for (back, &factor) in stencil.iter().enumerate() {
                    t[(at(lag), at(lag - back))] = factor;
                }
            }
        }
        for axis in 0..3 {
            t[(TIP + axis, axis)] = -1.0;
            t[(lags * STATE_LEN + axis, axis)] = -1.0;
        }
        for input in lags * STATE_LEN..p {
            t[(input, input)] = 1.0;
        }
        Self { t }
    }

    /// `v = T w`.
    pub fn apply(&self, w: &[f64], v: &mut [f64]) {
        for (i, entry) in v.iter_mut().enumerate() {
            *entry = w
                .iter()
                .enumerate()
                .map(|(j, value)| self.t[(i, j)] * value)
                .sum();
        }
    }

    /// `T⁻¹`, whose entries are whole numbers.
    pub fn inverse(&self) -> Mat<f64> {
        self.t.partial_piv_lu().inverse()
    }

    /// The coefficients on w of the linear form with coefficients `b` on the last entries of v, as many as b has:
    /// `Tᵀ b`.
    pub fn linear_on_w(&self, b: &[f64]) -> Vec<f64> {
        let first = self.t.nrows() - b.len();
        (0..self.t.ncols())
            .map(|j| (0..b.len()).map(|i| self.t[(first + i, j)] * b[i]).sum())
            .collect()
    }

    /// The coefficients on w (upper triangle) of the quadratic form with upper triangle `a` on v: those of
    /// `Tᵀ A T`.
    pub fn quadratic_on_w(&self, a: &[f64]) -> Vec<f64> {
        let p = self.t.ncols();
        let mut form = Mat::<f64>::zeros(p, p);
        let mut next = a.iter();
        for i in 0..p {
            for (j, value) in (i..p).zip(&mut next) {
                form[(i, j)] = *value;
            }
        }
        let on_w = self.t.transpose() * form * &self.t;
        let folded = |i: usize, j: usize| {
            if i == j {
                on_w[(i, i)]
            } else {
                on_w[(i, j)] + on_w[(j, i)]
            }
        };
        (0..p)
            .flat_map(|i| (i..p).map(move |j| (i, j)))
            .map(|(i, j)| folded(i, j))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_v_are_the_same_form_on_w() {
        for (lags, inputs) in [
            (3, CommandInputs::Position),
            (5, CommandInputs::PositionAndVelocity),
        ] {
            let coordinates = Coordinates::new(lags, inputs);
            let p = lags * STATE_LEN + inputs.len();
            let w: Vec<f64> = (0..p).map(|i| (1.7 * i as f64).sin()).collect();
            let a: Vec<f64> = (0..p * (p + 1) / 2).map(|i| (0.9 * i as f64).cos()).collect();
            let mut v = vec![0.0; p];
            coordinates.apply(&w, &mut v);
            let value = |coefficients: &[f64], x: &[f64]| -> f64 {
                let mut terms = vec![0.0; quadratic_len(p)];
                quadratic_terms(x, x, &mut terms);
                terms[1 + p..]
                    .iter()
                    .zip(coefficients)
                    .map(|(term, a)| term * a)
                    .sum()
            };
            let (on_v, on_w) = (value(&a, &v), value(&coordinates.quadratic_on_w(&a), &w));
            assert!(
                (on_v - on_w).abs() < 1e-9 * on_v.abs().max(1.0),
                "{on_v} against {on_w}"
            );
        }
    }

    #[test]
    fn v_is_relative_and_differences() {
        // x_k = k² in every entry of every state, k = 3, 2, 1.
        let coordinates = Coordinates::new(3, CommandInputs::Position);
        let w = [[9.0; 9], [4.0; 9], [1.0; 9]]
            .concat()
            .into_iter()
            .chain([10.0; 3])
            .collect::<Vec<f64>>();
        let mut v = [0.0; 30];
        coordinates.apply(&w, &mut v);
        let newest = [9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0];
        let expected = [newest, [5.0; 9], [2.0; 9]]
            .concat()
            .into_iter()
            .chain([1.0; 3])
            .collect::<Vec<f64>>();
        assert_eq!(v.as_slice(), expected);
    }
}
