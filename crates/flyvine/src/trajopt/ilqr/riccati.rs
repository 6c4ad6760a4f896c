//! One knot of the Riccati recursion, exploiting the companion form.
//!
//! With `δz⁺ = (C δw, S δw)` and the value Hessian P split after `fresh` entries into P₁₁, P₁₂, P₂₂,
//!
//! ```text
//! Q = Cᵀ (P₁₁ C + P₁₂ S) + (P₁₂ S)ᵀ C + Sᵀ P₂₂ S + L_ww
//! P ← Q_zz − Q_zu Q_uu⁻¹ Q_uz
//! ```
//!
//! S only selects, so products with it are copies: for three lags of nine entries and three commands this costs
//! 22 kflop instead of the 110 of dense matrices. Only upper triangles are computed and read, so P is symmetric by
//! construction; an antisymmetric part would grow from knot to knot.

use super::Shape;
use crate::kernel;

/// Value Hessian and scratch of the recursion.
#[derive(Debug, Clone)]
pub struct Riccati {
    shape: Shape,
    /// P, upper triangle, (n + m) × stride; rows and columns of the command are meaningless.
    value: Vec<f64>,
    /// Q, upper triangle, (n + m) × stride.
    quadratic: Vec<f64>,
    /// P₁₁ in full, fresh × stride.
    fresh_block: Vec<f64>,
    /// P₁₂ S, fresh × stride.
    shifted_block: Vec<f64>,
    /// P₁₁ C + P₁₂ S, fresh × stride.
    product: Vec<f64>,
}

impl Riccati {
    pub fn new(shape: Shape) -> Self {
        let square = vec![0.0; shape.width() * shape.stride];
        let rows = vec![0.0; shape.fresh * shape.stride];
        Self {
            shape,
            value: square.clone(),
            quadratic: square,
            fresh_block: rows.clone(),
            shifted_block: rows.clone(),
            product: rows,
        }
    }

    /// `P_N = diag(l_zz)`.
    pub fn start(&mut self, diagonal: &[f64]) {
        self.value.fill(0.0);
        for i in 0..self.shape.state {
            self.value[i * self.shape.stride + i] = diagonal[i];
        }
    }

    /// `Q = Sᵀ P₂₂ S + diag(l_ww)`, the part of Q that is copied.
    pub fn copy_shifted(&mut self, diagonal: &[f64]) {
        let Shape {
            state: n,
            fresh,
            stride,
            ..
        } = self.shape;
        let shifted = self.shape.shifted();
        for (i, row) in self.quadratic.chunks_exact_mut(stride).enumerate() {
            row[i..].fill(0.0);
            if i < shifted {
                row[i..shifted].copy_from_slice(&self.value[(fresh + i) * stride..][fresh + i..n]);
            }
            row[i] += diagonal[i];
        }
    }

    /// Adds the upper triangle of a symmetric (n + m) × (n + m) matrix to Q.
    pub fn add_to_quadratic(&mut self, symmetric: &[f64]) {
        let width = self.shape.width();
        for (i, row) in self.quadratic.chunks_exact_mut(self.shape.stride).enumerate() {
            for (entry, &extra) in row[i..width].iter_mut().zip(&symmetric[i * width..][i..width]) {
                *entry += extra;
            }
        }
    }

    /// Adds the products with the Jacobian C to Q.
    pub fn add_products(&mut self, jacobian: &[f64]) {
        let Shape {
            state: n,
            fresh,
            stride,
            ..
        } = self.shape;
        let shifted = self.shape.shifted();
        for (i, row) in self.shifted_block.chunks_exact_mut(stride).enumerate() {
            row[..shifted].copy_from_slice(&self.value[i * stride..][fresh..n]);
            for j in i..fresh {
                let entry = self.value[i * stride + j];
                self.fresh_block[i * stride + j] = entry;
                self.fresh_block[j * stride + i] = entry;
            }
        }
        self.product.copy_from_slice(&self.shifted_block);
        kernel::add_transpose_product(&self.fresh_block, jacobian, stride, false, &mut self.product);
        kernel::add_transpose_product(jacobian, &self.product, stride, true, &mut self.quadratic);
        let shifted_rows = &mut self.quadratic[..shifted * stride];
        kernel::add_transpose_product(&self.shifted_block, jacobian, stride, true, shifted_rows);
    }

    /// Copies `Q_uu` (m × m, symmetric) and `Q_uz` (m × stride, zero beyond n) out.
    pub fn extract_command_blocks(&self, command_hessian: &mut [f64], cross: &mut [f64]) {
        let Shape {
            state: n,
            command: m,
            stride,
            ..
        } = self.shape;
        for (i, row) in self.quadratic.chunks_exact(stride).take(n).enumerate() {
            for j in 0..m {
                cross[j * stride + i] = row[n + j];
            }
        }
        for i in 0..m {
            for j in i..m {
                let entry = self.quadratic[(n + i) * stride + n + j];
                command_hessian[i * m + j] = entry;
                command_hessian[j * m + i] = entry;
            }
        }
    }

    /// `P ← Q_zz + gainsᵀ cross`: with `gains = −Q_uu⁻¹ Q_uz` on the free commands and 0 on the held ones.
    pub fn finish(&mut self, gains: &[f64], cross: &[f64]) {
        let Shape { state, stride, .. } = self.shape;
        kernel::add_transpose_product(gains, cross, stride, true, &mut self.quadratic[..state * stride]);
        std::mem::swap(&mut self.value, &mut self.quadratic);
    }

    /// P, upper triangle, rows of `stride`.
    #[cfg(test)]
    pub fn value(&self) -> &[f64] {
        &self.value
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
                        let (found, expected) = (riccati.value()[i * stride + j], dense[(i, j)]);
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
        riccati.copy_shifted(diagonal);
        riccati.add_products(jacobian);
        riccati.extract_command_blocks(&mut command_hessian, &mut cross);
        let command_hessian = DMatrix::from_row_slice(m, m, &command_hessian);
        let right = DMatrix::from_fn(m, n, |j, i| -cross[j * stride + i]);
        let solved = command_hessian.cholesky().expect("convex").solve(&right);
        let mut gains = vec![0.0; m * stride];
        for j in 0..m {
            for i in 0..n {
                gains[j * stride + i] = solved[(j, i)];
            }
        }
        riccati.finish(&gains, &cross);
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
