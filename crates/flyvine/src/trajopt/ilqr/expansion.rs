//! First and second derivatives along a trajectory.

use super::super::augmented_lagrangian::AugmentedLagrangian;
use super::super::{Dynamics, Problem};
use super::{Shape, Trajectory};

/// Derivatives at every knot.
#[derive(Debug, Clone)]
pub struct Expansion {
    shape: Shape,
    /// `C_k = [A_k B_k]`, (N−1) × fresh × stride.
    jacobians: Vec<f64>,
    /// `∂/∂w` of cost and multiplier terms, N × stride.
    gradients: Vec<f64>,
    /// Diagonal of `∂²/∂w²` of cost and multiplier terms, N × stride.
    diagonals: Vec<f64>,
    /// One Jacobian as the model writes it, fresh × (n + m).
    compact: Vec<f64>,
}

impl Expansion {
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            jacobians: vec![0.0; shape.steps() * shape.fresh * shape.stride],
            gradients: vec![0.0; shape.knots * shape.stride],
            diagonals: vec![0.0; shape.knots * shape.stride],
            compact: vec![0.0; shape.fresh * shape.width()],
        }
    }

    /// `C_k`, fresh × stride.
    pub fn jacobian(&self, knot: usize) -> &[f64] {
        let len = self.shape.fresh * self.shape.stride;
        &self.jacobians[knot * len..][..len]
    }

    pub fn gradient(&self, knot: usize) -> &[f64] {
        &self.gradients[knot * self.shape.stride..][..self.shape.stride]
    }

    pub fn diagonal(&self, knot: usize) -> &[f64] {
        &self.diagonals[knot * self.shape.stride..][..self.shape.stride]
    }

    /// Jacobians of the dynamics.
    pub fn expand_dynamics<D: Dynamics + ?Sized>(&mut self, dynamics: &D, trajectory: &Trajectory) {
        let Shape { fresh, stride, .. } = self.shape;
        let width = self.shape.width();
        for (knot, jacobian) in self.jacobians.chunks_exact_mut(fresh * stride).enumerate() {
            dynamics.jacobian(
                knot,
                trajectory.state(knot),
                trajectory.command(knot),
                &mut self.compact,
            );
            for (row, compact) in jacobian
                .chunks_exact_mut(stride)
                .zip(self.compact.chunks_exact(width))
            {
                row[..width].copy_from_slice(compact);
            }
        }
    }

    /// Gradient and Hessian of the cost and of the multiplier terms.
    pub fn expand_cost(
        &mut self,
        problem: &Problem,
        constraints: &AugmentedLagrangian,
        trajectory: &Trajectory,
    ) {
        let Shape {
            knots,
            state: n,
            command: m,
            stride,
            ..
        } = self.shape;
        for knot in 0..knots {
            let gradient = &mut self.gradients[knot * stride..][..stride];
            let diagonal = &mut self.diagonals[knot * stride..][..stride];
            let reference = &problem.state_reference[knot * n..][..n];
            for (i, &z) in trajectory.state(knot).iter().enumerate() {
                gradient[i] = 2.0 * problem.state_weight[i] * (z - reference[i]);
                diagonal[i] = 2.0 * problem.state_weight[i];
            }
            for constraint in constraints.at(knot) {
                let (first, second) = constraint.derivatives(trajectory.state(knot)[constraint.index]);
                gradient[constraint.index] += first;
                diagonal[constraint.index] += second;
            }
            if knot + 1 < knots {
                let reference = &problem.command_reference[knot * m..][..m];
                for (j, &u) in trajectory.command(knot).iter().enumerate() {
                    gradient[n + j] = 2.0 * problem.command_weight[j] * (u - reference[j]);
                    diagonal[n + j] = 2.0 * problem.command_weight[j];
                }
            }
        }
    }
}
