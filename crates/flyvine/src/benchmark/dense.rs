//! Any dynamics as if every entry of the next state were computed.

use crate::trajopt::Dynamics;

/// The same dynamics with the shift hidden: the solver takes its dense path, for comparison.
pub struct Dense<'a, D>(pub &'a D);

impl<D: Dynamics> Dynamics for Dense<'_, D> {
    fn state_len(&self) -> usize {
        self.0.state_len()
    }

    fn command_len(&self) -> usize {
        self.0.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.0.state_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], next: &mut [f64]) {
        let (fresh, shifted) = next.split_at_mut(self.0.fresh_len());
        self.0.step(knot, state, command, fresh);
        shifted.copy_from_slice(&state[..shifted.len()]);
    }

    fn linearize(&self, knot: usize, state: &[f64], command: &[f64], next: &mut [f64], jacobian: &mut [f64]) {
        let (width, fresh_len) = (state.len() + command.len(), self.0.fresh_len());
        let (fresh, shifted) = next.split_at_mut(fresh_len);
        shifted.copy_from_slice(&state[..shifted.len()]);
        jacobian.fill(0.0);
        let (top, bottom) = jacobian.split_at_mut(fresh_len * width);
        self.0.linearize(knot, state, command, fresh, top);
        for (i, row) in bottom.chunks_exact_mut(width).enumerate() {
            row[i] = 1.0;
        }
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        self.0
            .add_curvature(knot, z, u, &adjoint[..self.0.fresh_len()], stride, hessian);
    }
}
