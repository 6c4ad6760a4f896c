//! The covariance of an estimate: propagation through a linear map, and scalar measurements.

use crate::kernel::{self, Rows, Wanted};

/// A square matrix with padded rows, stored transposed, as the products want it.
#[derive(Debug, Clone)]
pub(super) struct Transition {
    stride: usize,
    transposed: Vec<f64>,
}

impl Transition {
    /// All zero.
    pub fn clear(&mut self) {
        self.transposed.fill(0.0);
    }

    /// F\[i\]\[j\] = entry.
    pub fn set(&mut self, i: usize, j: usize, entry: f64) {
        self.transposed[j * self.stride + i] = entry;
    }
}

/// P, symmetric (full, rows padded), with the memory that its propagation needs.
#[derive(Debug, Clone)]
pub(super) struct Covariance {
    len: usize,
    stride: usize,
    matrix: Vec<f64>,
    transition: Transition,
    product: Vec<f64>,
    turned: Vec<f64>,
    column: Vec<f64>,
}

/// A square matrix for the kernel.
fn rows(entries: &[f64], stride: usize) -> Rows<'_> {
    Rows::new(entries, entries.len() / stride, stride)
}

impl Covariance {
    /// Independent entries with these standard deviations.
    pub fn diagonal(deviations: &[f64]) -> Self {
        let len = deviations.len();
        let stride = kernel::padded(len);
        let mut matrix = vec![0.0; len * stride];
        for (i, deviation) in deviations.iter().enumerate() {
            matrix[i * stride + i] = deviation * deviation;
        }
        Self {
            len,
            stride,
            transition: Transition {
                stride,
                transposed: matrix.clone(),
            },
            product: matrix.clone(),
            turned: matrix.clone(),
            matrix,
            column: vec![0.0; len],
        }
    }

    /// Independent entries with these standard deviations, once more.
    pub fn reset(&mut self, deviations: &[f64]) {
        self.matrix.fill(0.0);
        for (i, deviation) in deviations.iter().enumerate() {
            self.matrix[i * self.stride + i] = deviation * deviation;
        }
    }

    /// P\[i\]\[i\].
    pub fn variance(&self, i: usize) -> f64 {
        self.matrix[i * self.stride + i]
    }

    /// The map F of the next [`Self::propagate`], to be filled in.
    pub fn transition(&mut self) -> &mut Transition {
        &mut self.transition
    }

    /// P ← F P Fᵀ + diag(deviations²).
    pub fn propagate(&mut self, deviations: &[f64]) {
        let stride = self.stride;
        // (F P)ᵀ row by row is what the second product needs on its right.
        kernel::sum_products(
            [(
                rows(&self.transition.transposed, stride),
                rows(&self.matrix, stride),
            )],
            Wanted::All,
            stride,
            &mut self.product,
        );
        for i in 0..self.len {
            for j in 0..self.len {
                self.turned[j * stride + i] = self.product[i * stride + j];
            }
        }
        kernel::sum_products(
            [(
                rows(&self.transition.transposed, stride),
                rows(&self.turned, stride),
            )],
            Wanted::Upper { columns: self.len },
            stride,
            &mut self.matrix,
        );
        for i in 0..self.len {
            for j in 0..i {
                self.matrix[i * stride + j] = self.matrix[j * stride + i];
            }
            self.matrix[i * stride + i] += deviations[i] * deviations[i];
        }
    }

    /// Takes in a measurement of entry `index` with variance `noise`: moves `mean` by the gain times `innovation`,
    /// P ← P − p pᵀ / s. Gives the innovation's variance s.
    pub fn observe(&mut self, index: usize, noise: f64, innovation: f64, mean: &mut [f64]) -> f64 {
        let stride = self.stride;
        self.column
            .copy_from_slice(&self.matrix[index * stride..][..self.len]);
        let variance = self.column[index] + noise;
        for i in 0..self.len {
            let gain = self.column[i] / variance;
            mean[i] += gain * innovation;
            let row = &mut self.matrix[i * stride..][..self.len];
            for (entry, other) in row.iter_mut().zip(&self.column) {
                *entry -= gain * other;
            }
        }
        variance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn propagation_and_observation_are_the_textbook_formulas() {
        let deviations = [0.5, 1.0, 2.0, 0.1, 0.7];
        let mut covariance = Covariance::diagonal(&deviations);
        let mut expected = DMatrix::from_diagonal(&DVector::from_row_slice(&deviations).map(|d| d * d));
        let mut mean = vec![0.0; 5];
        for step in 0..4 {
            let map = DMatrix::from_fn(5, 5, |i, j| ((3 * i + 5 * j + step) as f64).sin());
            covariance.transition().clear();
            for i in 0..5 {
                for j in 0..5 {
                    covariance.transition().set(i, j, map[(i, j)]);
                }
            }
            covariance.propagate(&[0.1; 5]);
            expected = &map * expected * map.transpose() + DMatrix::identity(5, 5) * 0.01;
            let (index, noise) = (step, 0.3);
            let gain = expected.column(index) / (expected[(index, index)] + noise);
            let before = mean.clone();
            let variance = covariance.observe(index, noise, 0.8, &mut mean);
            assert!((variance - expected[(index, index)] - noise).abs() < 1e-10 * variance);
            let row = expected.row(index).into_owned();
            expected -= &gain * row;
            for i in 0..5 {
                assert!((mean[i] - before[i] - 0.8 * gain[i]).abs() < 1e-10);
                for j in 0..5 {
                    let found = covariance.matrix[i * covariance.stride + j];
                    assert!(
                        (found - expected[(i, j)]).abs() < 1e-9 * expected.amax(),
                        "{i} {j}"
                    );
                }
            }
        }
    }
}
