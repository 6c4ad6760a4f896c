//! Small dense products over padded rows: where the solver spends its time.

/// `out += Cᵀ v`, with C of `v.len()` rows of `out.len()` entries.
pub fn add_transpose_vector(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    for (row, &scale) in matrix.chunks_exact(out.len()).zip(vector) {
        for (entry, &value) in out.iter_mut().zip(row) {
            *entry += scale * value;
        }
    }
}

/// `out[i][j] += Σ_r left[r][first + i] right[r][j]` for all rows i of `out`; only `j ≥ first + i` need be right if
/// `upper`. All rows have `stride` entries.
pub fn add_transpose_product(left: &[f64], right: &[f64], stride: usize, upper: bool, out: &mut [f64]) {
    for (i, out_row) in out.chunks_exact_mut(stride).enumerate() {
        let from = if upper { i } else { 0 };
        for (left_row, right_row) in left.chunks_exact(stride).zip(right.chunks_exact(stride)) {
            let scale = left_row[i];
            for (entry, &value) in out_row[from..].iter_mut().zip(&right_row[from..]) {
                *entry += scale * value;
            }
        }
    }
}
