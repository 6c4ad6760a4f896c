//! Costates, the reduced gradient, and how far it is from zero.
//!
//! ```text
//! λ_k = l_z + A_kᵀ λ_{k+1}[..fresh] + Sᵀ λ_{k+1}[fresh..],   g_k = l_u + B_kᵀ λ_{k+1}[..fresh] = ∂J/∂u_k
//! ```

use super::super::Problem;
use super::expansion::Expansion;
use super::{Shape, Trajectory};
use crate::kernel::{self, Entries};

/// `(λ_k, g_k)` for every knot.
#[derive(Debug, Clone)]
pub struct Adjoint {
    shape: Shape,
    /// N × stride: λ_k in the state's place, g_k in the command's.
    values: Entries,
}

impl Adjoint {
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            values: kernel::zeros(shape.knots * shape.stride),
        }
    }

    /// λ_k.
    pub fn costate(&self, knot: usize) -> &[f64] {
        &self.values[knot * self.shape.stride..][..self.shape.state]
    }

    /// g_k.
    pub fn gradient(&self, knot: usize) -> &[f64] {
        &self.values[knot * self.shape.stride + self.shape.state..][..self.shape.command]
    }

    /// All zero: no gradient to follow.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// One sweep from the last knot to the first.
    pub fn sweep(&mut self, trajectory: &Trajectory, expansion: &Expansion) {
        let Shape { state, stride, .. } = self.shape;
        let last = self.shape.steps();
        self.values[last * stride..][..state].copy_from_slice(&expansion.gradient(last)[..state]);
        for knot in (0..last).rev() {
            let (now, next) = self.values[knot * stride..][..2 * stride].split_at_mut(stride);
            now.copy_from_slice(expansion.gradient(knot));
            add_transpose_step(self.shape, trajectory.jacobian(knot), next, now);
        }
    }

    /// The largest `|g|`, where a command on its bound only counts if the gradient points inwards.
    pub fn projected_norm(&self, problem: &Problem, trajectory: &Trajectory) -> f64 {
        let mut norm = 0.0_f64;
        for knot in 0..self.shape.steps() {
            for (j, (&g, &u)) in self
                .gradient(knot)
                .iter()
                .zip(trajectory.command(knot))
                .enumerate()
            {
                let held =
                    (u <= problem.command_lower[j] && g > 0.0) || (u >= problem.command_upper[j] && g < 0.0);
                norm = if held { norm } else { norm.max(g.abs()) };
            }
        }
        norm
    }
}

/// `now += (Cᵀ next[..fresh] + Sᵀ next[fresh..n])`: the transpose of one linearized step.
pub fn add_transpose_step(shape: Shape, jacobian: &[f64], next: &[f64], now: &mut [f64]) {
    kernel::add_transpose_vector(jacobian, &next[..shape.fresh], now);
    for (entry, &shifted) in now.iter_mut().zip(&next[shape.fresh..shape.state]) {
        *entry += shifted;
    }
}
