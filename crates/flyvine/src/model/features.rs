//! Regressors of the height row: offset, linear terms, squares and products of `w = (z, u)`.

/// Number of terms of a full quadratic in p variables: 1 + p + p (p + 1) / 2.
pub(crate) fn quadratic_len(p: usize) -> usize {
    1 + p + p * (p + 1) / 2
}

/// Writes `1, w_0, …, w_{p−1}, w_0², w_0 w_1, …, w_{p−1}²` into `terms`.
pub(crate) fn quadratic_terms(w: &[f64], terms: &mut [f64]) {
    let p = w.len();
    terms[0] = 1.0;
    terms[1..=p].copy_from_slice(w);
    let mut next = terms[1 + p..].iter_mut();
    for i in 0..p {
        for (&factor, term) in w[i..].iter().zip(&mut next) {
            *term = w[i] * factor;
        }
    }
}
