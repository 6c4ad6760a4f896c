//! Small dense products over padded rows: where the solver and the models spend their time.
//!
//! Every row is padded to whole vectors of the widest instruction set ([`padded`]), so there are no remainders;
//! which instruction set is used is decided at run time.

use pulp::{Arch, Simd, WithSimd};

/// Doubles in the widest SIMD vector.
const MAX_LANES: usize = 8;

/// Length of a row with room for `len` entries.
pub fn padded(len: usize) -> usize {
    len.next_multiple_of(MAX_LANES)
}

/// `out += Cᵀ v`, with C of `v.len()` rows of `out.len()` entries.
pub fn add_transpose_vector(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    let stride = out.len();
    add_product(vector, 1, matrix, stride, out);
}

/// `out[i][j] += Σ_r left[r][i] right[r][j]` with rows of `left` `left_stride` long, those of `right` and `out`
/// `stride`.
pub fn add_product(left: &[f64], left_stride: usize, right: &[f64], stride: usize, out: &mut [f64]) {
    Arch::new().dispatch(TransposeProduct {
        left,
        left_stride,
        right,
        stride,
        upper: false,
        out,
    });
}

/// `out[i][j] += Σ_r left[r][i] right[r][j]` for all rows i of `out`, rows being `stride` long. If `upper`, entries
/// with `j < i` are not needed and may be wrong.
pub fn add_transpose_product(left: &[f64], right: &[f64], stride: usize, upper: bool, out: &mut [f64]) {
    Arch::new().dispatch(TransposeProduct {
        left,
        left_stride: stride,
        right,
        stride,
        upper,
        out,
    });
}

/// `out[i] = matrix[i] · vector`, rows being as long as the vector.
pub fn multiply(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    Arch::new().dispatch(RowProducts { matrix, vector, out });
}

struct RowProducts<'a> {
    matrix: &'a [f64],
    vector: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for RowProducts<'_> {
    type Output = ();

    /// Three rows at a time, for enough independent sums.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        const ROWS: usize = 3;
        let vector = S::as_simd_f64s(self.vector).0;
        let matrix = S::as_simd_f64s(self.matrix).0;
        let mut rows = matrix.chunks_exact(vector.len());
        for out in self.out.chunks_mut(ROWS) {
            let mut sums = [simd.splat_f64s(0.0); ROWS];
            if out.len() == ROWS
                && let (Some(first), Some(second), Some(third)) = (rows.next(), rows.next(), rows.next())
            {
                for (((&v, &a), &b), &c) in vector.iter().zip(first).zip(second).zip(third) {
                    sums[0] = simd.mul_add_f64s(a, v, sums[0]);
                    sums[1] = simd.mul_add_f64s(b, v, sums[1]);
                    sums[2] = simd.mul_add_f64s(c, v, sums[2]);
                }
            } else {
                for (sum, row) in sums.iter_mut().zip(rows.by_ref()) {
                    for (&v, &a) in vector.iter().zip(row) {
                        *sum = simd.mul_add_f64s(a, v, *sum);
                    }
                }
            }
            for (entry, sum) in out.iter_mut().zip(sums) {
                *entry = simd.reduce_sum_f64s(sum);
            }
        }
    }
}

struct TransposeProduct<'a> {
    left: &'a [f64],
    left_stride: usize,
    right: &'a [f64],
    stride: usize,
    upper: bool,
    out: &'a mut [f64],
}

impl WithSimd for TransposeProduct<'_> {
    type Output = ();

    /// Tiles of up to 4 rows × 3 vectors of `out` (1 × 8) stay in registers over the whole sum.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let rows = self.out.len() / self.stride;
        let mut tiles = Tiles {
            simd,
            left: self.left,
            left_stride: self.left_stride,
            right: S::as_simd_f64s(self.right).0,
            out: S::as_mut_simd_f64s(self.out).0,
            row_vectors: self.stride / S::F64_LANES,
        };
        let mut row = 0;
        while row < rows {
            let column = if self.upper { row / S::F64_LANES } else { 0 };
            match rows - row {
                1 => tiles.single_row(row, column),
                2 => tiles.row_block::<2>(row, column),
                3 => tiles.row_block::<3>(row, column),
                _ => tiles.row_block::<4>(row, column),
            }
            row += 4;
        }
    }
}

struct Tiles<'a, S: Simd> {
    simd: S,
    left: &'a [f64],
    left_stride: usize,
    right: &'a [S::f64s],
    out: &'a mut [S::f64s],
    /// Vectors in a row of `right` and `out`.
    row_vectors: usize,
}

impl<S: Simd> Tiles<'_, S> {
    /// Rows `row..row + ROWS`, from the given vector of columns to the end.
    #[inline(always)]
    fn row_block<const ROWS: usize>(&mut self, row: usize, mut column: usize) {
        while self.row_vectors - column >= 3 {
            self.tile::<ROWS, 3>(row, column);
            column += 3;
        }
        match self.row_vectors - column {
            2 => self.tile::<ROWS, 2>(row, column),
            1 => self.tile::<ROWS, 1>(row, column),
            _ => {}
        }
    }

    /// A single row: wider tiles, for enough independent sums to keep the multipliers busy.
    #[inline(always)]
    fn single_row(&mut self, row: usize, mut column: usize) {
        while self.row_vectors - column >= 12 {
            self.tile::<1, 12>(row, column);
            column += 12;
        }
        if self.row_vectors - column >= 8 {
            self.tile::<1, 8>(row, column);
            column += 8;
        }
        if self.row_vectors - column >= 4 {
            self.tile::<1, 4>(row, column);
            column += 4;
        }
        if self.row_vectors - column >= 2 {
            self.tile::<1, 2>(row, column);
            column += 2;
        }
        if self.row_vectors > column {
            self.tile::<1, 1>(row, column);
        }
    }

    #[inline(always)]
    fn tile<const ROWS: usize, const VECTORS: usize>(&mut self, row: usize, column: usize) {
        let Self {
            simd, row_vectors, ..
        } = *self;
        let mut sums = [[simd.splat_f64s(0.0); VECTORS]; ROWS];
        for (i, sum) in sums.iter_mut().enumerate() {
            sum.copy_from_slice(&self.out[(row + i) * row_vectors + column..][..VECTORS]);
        }
        let left_rows = self.left.chunks_exact(self.left_stride);
        for (left, right) in left_rows.zip(self.right.chunks_exact(row_vectors)) {
            let left = &left[row..row + ROWS];
            let right = &right[column..column + VECTORS];
            for i in 0..ROWS {
                let scale = simd.splat_f64s(left[i]);
                for j in 0..VECTORS {
                    sums[i][j] = simd.mul_add_f64s(scale, right[j], sums[i][j]);
                }
            }
        }
        for (i, sum) in sums.iter().enumerate() {
            self.out[(row + i) * row_vectors + column..][..VECTORS].copy_from_slice(sum);
        }
    }
}
