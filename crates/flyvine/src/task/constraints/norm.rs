//! The length of a vector that is linear in the motion.

use crate::trajopt::Output;

/// Rounds off the tip of the cone |v|, where it has no slope; far below every bound.
const TIP: f64 = 1e-6;

/// `y = √(Σ_r v_r² + ε²)` with `v_r = offset_r + Σ_i c_ri w_i`.
#[derive(Debug)]
pub(super) struct Norm {
    /// (offset, (entry of w, coefficient)) for each component.
    rows: Vec<(f64, Vec<(usize, f64)>)>,
}

impl Norm {
    pub fn new(rows: Vec<(f64, Vec<(usize, f64)>)>) -> Self {
        Self { rows }
    }

    fn components<'n>(&'n self, w: &'n [f64]) -> impl Iterator<Item = f64> + 'n {
        self.rows.iter().map(|(offset, terms)| {
            let sum: f64 = terms
                .iter()
                .map(|(entry, coefficient)| coefficient * w[*entry])
                .sum();
            offset + sum
        })
    }
}

impl Output for Norm {
    fn value(&self, w: &[f64]) -> f64 {
        let squares: f64 = self.components(w).map(|v| v * v).sum();
        (squares + TIP * TIP).sqrt()
    }

    /// `∇y = Cᵀv / y`, `∇²y = (CᵀC − ∇y ∇yᵀ) / y`.
    fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let y = self.value(w);
        gradient.fill(0.0);
        hessian.fill(0.0);
        for (v, (_, terms)) in self.components(w).zip(&self.rows) {
            for (i, c) in terms {
                gradient[*i] += c * v / y;
                for (j, d) in terms {
                    hessian[i * w.len() + j] += c * d / y;
                }
            }
        }
        for i in 0..w.len() {
            for j in 0..w.len() {
                hessian[i * w.len() + j] -= gradient[i] * gradient[j] / y;
            }
        }
        y
    }
}

/// How far a norm is beyond an edge: `max(0, |v| − edge)`. Its square has a slope everywhere.
#[derive(Debug)]
pub(super) struct Excess {
    norm: Norm,
    edge: f64,
}

impl Excess {
    pub fn new(norm: Norm, edge: f64) -> Self {
        Self { norm, edge }
    }
}

impl Output for Excess {
    fn value(&self, w: &[f64]) -> f64 {
        (self.norm.value(w) - self.edge).max(0.0)
    }

    fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let beyond = self.norm.derivatives(w, gradient, hessian) - self.edge;
        if beyond <= 0.0 {
            gradient.fill(0.0);
            hessian.fill(0.0);
        }
        beyond.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_output_derivatives;
    use super::*;

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let norm = Norm::new(vec![(0.3, vec![(0, 1.0), (4, -2.0)]), (-0.1, vec![(3, 0.5)])]);
        let w: Vec<f64> = (0..21).map(|i| (i as f64).sin()).collect();
        assert_output_derivatives(&norm, &w);
    }
}
