//! One knot of the Riccati recursion, exploiting the companion form.
//!
//! With `δz⁺ = (C δw, S δw)`, `C = [A B]`, and the value Hessian P split after `fresh` entries into P₁₁, P₁₂, P₂₂,
//!
//! ```text
//! W = P₁₁ C + P₁₂ S
//! [Q_uz Q_uu] = Bᵀ W + [L_uz L_uu],   K = −Q_uu⁻¹ Q_uz
//! P ← L_zz + Sᵀ P₂₂ S + Wᵀ A + Aᵀ (P₁₂ S) + Kᵀ Q_uz
//! ```
//!
//! S only selects, so products with it are copies, and the last `fresh` columns of `P₁₂ S` are zero: for three lags of
//! nine entries and three commands this costs 19 kflop instead of the 110 of dense matrices. Only upper triangles are
//! computed and read, so P is symmetric by construction; an antisymmetric part would grow from knot to knot.

use super::Shape;
use crate::kernel::{self, Entries, Rows, SumOfProducts, Wanted};
use pulp::{Arch, Simd, WithSimd};

/// Lengths of the recursion's matrices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sizes {
    state: usize,
    command: usize,
    fresh: usize,
    /// Length of a row over `w = (z, u)`.
    stride: usize,
    /// Length of a row of P.
    value_stride: usize,
}

impl Sizes {
    fn new(state: usize, command: usize, fresh: usize) -> Self {
        Self {
            state,
            command,
            fresh,
            stride: kernel::padded(state + command),
            value_stride: kernel::padded(fresh + kernel::padded(state + command)),
        }
    }
}

/// Value Hessian and scratch of the recursion.
#[derive(Debug, Clone)]
pub struct Riccati {
    sizes: Sizes,
    /// P of the later knot, upper triangle, P₁₁ in full, with zeros to the right and below: so `P₁₂ S` and `Sᵀ P₂₂ S` are
    /// P itself, read from column `fresh` on, or from row and column `fresh` on.
    value: Entries,
    /// Room for P of this knot.
    next_value: Entries,
    /// Second derivatives of the Lagrangian at this knot beside its diagonal, n + m rows of `stride`.
    curvature: Entries,
    /// Whether there are any.
    curved: bool,
    /// W, fresh rows of `stride`.
    product: Entries,
}

impl Riccati {
    pub fn new(shape: Shape) -> Self {
        let sizes = Sizes::new(shape.state, shape.command, shape.fresh);
        let Sizes {
            state,
            fresh,
            stride,
            value_stride,
            ..
        } = sizes;
        let value = kernel::zeros((fresh + state + 1) * value_stride);
        Self {
            sizes,
            value: value.clone(),
            next_value: value,
            curvature: kernel::zeros(shape.width() * stride),
            curved: false,
            product: kernel::zeros(fresh * stride),
        }
    }

    /// `P_N = diag(l_zz)`.
    pub fn start(&mut self, diagonal: &[f64]) {
        self.value.fill(0.0);
        for i in 0..self.sizes.state {
            self.value[i * self.sizes.value_stride + i] = diagonal[i];
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
        Arch::new().dispatch(CommandBlocks {
            riccati: self,
            jacobian,
            diagonal,
            command_hessian,
            cross,
        });
    }

    /// P of this knot, with `gains = −Q_uu⁻¹ Q_uz` on the free commands and 0 on the held ones, m × stride as `cross`.
    pub fn finish(&mut self, jacobian: &[f64], diagonal: &[f64], gains: &[f64], cross: &[f64]) {
        Arch::new().dispatch(Finish {
            riccati: self,
            jacobian,
            diagonal,
            gains,
            cross,
        });
        std::mem::swap(&mut self.value, &mut self.next_value);
    }

    /// P's entry, `i ≤ j`.
    #[cfg(test)]
    pub fn value(&self, i: usize, j: usize) -> f64 {
        self.value[i * self.sizes.value_stride + j]
    }
}

/// [`Riccati::command_blocks`].
struct CommandBlocks<'a> {
    riccati: &'a mut Riccati,
    jacobian: &'a [f64],
    diagonal: &'a [f64],
    command_hessian: &'a mut [f64],
    cross: &'a mut [f64],
}

impl WithSimd for CommandBlocks<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Sizes {
            state: n,
            command: m,
            fresh,
            stride,
            value_stride,
        } = self.riccati.sizes;
        let Riccati {
            value,
            curvature,
            curved,
            product,
            ..
        } = self.riccati;
        for i in 1..fresh {
            for j in 0..i {
                value[i * value_stride + j] = value[j * value_stride + i];
            }
        }
        let value = Rows::new(value, fresh, value_stride);
        let jacobian = Rows::new(self.jacobian, fresh, stride);
        SumOfProducts {
            addends: [Some(value.skip_columns(fresh)), None],
            factors: [(value, jacobian)],
            wanted: Wanted::All,
            stride,
            out: product,
        }
        .with_simd(simd);
        SumOfProducts {
            addends: [
                curved.then(|| Rows::new(&curvature[n * stride..], m, stride)),
                None,
            ],
            factors: [(jacobian.skip_columns(n), Rows::new(product, fresh, stride))],
            wanted: Wanted::All,
            stride,
            out: self.cross,
        }
        .with_simd(simd);
        let hessian_rows = self.command_hessian.chunks_exact_mut(m);
        for (j, (row, hessian)) in self.cross.chunks_exact_mut(stride).zip(hessian_rows).enumerate() {
            hessian.copy_from_slice(&row[n..n + m]);
            hessian[j] += self.diagonal[n + j];
            row[n..].fill(0.0);
        }
    }
}

/// [`Riccati::finish`].
struct Finish<'a> {
    riccati: &'a mut Riccati,
    jacobian: &'a [f64],
    diagonal: &'a [f64],
    gains: &'a [f64],
    cross: &'a [f64],
}

impl WithSimd for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Sizes {
            state,
            command,
            fresh,
            stride,
            value_stride,
        } = self.riccati.sizes;
        let Riccati {
            value,
            next_value,
            curvature,
            curved,
            product,
            ..
        } = self.riccati;
        let shifted = |row: usize, rows: usize| {
            Rows::new(&value[row * value_stride..], rows, value_stride).skip_columns(fresh)
        };
        let addends = [
            Some(shifted(fresh, state)),
            curved.then(|| Rows::new(curvature, state, stride)),
        ];
        let jacobian = Rows::new(self.jacobian, fresh, stride);
        let factors = [
            (jacobian, shifted(0, fresh).zero_from(state)),
            (Rows::new(product, fresh, stride), jacobian),
            (
                Rows::new(self.gains, command, stride),
                Rows::new(self.cross, command, stride),
            ),
        ];
        let out = &mut next_value[..state * value_stride];
        SumOfProducts {
            addends,
            factors,
            wanted: Wanted::Upper { columns: state },
            stride: value_stride,
            out,
        }
        .with_simd(simd);
        for (entry, diagonal) in out.iter_mut().step_by(value_stride + 1).zip(self.diagonal) {
            *entry += diagonal;
        }
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
        let Sizes {
            state: n,
            command: m,
            stride,
            ..
        } = riccati.sizes;
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
