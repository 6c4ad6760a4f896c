//! First and second derivatives of the Lagrangian along a trajectory.

use super::super::Problem;
use super::super::augmented_lagrangian::AugmentedLagrangian;
use super::secant::Secant;
use super::{Shape, Trajectory};
use crate::trajopt::Dynamics;

/// Derivatives at every knot.
#[derive(Debug, Clone)]
pub struct Expansion {
    shape: Shape,
    /// `∂/∂w` of cost and multiplier terms, N × stride.
    gradients: Vec<f64>,
    /// Diagonal of `∂²/∂w²` of cost and multiplier terms, N × stride.
    diagonals: Vec<f64>,
    /// The curvature of dynamics that do not give theirs.
    pub secant: Option<Secant>,
}

impl Expansion {
    pub fn new<D: Dynamics + ?Sized>(shape: Shape, dynamics: &D, start: &[f64]) -> Self {
        Self {
            secant: (!gives_curvature(shape, dynamics, start)).then(|| Secant::new(shape)),
            shape,
            gradients: vec![0.0; shape.knots * shape.stride],
            diagonals: vec![0.0; shape.knots * shape.stride],
        }
    }

    pub fn gradient(&self, knot: usize) -> &[f64] {
        &self.gradients[knot * self.shape.stride..][..self.shape.stride]
    }

    pub fn diagonal(&self, knot: usize) -> &[f64] {
        &self.diagonals[knot * self.shape.stride..][..self.shape.stride]
    }

    /// Gradient and Hessian of the cost and of the multiplier terms.
    pub fn update(&mut self, problem: &Problem, constraints: &AugmentedLagrangian, trajectory: &Trajectory) {
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

/// Whether the dynamics add second derivatives of their own, as a look at the start tells.
fn gives_curvature<D: Dynamics + ?Sized>(shape: Shape, dynamics: &D, start: &[f64]) -> bool {
    let mut hessian = vec![0.0; shape.width() * shape.stride];
    let (command, adjoint) = (vec![0.0; shape.command], vec![1.0; shape.fresh]);
    dynamics.add_curvature(0, start, &command, &adjoint, shape.stride, &mut hessian);
    hessian.iter().any(|&entry| entry != 0.0)
}
