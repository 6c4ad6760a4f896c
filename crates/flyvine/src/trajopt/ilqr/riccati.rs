//! One knot of the Riccati recursion, exploiting the companion form.
//!
//! With `δz⁺ = (C δw, S δw)`, `C = [A B]`, and the value Hessian P split after `fresh` entries into P₁₁, P₁₂, P₂₂,
//!
//! ```text
//! W = P₁₁ C + P₁₂ S
//! [Q_uz Q_uu] = Bᵀ W + [L_uz L_uu],   K = −Q_uu⁻¹ Q_uz
//! P ← L_zz + Sᵀ P₂₂ S + Aᵀ W + (P₁₂ S)ᵀ A + Kᵀ Q_uz
//! ```
//!
//! S only selects, so products with it are copies: for three lags of nine entries and three commands this costs
//! 23 kflop instead of the 110 of dense matrices. Only upper triangles are computed and read, so P is symmetric by
//! construction; an antisymmetric part would grow from knot to knot.

use super::Shape;
use crate::kernel::{self, Rows, Wanted};

/// Value Hessian and scratch of the recursion.
#[derive(Debug, Clone)]
pub struct Riccati {
    shape: Shape,
    /// Length of a row of P.
    value_stride: usize,
    /// P of the later knot, upper triangle, with zeros to the right and below: so `P₁₂ S` and `Sᵀ P₂₂ S` are P itself,
    /// read from column `fresh` on, or from row and column `fresh` on.
    value: Vec<f64>,
    /// Room for P of this knot.
    next_value: Vec<f64>,
    /// Second derivatives of the Lagrangian at this knot beside its diagonal, n + m rows of `stride`.
    curvature: Vec<f64>,
    /// Whether there are any.
    curved: bool,
    /// P₁₁ in full, fresh rows of `stride`.
    fresh_block: Vec<f64>,
    /// W, fresh rows of `stride`.
    product: Vec<f64>,
}

impl Riccati {
    pub fn new(shape: Shape) -> Self {
        let Shape {
            state, fresh, stride, ..
        } = shape;
        let value_stride = kernel::padded(fresh + shape.width());
        let value = vec![0.0; (fresh + state + 1) * value_stride];
        let rows = vec![0.0; fresh * stride];
        Self {
            shape,
            value_stride,
            value: value.clone(),
            next_value: value,
            curvature: vec![0.0; shape.width() * stride],
            curved: false,
            fresh_block: rows.clone(),
            product: rows,
        }
    }

    /// `P_N = diag(l_zz)`.
    pub fn start(&mut self, diagonal: &[f64]) {
        self.value.fill(0.0);
        for i in 0..self.shape.state {
            self.value[i * self.value_stride + i] = diagonal[i];
        }
    }

    /// Begins a knot whose Lagrangian has a diagonal Hessian.
    pub fn begin(&mut self) {
        self.curved = false;
    }

    /// Begins a knot with other second derivatives than the diagonal's, to be added to these n + m rows of `stride`.
    pub fn begin_curved(&mut self) -> &mut [f64] {
        self.curved = true;
        self.curvature.fill(0.0);
        &mut self.curvature
    }

    /// Copies `Q_uu` (m × m, symmetric) and `Q_uz` (m × stride, zero beyond n) out, C being fresh × stride and
    /// `diagonal` that of `L_ww`.
    pub fn command_blocks(
        &mut self,
        jacobian: &[f64],
        diagonal: &[f64],
        command_hessian: &mut [f64],
        cross: &mut [f64],
    ) {
        let Shape {
            state: n,
            command: m,
            fresh,
            stride,
            ..
        } = self.shape;
        for i in 0..fresh {
            let row = &self.value[i * self.value_stride..][i..fresh];
            self.fresh_block[i * stride + i..][..row.len()].copy_from_slice(row);
            let column = self.fresh_block[i * stride + i..].iter_mut().step_by(stride);
            for (entry, &value) in column.zip(row) {
                *entry = value;
            }
        }
        let rows = |entries| Rows { entries, stride };
        let shifted = Rows {
            entries: &self.value[fresh..],
            stride: self.value_stride,
        };
        let factors = [(rows(&self.fresh_block), rows(jacobian))];
        kernel::sum_products(&[shifted], &factors, Wanted::All, stride, &mut self.product);
        let factors = [(rows(&jacobian[n..]), rows(&self.product))];
        let curvature = [rows(&self.curvature[n * stride..])];
        let addends = &curvature[..usize::from(self.curved)];
        kernel::sum_products(addends, &factors, Wanted::All, stride, cross);
        let hessian_rows = command_hessian.chunks_exact_mut(m);
        for (j, (row, hessian)) in cross.chunks_exact_mut(stride).zip(hessian_rows).enumerate() {
            hessian.copy_from_slice(&row[n..n + m]);
            hessian[j] += diagonal[n + j];
            row[n..].fill(0.0);
        }
    }

    /// P of this knot, with `gains = −Q_uu⁻¹ Q_uz` on the free commands and 0 on the held ones, m × stride as `cross`.
    pub fn finish(&mut self, jacobian: &[f64], diagonal: &[f64], gains: &[f64], cross: &[f64]) {
        let Shape {
            state, fresh, stride, ..
        } = self.shape;
        let value_stride = self.value_stride;
        let rows = |entries| Rows { entries, stride };
        let value = |from: usize| Rows {
            entries: &self.value[from..],
            stride: value_stride,
        };
        let addends = [value(fresh * value_stride + fresh), rows(&self.curvature)];
        let addends = &addends[..1 + usize::from(self.curved)];
        let factors = [
            (rows(jacobian), rows(&self.product)),
            (value(fresh), rows(jacobian)),
            (rows(gains), rows(cross)),
        ];
        let out = &mut self.next_value[..state * value_stride];
        kernel::sum_products(
            addends,
            &factors,
            Wanted::Upper { columns: state },
            value_stride,
            out,
        );
        for (entry, extra) in out.iter_mut().step_by(value_stride + 1).zip(diagonal) {
            *entry += extra;
        }
        std::mem::swap(&mut self.value, &mut self.next_value);
    }

    /// P's entry, `i ≤ j`.
    #[cfg(test)]
    pub fn value(&self, i: usize, j: usize) -> f64 {
        self.value[i * self.value_stride + j]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};

    /// Shapes of several lags, one lag (dense), and sizes that do not fill SIMD vectors.
    const SHAPES: [(usize, usize, usize); 5] = [(27, 9, 3), (18, 9, 4), (36, 9, 1), (12, 12, 3), (5, 2, 2)];

    #[test]
    fn structured_sweep_equals_dense_sweep() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for (n, fresh, m) in SHAPES {
            let stride = kernel::padded(n + m);
            let shape = Shape {
                knots: 2,
                state: n,
                command: m,
                fresh,
                stride,
            };
            let mut riccati = Riccati::new(shape);
            let diagonal: Vec<f64> = (0..n + m).map(|_| random.random_range(0.5..2.0)).collect();
            riccati.start(&diagonal);
            let mut dense = DMatrix::from_fn(n, n, |i, j| if i == j { diagonal[i] } else { 0.0 });
            for _ in 0..20 {
                let mut jacobian = vec![0.0; fresh * stride];
                let mut transition = DMatrix::zeros(n, n + m);
                for i in 0..n {
                    for j in 0..n + m {
                        if i < fresh {
                            transition[(i, j)] = random.random_range(-0.3..0.3);
                            jacobian[i * stride + j] = transition[(i, j)];
                        } else if j + fresh == i {
                            transition[(i, j)] = 1.0;
                        }
                    }
                }
                structured_step(&mut riccati, &diagonal, &jacobian);
                dense = dense_step(&dense, &diagonal, &transition, m);
                for i in 0..n {
                    for j in i..n {
                        let (found, expected) = (riccati.value(i, j), dense[(i, j)]);
                        let error = (found - expected).abs();
                        assert!(
                            error <= 1e-11 * dense.amax(),
                            "{n}/{fresh}/{m}: P[{i}][{j}] off by {error}"
                        );
                    }
                }
            }
        }
    }

    fn structured_step(riccati: &mut Riccati, diagonal: &[f64], jacobian: &[f64]) {
        let Shape {
            state: n,
            command: m,
            stride,
            ..
        } = riccati.shape;
        let (mut command_hessian, mut cross) = (vec![0.0; m * m], vec![0.0; m * stride]);
        riccati.begin();
        riccati.command_blocks(jacobian, diagonal, &mut command_hessian, &mut cross);
        let command_hessian = DMatrix::from_row_slice(m, m, &command_hessian);
        let right = DMatrix::from_fn(m, n, |j, i| -cross[j * stride + i]);
        let solved = command_hessian.cholesky().expect("convex").solve(&right);
        let mut gains = vec![0.0; m * stride];
        for j in 0..m {
            for i in 0..n {
                gains[j * stride + i] = solved[(j, i)];
            }
        }
        riccati.finish(jacobian, diagonal, &gains, &cross);
    }

    fn dense_step(
        value: &DMatrix<f64>,
        diagonal: &[f64],
        transition: &DMatrix<f64>,
        m: usize,
    ) -> DMatrix<f64> {
        let n = value.nrows();
        let mut quadratic = transition.transpose() * value * transition;
        for (i, entry) in diagonal.iter().enumerate() {
            quadratic[(i, i)] += entry;
        }
        let command_hessian = quadratic.view((n, n), (m, m)).into_owned();
        let cross = quadratic.view((n, 0), (m, n)).into_owned();
        let solved = command_hessian.cholesky().expect("convex").solve(&cross);
        let value = quadratic.view((0, 0), (n, n)) - cross.transpose() * solved;
        0.5 * (&value + value.transpose())
    }
}
