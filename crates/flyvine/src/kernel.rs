//! Small dense products over padded rows: where the solver and the models spend their time.
//!
//! Every row is padded to whole vectors of the widest instruction set ([`padded`]), so there are no remainders;
//! which instruction set is used is decided at run time.

use aligned_vec::{AVec, ConstAlign};
use pulp::{Arch, Simd, WithSimd};

/// Doubles in the widest SIMD vector.
const MAX_LANES: usize = 8;

/// Length of a row with room for `len` entries.
pub const fn padded(len: usize) -> usize {
    len.next_multiple_of(MAX_LANES)
}

/// Entries of a matrix on whole cache lines: a vector that lies across two of them costs twice.
pub type Entries = AVec<f64, ConstAlign<CACHE_LINE>>;

/// Bytes of a cache line, and of the widest SIMD vector.
const CACHE_LINE: usize = MAX_LANES * size_of::<f64>();

/// `len` zeros.
pub fn zeros(len: usize) -> Entries {
    entries(std::iter::repeat_n(0.0, len))
}

/// A copy of these values.
pub fn entries(values: impl IntoIterator<Item = f64>) -> Entries {
    AVec::from_iter(CACHE_LINE, values)
}

/// A matrix: whole rows, row-major, of which columns from some first one on are meant.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    entries: &'a [f64],
    stride: usize,
    first: usize,
    /// Columns from here on are known to be zero.
    end: usize,
}

impl<'a> Rows<'a> {
    /// The first `rows` of `stride` entries: whole vectors of the widest instruction set where the matrix is not a left
    /// factor.
    #[inline(always)]
    pub fn new(entries: &'a [f64], rows: usize, stride: usize) -> Self {
        Self {
            entries: &entries[..rows * stride],
            stride,
            first: 0,
            end: stride,
        }
    }

    /// The same rows without the columns before `first`.
    #[inline(always)]
    pub fn skip_columns(self, first: usize) -> Self {
        Self { first, ..self }
    }

    /// The same matrix, of which the entries' columns from `end` on are known to be zero: as a right factor it is not
    /// multiplied there.
    #[inline(always)]
    pub fn zero_from(self, end: usize) -> Self {
        Self { end, ..self }
    }
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
    Arch::new().dispatch(TransposeVector { matrix, vector, out });
}

struct TransposeVector<'a> {
    matrix: &'a [f64],
    vector: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for TransposeVector<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let vectors = self.out.len() / S::F64_LANES;
        let mut first = 0;
        while first < vectors {
            first += match vectors - first {
                1 => self.columns::<S, 1>(simd, first),
                2 => self.columns::<S, 2>(simd, first),
                3 => self.columns::<S, 3>(simd, first),
                _ => self.columns::<S, 4>(simd, first),
            };
        }
    }
}

impl TransposeVector<'_> {
    /// `VECTORS` vectors of the result, from the `first` on. Rows with even and with odd numbers have sums of their own:
    /// so few sums would wait for each other.
    #[inline(always)]
    fn columns<S: Simd, const VECTORS: usize>(&mut self, simd: S, first: usize) -> usize {
        let stride = self.out.len();
        let columns = first * S::F64_LANES..(first + VECTORS) * S::F64_LANES;
        let add = |sums: &mut [S::f64s; VECTORS], row: &[f64], scale: f64| {
            let scale = simd.splat_f64s(scale);
            for (sum, &entry) in sums.iter_mut().zip(S::as_simd_f64s(&row[columns.clone()]).0) {
                *sum = simd.mul_add_f64s(scale, entry, *sum);
            }
        };
        let mut even = [simd.splat_f64s(0.0); VECTORS];
        let mut odd = even;
        let rows = self.matrix.chunks_exact(2 * stride);
        let scales = self.vector.chunks_exact(2);
        if let [scale] = scales.remainder() {
            add(&mut even, &rows.remainder()[..stride], *scale);
        }
        for (pair, scales) in rows.zip(scales) {
            add(&mut even, &pair[..stride], scales[0]);
            add(&mut odd, &pair[stride..], scales[1]);
        }
        let out = S::as_mut_simd_f64s(&mut self.out[columns.clone()]).0;
        for ((entry, even), odd) in out.iter_mut().zip(even).zip(odd) {
            *entry = simd.add_f64s(*entry, simd.add_f64s(even, odd));
        }
        VECTORS
    }
}

/// `out[i][j] = Σ_factors Σ_r left[r][i] right[r][j]` for all rows i of `out`, which are `stride` long. The sum over r
/// ends with the shorter factor.
pub fn sum_products<const F: usize>(
    factors: [(Rows<'_>, Rows<'_>); F],
    wanted: Wanted,
    stride: usize,
    out: &mut [f64],
) {
    Arch::new().dispatch(SumOfProducts {
        addends: [None; 2],
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

/// A sum of F products for [`Arch::dispatch`], or for a caller who is inside of one already.
pub struct SumOfProducts<'a, const F: usize> {
    /// Matrices to add.
    pub addends: [Option<Rows<'a>>; 2],
    /// Left and right factors.
    pub factors: [(Rows<'a>, Rows<'a>); F],
    /// Which entries to compute.
    pub wanted: Wanted,
    /// Length of a row of `out`.
    pub stride: usize,
    /// The result.
    pub out: &'a mut [f64],
}

/// Rows of the largest tile.
const MAX_ROWS: usize = 4;

impl<const F: usize> WithSimd for SumOfProducts<'_, F> {
    type Output = ();

    /// Tiles of up to 4 rows × 2 vectors or 3 × 3 of `out` (1 × 8; 4 × 4 of the widest vectors) stay in registers over
    /// the whole sum.
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let (columns, upper) = match self.wanted {
            Wanted::All => (self.stride, false),
            Wanted::Upper { columns } => (columns, true),
        };
        let out_rows = self.out.len() / self.stride;
        let rows = if upper { out_rows.min(columns) } else { out_rows };
        let mut row = 0;
        while row < rows {
            let column = if upper { row } else { 0 } / S::F64_LANES * S::F64_LANES;
            // Groups of nearly equal size: 9 rows are 3 + 3 + 3, not 4 + 4 + 1.
            let group = (rows - row).div_ceil((rows - row).div_ceil(MAX_ROWS));
            match group {
                1 => self.row_block::<S, 1>(simd, row, column, columns),
                2 => self.row_block::<S, 2>(simd, row, column, columns),
                3 => self.row_block::<S, 3>(simd, row, column, columns),
                _ => self.row_block::<S, MAX_ROWS>(simd, row, column, columns),
            }
            row += group;
        }
    }
}

impl<const F: usize> SumOfProducts<'_, F> {
    /// Rows `row..row + ROWS`, columns `column..columns`. No tile is one vector wide unless it must: four sums are too
    /// few to keep the multipliers busy. Nor are tiles of four rows three wide: with sixteen registers one of their
    /// twelve sums would live in memory.
    #[inline(always)]
    fn row_block<S: Simd, const ROWS: usize>(
        &mut self,
        simd: S,
        row: usize,
        mut column: usize,
        columns: usize,
    ) {
        while column < columns {
            let vectors = (columns - column).div_ceil(S::F64_LANES);
            // Instruction sets with the widest vectors have twice as many registers.
            let roomy = S::F64_LANES == MAX_LANES;
            column += S::F64_LANES
                * match vectors {
                    8.. if ROWS == 1 => self.tile::<S, ROWS, 8>(simd, row, column, columns),
                    4.. if ROWS == 1 || roomy => self.tile::<S, ROWS, 4>(simd, row, column, columns),
                    3 | 5.. if ROWS < MAX_ROWS || roomy => {
                        self.tile::<S, ROWS, 3>(simd, row, column, columns)
                    }
                    2.. => self.tile::<S, ROWS, 2>(simd, row, column, columns),
                    _ => self.tile::<S, ROWS, 1>(simd, row, column, columns),
                };
        }
    }

    /// One tile; gives its width in vectors. Entries from `columns` on are zero.
    #[inline(always)]
    fn tile<S: Simd, const ROWS: usize, const VECTORS: usize>(
        &mut self,
        simd: S,
        row: usize,
        column: usize,
        columns: usize,
    ) -> usize {
        let width = VECTORS * S::F64_LANES;
        let mut sums = [[simd.splat_f64s(0.0); VECTORS]; ROWS];
        let [first, second] = self.addends;
        if let Some(addend) = first {
            sums = add_rows(simd, addend, row, column, sums);
        }
        if let Some(addend) = second {
            sums = add_rows(simd, addend, row, column, sums);
        }
        for (left, right) in self.factors {
            // Tiles are narrow: at most one vector of them is spared.
            let narrower = width - S::F64_LANES;
            sums = if right.end > right.first + column + narrower {
                add_product(simd, left, right, row, column, width, sums)
            } else if right.end > right.first + column {
                add_product(simd, left, right, row, column, narrower, sums)
            } else {
                sums
            };
        }
        if column + width > columns {
            let wanted = simd.mask_between_m64s(0, (columns % S::F64_LANES) as u64).mask();
            for sums in &mut sums {
                sums[VECTORS - 1] = simd.select_f64s(wanted, sums[VECTORS - 1], simd.splat_f64s(0.0));
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            let out = &mut self.out[(row + i) * self.stride + column..][..width];
            S::as_mut_simd_f64s(out).0.copy_from_slice(sums);
        }
        VECTORS
    }
}

/// Adds `matrix[row..][column..]`.
#[inline(always)]
fn add_rows<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    matrix: Rows<'_>,
    row: usize,
    column: usize,
    mut sums: [[S::f64s; VECTORS]; ROWS],
) -> [[S::f64s; VECTORS]; ROWS] {
    for (i, sums) in sums.iter_mut().enumerate() {
        let entries = &matrix.entries[(row + i) * matrix.stride + matrix.first + column..];
        let entries = &entries[..VECTORS * S::F64_LANES];
        for (sum, &entry) in sums.iter_mut().zip(S::as_simd_f64s(entries).0) {
            *sum = simd.add_f64s(*sum, entry);
        }
    }
    sums
}

/// Adds `Σ_r left[r][row..] right[r][column..][..width]`, row by row until either factor ends.
///
/// That the tile fits into the rows is checked once, not at every r. (Nor should the compiler know the sizes: it would unroll
/// the sum, load what it can beforehand, and run out of registers.)
#[inline(always)]
fn add_product<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    left: Rows<'_>,
    right: Rows<'_>,
    row: usize,
    column: usize,
    width: usize,
    mut sums: [[S::f64s; VECTORS]; ROWS],
) -> [[S::f64s; VECTORS]; ROWS] {
    let (row, column) = (left.first + row, right.first + column);
    assert!(left.stride.saturating_sub(row) >= ROWS && right.stride.saturating_sub(column) >= width);
    let (mut left_rest, mut right_rest) = (left.entries, right.entries);
    while let (Some((left_row, left_later)), Some((right_row, right_later))) = (
        left_rest.split_at_checked(left.stride),
        right_rest.split_at_checked(right.stride),
    ) {
        let right_row = S::as_simd_f64s(&right_row[column..][..width]).0;
        for (sums, &scale) in sums.iter_mut().zip(&left_row[row..][..ROWS]) {
            let scale = simd.splat_f64s(scale);
            for (sum, &right) in sums.iter_mut().zip(right_row) {
                *sum = simd.mul_add_f64s(scale, right, *sum);
            }
        }
        (left_rest, right_rest) = (left_later, right_later);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposed_products_of_every_size_are_added() {
        for columns in [8, 16, 24, 32, 72] {
            for rows in 0..6 {
                let matrix: Vec<f64> = (0..rows * columns).map(|i| (i % 7) as f64 - 3.0).collect();
                let vector: Vec<f64> = (0..rows).map(|r| r as f64 + 0.5).collect();
                let mut out: Vec<f64> = (0..columns).map(|j| j as f64).collect();
                add_transpose_vector(&matrix, &vector, &mut out);
                for (j, &found) in out.iter().enumerate() {
                    let product: f64 = (0..rows).map(|r| matrix[r * columns + j] * vector[r]).sum();
                    assert_eq!(found, j as f64 + product, "{rows} rows, column {j} of {columns}");
                }
            }
        }
    }
}
