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

/// A matrix, row-major.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// Its entries; the last row may be cut short.
    pub entries: &'a [f64],
    /// From one row to the next, whole vectors of the widest instruction set where the matrix is not a left factor.
    pub stride: usize,
}

/// Which entries of a result are wanted; others, if computed, are meaningless.
#[derive(Debug, Clone, Copy)]
pub enum Wanted {
    /// All.
    All,
    /// `i ≤ j < columns`, where columns from there to the next whole vector stay or become zero.
    Upper {
        /// Number of columns.
        columns: usize,
    },
}

/// `out += Cᵀ v`, with C of `v.len()` rows of `out.len()` entries.
pub fn add_transpose_vector(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    let stride = out.len();
    let (left, right) = (
        Rows {
            entries: vector,
            stride: 1,
        },
        Rows {
            entries: matrix,
            stride,
        },
    );
    Arch::new().dispatch(SumOfProducts {
        accumulate: true,
        addends: &[],
        factors: &[(left, right)],
        wanted: Wanted::All,
        stride,
        out,
    });
}

/// `out[i][j] = Σ_addends addend[i][j] + Σ_factors Σ_r left[r][i] right[r][j]` for all rows i of `out`, which are
/// `stride` long. The sum over r ends with the shorter factor.
pub fn sum_products(
    addends: &[Rows<'_>],
    factors: &[(Rows<'_>, Rows<'_>)],
    wanted: Wanted,
    stride: usize,
    out: &mut [f64],
) {
    Arch::new().dispatch(SumOfProducts {
        accumulate: false,
        addends,
        factors,
        wanted,
        stride,
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

struct SumOfProducts<'a> {
    /// Whether to begin with what is in `out`, rather than with zero.
    accumulate: bool,
    addends: &'a [Rows<'a>],
    factors: &'a [(Rows<'a>, Rows<'a>)],
    wanted: Wanted,
    stride: usize,
    out: &'a mut [f64],
}

impl WithSimd for SumOfProducts<'_> {
    type Output = ();

    /// Tiles of up to 4 rows × 3 vectors of `out` (1 × 8) stay in registers over the whole sum.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let rows = self.out.len() / self.stride;
        let columns = match self.wanted {
            Wanted::All => self.stride,
            Wanted::Upper { columns } => columns,
        };
        let mut tiles = Tiles {
            simd,
            accumulate: self.accumulate,
            addends: self.addends,
            factors: self.factors,
            row_vectors: self.stride / S::F64_LANES,
            columns: columns.div_ceil(S::F64_LANES),
            rest: columns % S::F64_LANES,
            out: S::as_mut_simd_f64s(self.out).0,
        };
        let mut row = 0;
        while row < rows {
            let column = match self.wanted {
                Wanted::All => 0,
                Wanted::Upper { .. } => row / S::F64_LANES,
            };
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
    accumulate: bool,
    addends: &'a [Rows<'a>],
    factors: &'a [(Rows<'a>, Rows<'a>)],
    /// Vectors in a row of `out`.
    row_vectors: usize,
    /// Vectors of a row that are wanted.
    columns: usize,
    /// Entries of the last of them that are wanted; 0 for all.
    rest: usize,
    out: &'a mut [S::f64s],
}

impl<S: Simd> Tiles<'_, S> {
    /// Rows `row..row + ROWS`, from the given vector of columns to the last wanted one. No tile is one vector wide
    /// unless it must: four sums are too few to keep the multipliers busy.
    #[inline(always)]
    fn row_block<const ROWS: usize>(&mut self, row: usize, mut column: usize) {
        while self.columns - column >= 5 || self.columns - column == 3 {
            self.tile::<ROWS, 3>(row, column);
            column += 3;
        }
        while self.columns - column >= 2 {
            self.tile::<ROWS, 2>(row, column);
            column += 2;
        }
        if self.columns > column {
            self.tile::<ROWS, 1>(row, column);
        }
    }

    /// A single row: wider tiles, for the same reason.
    #[inline(always)]
    fn single_row(&mut self, row: usize, mut column: usize) {
        while self.columns - column >= 12 {
            self.tile::<1, 12>(row, column);
            column += 12;
        }
        if self.columns - column >= 8 {
            self.tile::<1, 8>(row, column);
            column += 8;
        }
        if self.columns - column >= 4 {
            self.tile::<1, 4>(row, column);
            column += 4;
        }
        if self.columns - column >= 2 {
            self.tile::<1, 2>(row, column);
            column += 2;
        }
        if self.columns > column {
            self.tile::<1, 1>(row, column);
        }
    }

    #[inline(always)]
    fn tile<const ROWS: usize, const VECTORS: usize>(&mut self, row: usize, column: usize) {
        let Self {
            simd, row_vectors, ..
        } = *self;
        let mut sums = [[simd.splat_f64s(0.0); VECTORS]; ROWS];
        if self.accumulate {
            for (i, sums) in sums.iter_mut().enumerate() {
                sums.copy_from_slice(&self.out[(row + i) * row_vectors + column..][..VECTORS]);
            }
        }
        for addend in self.addends {
            let (addend, stride) = (S::as_simd_f64s(addend.entries).0, addend.stride / S::F64_LANES);
            for (i, sums) in sums.iter_mut().enumerate() {
                let addend = &addend[(row + i) * stride + column..][..VECTORS];
                for (sum, &addend) in sums.iter_mut().zip(addend) {
                    *sum = simd.add_f64s(*sum, addend);
                }
            }
        }
        for (left, right) in self.factors {
            let (right, right_stride) = (S::as_simd_f64s(right.entries).0, right.stride / S::F64_LANES);
            // Row by row until either factor ends; `chunks` would divide to count them.
            let (mut i, mut j) = (row, column);
            while let (Some(left_row), Some(right_row)) =
                (left.entries.get(i..i + ROWS), right.get(j..j + VECTORS))
            {
                for (sums, &scale) in sums.iter_mut().zip(left_row) {
                    let scale = simd.splat_f64s(scale);
                    for (sum, &right) in sums.iter_mut().zip(right_row) {
                        *sum = simd.mul_add_f64s(scale, right, *sum);
                    }
                }
                i += left.stride;
                j += right_stride;
            }
        }
        if self.rest != 0 && column + VECTORS == self.columns {
            let wanted = simd.mask_between_m64s(0, self.rest as u64).mask();
            for sums in &mut sums {
                sums[VECTORS - 1] = simd.select_f64s(wanted, sums[VECTORS - 1], simd.splat_f64s(0.0));
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            self.out[(row + i) * row_vectors + column..][..VECTORS].copy_from_slice(sums);
        }
    }
}
