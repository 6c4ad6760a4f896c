//! Sums of products over rows of recordings, from which least squares is solved without the rows.
//!
//! The regressors of the quadratic height row, 1, d_i and d_i d_j, are the products e_i e_j of e = (1, d). The
//! entries of their Gram matrix are therefore sums of e_i e_j e_k e_l, and the same sum stands in several places: for
//! 30 variables there are 46 376 of them behind the 123 256 entries of a triangle. They are made as products of
//! matrices: pairs (i, j) by pairs (k, l) with k ≥ j, for a few j together, over a block of rows. More columns of
//! products than a block's are never in memory.

use super::super::lag::{HEIGHT_ROW, STATE_LEN};
use super::super::least_squares::Gram;
use super::pairwise::Merge;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Rows whose products are in memory together. Long enough that packing and storing do not show.
const BLOCK_ROWS: usize = 2048;
/// Pairs (i, j) that are multiplied together: more waste products with k < j, fewer waste the processor.
const GROUP_PAIRS: usize = 32;

/// Sums over rows of e = (1, d) and of the targets y, the nine signals' increments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Moments {
    /// Rows summed.
    pub rows: usize,
    /// Entries of e.
    variables: usize,
    /// Σ [e | y]ᵀ [e | y], column-major.
    second: Vec<f64>,
    /// Σ e_i e_j e_k e_l for i ≤ j ≤ k ≤ l, ordered by j, then i, then (k, l); empty if no row is quadratic.
    fourth: Vec<f64>,
    /// Σ e_i e_j y_height for i ≤ j; empty if no row is quadratic.
    height: Vec<f64>,
}

impl Moments {
    /// Sums the rows of `e` and `y` (rows × 9).
    pub fn of_rows(e: MatRef<'_, f64>, y: MatRef<'_, f64>, quadratic: bool) -> Self {
        let q = e.ncols();
        let width = q + STATE_LEN;
        let mut second = Mat::<f64>::zeros(width, width);
        let (targets, regressors) = (q..width, 0..q);
        for (rows, left) in [(regressors.clone(), e), (targets.clone(), y)] {
            for (columns, right) in [(regressors.clone(), e), (targets.clone(), y)] {
                let sum = second
                    .as_mut()
                    .submatrix_mut(rows.start, columns.start, rows.len(), columns.len());
                matmul(sum, Accum::Replace, left.transpose(), right, 1.0, Par::Seq);
            }
        }
        let (fourth, height) = if quadratic {
            sums_of_products(e, y)
        } else {
            Default::default()
        };
        Self {
            rows: e.nrows(),
            variables: q,
            second: (0..width).flat_map(|j| second.col_as_slice(j).to_vec()).collect(),
            fourth,
            height,
        }
    }

    /// Whether the sums are as many as `variables` and the structure want, and finite.
    pub fn fits(&self, variables: usize, quadratic: bool) -> bool {
        let width = variables + STATE_LEN;
        let (fourth, height) = if quadratic {
            (fourth_start(variables, variables), pairs(variables))
        } else {
            (0, 0)
        };
        let sums = [&self.second, &self.fourth, &self.height];
        self.variables == variables
            && sums.map(Vec::len) == [width * width, fourth, height]
            && sums.iter().all(|sums| sums.iter().all(|sum| sum.is_finite()))
    }

    /// Gram matrix of `[M e | y]`, all nine targets.
    pub fn linear_gram(&self, m: MatRef<'_, f64>) -> Gram {
        let (q, p, width) = (self.variables, m.nrows(), self.variables + STATE_LEN);
        let second = MatRef::from_column_major_slice(&self.second, width, width);
        let mut whole = Mat::<f64>::zeros(p + STATE_LEN, width);
        whole.submatrix_mut(0, 0, p, q).copy_from(m);
        whole
            .submatrix_mut(p, q, STATE_LEN, STATE_LEN)
            .copy_from(Mat::<f64>::identity(STATE_LEN, STATE_LEN));
        Gram::new(self.rows, p, &whole * second * whole.transpose())
    }

    /// Gram matrix of `[e_i e_j | y_height]`, i ≤ j; `None` if no row is quadratic.
    pub fn height_gram(&self) -> Option<Gram> {
        if self.fourth.is_empty() {
            return None;
        }
        let q = self.variables;
        let of: Vec<(usize, usize)> = (0..q).flat_map(|i| (i..q).map(move |j| (i, j))).collect();
        let last = of.len();
        let mut g = Mat::zeros(last + 1, last + 1);
        for a in 0..last {
            for b in a..last {
                let mut four = [of[a].0, of[a].1, of[b].0, of[b].1];
                four.sort_unstable();
                let [i, j, k, l] = four;
                let sum = fourth_start(q, j) + i * pairs(q - j) + pair(q, k, l) - pair(q, j, j);
                (g[(a, b)], g[(b, a)]) = (self.fourth[sum], self.fourth[sum]);
            }
            (g[(a, last)], g[(last, a)]) = (self.height[a], self.height[a]);
        }
        let y = q + HEIGHT_ROW;
        g[(last, last)] = self.second[y * (q + STATE_LEN) + y];
        Some(Gram::new(self.rows, last, g))
    }
}

impl Merge for Moments {
    fn merge(mut self, later: Self) -> Self {
        self.rows += later.rows;
        for (sums, others) in [
            (&mut self.second, later.second),
            (&mut self.fourth, later.fourth),
            (&mut self.height, later.height),
        ] {
            for (sum, other) in sums.iter_mut().zip(others) {
                *sum += other;
            }
        }
        self
    }
}

/// Number of pairs i ≤ j of `q` things.
fn pairs(q: usize) -> usize {
    q * (q + 1) / 2
}

/// Place of the pair i ≤ j of `q` things, ordered by i, then j.
fn pair(q: usize, i: usize, j: usize) -> usize {
    pairs(q) - pairs(q - i) + j - i
}

/// Number of i ≤ j' ≤ k ≤ l of `q` things with j' < j.
fn fourth_start(q: usize, j: usize) -> usize {
    (0..j).map(|j| (j + 1) * pairs(q - j)).sum()
}

/// Ranges of j whose pairs are multiplied together.
fn groups(q: usize) -> Vec<Range<usize>> {
    let mut groups = Vec::new();
    let mut start = 0;
    while start < q {
        let mut end = start + 1;
        while end < q && pairs(end + 1) - pairs(start) <= GROUP_PAIRS {
            end += 1;
        }
        groups.push(start..end);
        start = end;
    }
    groups
}

/// [`Moments::fourth`] and [`Moments::height`].
fn sums_of_products(e: MatRef<'_, f64>, y: MatRef<'_, f64>) -> (Vec<f64>, Vec<f64>) {
    let q = e.ncols();
    let groups = groups(q);
    let left = |group: &Range<usize>| (pairs(group.start), pairs(group.end) - pairs(group.start));
    let right = |group: &Range<usize>| (pair(q, group.start, group.start), pairs(q - group.start));
    let mut sums: Vec<Mat<f64>> = groups
        .iter()
        .map(|group| Mat::zeros(left(group).1, right(group).1))
        .collect();
    let mut height = Mat::zeros(pairs(q), 1);
    let rows = e.nrows();
    // Columns e_i e_j, ordered by (i, j), and by (j, i).
    let mut by_first = Mat::<f64>::zeros(rows.min(BLOCK_ROWS), pairs(q));
    let mut by_second = by_first.clone();
    for top in (0..rows).step_by(BLOCK_ROWS) {
        let count = BLOCK_ROWS.min(rows - top);
        let block = e.subrows(top, count);
        for j in 0..q {
            for i in 0..=j {
                let factors = block.col(i).iter().zip(block.col(j).iter());
                let (first, second) = (pair(q, i, j), pairs(j) + i);
                let columns = by_first.col_as_slice_mut(first)[..count]
                    .iter_mut()
                    .zip(&mut by_second.col_as_slice_mut(second)[..count]);
                for ((first, second), (a, b)) in columns.zip(factors) {
                    (*first, *second) = (a * b, a * b);
                }
            }
        }
        let (by_first, by_second) = (by_first.subrows(0, count), by_second.subrows(0, count));
        for (group, sum) in groups.iter().zip(&mut sums) {
            let ((start, len), (tail, tail_len)) = (left(group), right(group));
            let (lhs, rhs) = (by_second.subcols(start, len), by_first.subcols(tail, tail_len));
            matmul(sum.as_mut(), Accum::Add, lhs.transpose(), rhs, 1.0, Par::Seq);
        }
        let target = y.subrows(top, count).subcols(HEIGHT_ROW, 1);
        matmul(
            height.as_mut(),
            Accum::Add,
            by_first.transpose(),
            target,
            1.0,
            Par::Seq,
        );
    }
    let mut fourth = Vec::with_capacity(fourth_start(q, q));
    for (group, sum) in groups.iter().zip(&sums) {
        for j in group.clone() {
            let skipped = pair(q, j, j) - right(group).0;
            for i in 0..=j {
                let row = pairs(j) - left(group).0 + i;
                fourth.extend((skipped..sum.ncols()).map(|column| sum[(row, column)]));
            }
        }
    }
    (fourth, height.col_as_slice(0).to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        Mat::from_fn(rows, columns, |_, _| random.random_range(-1.0..1.0))
    }

    #[test]
    fn every_entry_of_the_gram_matrix_is_its_own_sum() {
        for (variables, rows) in [(3, 7), (10, 2 * BLOCK_ROWS + 5)] {
            let mut e = random(rows, variables, 1);
            e.col_mut(0).fill(1.0);
            let y = random(rows, STATE_LEN, 2);
            let moments = Moments::of_rows(e.as_ref(), y.as_ref(), true);
            assert!(moments.fits(variables, true) && !moments.fits(variables, false));
            let mut terms = Mat::<f64>::zeros(rows, pairs(variables) + 1);
            for row in 0..rows {
                for i in 0..variables {
                    for j in i..variables {
                        terms[(row, pair(variables, i, j))] = e[(row, i)] * e[(row, j)];
                    }
                }
                terms[(row, pairs(variables))] = y[(row, HEIGHT_ROW)];
            }
            let gram = moments.height_gram().unwrap();
            let error = (gram.matrix() - terms.transpose() * &terms).norm_max();
            assert!(error < 1e-12 * rows as f64, "{error}");

            let m = random(4, variables, 3);
            let linear = faer::concat![[&e * m.transpose(), y]];
            let error = (moments.linear_gram(m.as_ref()).matrix() - linear.transpose() * &linear).norm_max();
            assert!(error < 1e-12 * rows as f64, "{error}");
        }
    }

    #[test]
    fn sums_of_parts_add_up() {
        let (e, y) = (random(50, 6, 4), random(50, STATE_LEN, 5));
        let whole = Moments::of_rows(e.as_ref(), y.as_ref(), true);
        let part = |from, count| {
            Moments::of_rows(
                e.as_ref().subrows(from, count),
                y.as_ref().subrows(from, count),
                true,
            )
        };
        let merged = part(0, 20).merge(part(20, 30));
        assert_eq!(merged.rows, 50);
        for (sums, others) in [
            (&merged.second, &whole.second),
            (&merged.fourth, &whole.fourth),
            (&merged.height, &whole.height),
        ] {
            assert!(sums.iter().zip(others).all(|(a, b)| (a - b).abs() < 1e-13));
        }
    }
}
