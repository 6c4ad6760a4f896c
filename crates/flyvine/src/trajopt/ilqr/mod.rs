//! One iteration of constrained DDP, one file per pass.
//!
//! Points are `w = (z, u)`, one per knot, padded to `Shape::stride`; Jacobian rows share that layout, so a row of
//! `C = [A B]` is `[∂f/∂z ∂f/∂u 0…]`. With S the shift, `δz⁺ = (C δw, S δw)`.

pub(super) mod adjoint;
pub(super) mod backward;
pub(super) mod command_box;
pub(super) mod expansion;
pub(super) mod forward;
pub(super) mod riccati;
pub(super) mod rollout;
pub(super) mod secant;

use super::{Dynamics, Problem};
use crate::kernel::{self, Entries};

/// Sizes that every pass needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    /// N.
    pub knots: usize,
    /// n.
    pub state: usize,
    /// m.
    pub command: usize,
    /// Entries of the next state that are computed; the others are shifted copies.
    pub fresh: usize,
    /// Padded length of a row over `w = (z, u)`: n + m rounded up to whole SIMD vectors.
    pub stride: usize,
}

impl Shape {
    pub fn new<D: Dynamics + ?Sized>(problem: &Problem, dynamics: &D) -> Self {
        let (state, command) = (dynamics.state_len(), dynamics.command_len());
        let stride = kernel::padded(state + command);
        Self {
            knots: problem.knots,
            state,
            command,
            fresh: dynamics.fresh_len(),
            stride,
        }
    }

    /// N − 1.
    pub fn steps(&self) -> usize {
        self.knots - 1
    }

    /// n + m.
    pub fn width(&self) -> usize {
        self.state + self.command
    }
}

/// States and commands, and the linearization of the dynamics along them.
#[derive(Debug, Clone)]
pub(super) struct Trajectory {
    shape: Shape,
    /// `w_k = (z_k, u_k, 0…)`, N × stride; the last command is unused.
    points: Entries,
    /// `C_k = [A_k B_k]`, (N−1) × fresh × stride.
    jacobians: Entries,
    /// Room for the step that comes with a Jacobian.
    fresh: Vec<f64>,
    /// Room for the difference of two points.
    difference: Entries,
}

impl Trajectory {
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            points: kernel::zeros(shape.knots * shape.stride),
            jacobians: kernel::zeros(shape.steps() * shape.fresh * shape.stride),
            fresh: vec![0.0; shape.fresh],
            difference: kernel::zeros(shape.stride),
        }
    }

    /// `w_k`, padded.
    pub fn point(&self, knot: usize) -> &[f64] {
        &self.points[knot * self.shape.stride..][..self.shape.stride]
    }

    pub fn state(&self, knot: usize) -> &[f64] {
        &self.points[knot * self.shape.stride..][..self.shape.state]
    }

    pub fn command(&self, knot: usize) -> &[f64] {
        &self.points[knot * self.shape.stride + self.shape.state..][..self.shape.command]
    }

    pub fn state_mut(&mut self, knot: usize) -> &mut [f64] {
        &mut self.points[knot * self.shape.stride..][..self.shape.state]
    }

    pub fn command_mut(&mut self, knot: usize) -> &mut [f64] {
        &mut self.points[knot * self.shape.stride + self.shape.state..][..self.shape.command]
    }

    /// `C_k`, fresh × stride.
    pub fn jacobian(&self, knot: usize) -> &[f64] {
        let len = self.shape.fresh * self.shape.stride;
        &self.jacobians[knot * len..][..len]
    }

    /// `u_k = K (z_k − z_k of other)`, K being m × stride and zero beyond the states.
    pub fn feed_back(&mut self, knot: usize, gain: &[f64], other: &Self) {
        let Shape {
            state: n,
            command: m,
            stride,
            ..
        } = self.shape;
        let point = &mut self.points[knot * stride..][..stride];
        for ((difference, own), other) in self.difference.iter_mut().zip(&*point).zip(other.point(knot)) {
            *difference = own - other;
        }
        kernel::multiply(gain, &self.difference, &mut point[n..n + m]);
    }

    /// `z_{k+1} = (f_k(z_k, u_k), z_k[0..n − fresh])`, and C_k if asked for.
    pub fn advance<D: Dynamics + ?Sized>(&mut self, dynamics: &D, knot: usize, linearize: bool) {
        let Shape {
            state: n,
            command: m,
            fresh,
            stride,
            ..
        } = self.shape;
        let (now, next) = self.points[knot * stride..][..2 * stride].split_at_mut(stride);
        let (state, command) = now[..n + m].split_at(n);
        let (fresh_part, shifted_part) = next[..n].split_at_mut(fresh);
        shifted_part.copy_from_slice(&state[..n - fresh]);
        if linearize {
            let jacobian = &mut self.jacobians[knot * fresh * stride..][..fresh * stride];
            dynamics.linearize_padded(knot, state, command, fresh_part, stride, jacobian);
        } else {
            dynamics.step(knot, state, command, fresh_part);
        }
    }

    /// `C_k` at every knot, for the states as they are.
    pub fn linearize<D: Dynamics + ?Sized>(&mut self, dynamics: &D) {
        let Shape {
            state: n,
            command: m,
            fresh,
            stride,
            ..
        } = self.shape;
        let points = self.points.chunks_exact(stride);
        for (knot, (jacobian, point)) in self
            .jacobians
            .chunks_exact_mut(fresh * stride)
            .zip(points)
            .enumerate()
        {
            let (state, command) = point[..n + m].split_at(n);
            dynamics.linearize_padded(knot, state, command, &mut self.fresh, stride, jacobian);
        }
    }
}
