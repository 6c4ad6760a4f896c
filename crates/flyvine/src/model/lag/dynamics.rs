//! What the solver asks of a lag model.

use super::{LagModel, MAX_REGRESSOR_LEN, QuadraticRow, STATE_LEN};
use crate::kernel;
use crate::trajopt::Dynamics;

impl Dynamics for LagModel {
    fn state_len(&self) -> usize {
        self.lags * STATE_LEN
    }

    fn command_len(&self) -> usize {
        self.inputs.len()
    }

    fn fresh_len(&self) -> usize {
        STATE_LEN
    }

    fn step(&self, _knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        self.linear_step(w, fresh);
        for quadratic in &self.quadratic {
            let mut slope = [0.0; MAX_REGRESSOR_LEN];
            fresh[quadratic.row] += quadratic.value(w, &mut slope[..w.len()]);
        }
    }

    fn linearize(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        let p = self.regressor_len();
        self.linear_step(w, fresh);
        let rows = jacobian.chunks_exact_mut(p);
        for (row, linear) in rows.zip(self.linear.chunks_exact(w.len())) {
            row.copy_from_slice(&linear[..p]);
        }
        for quadratic in &self.quadratic {
            let mut slope = [0.0; MAX_REGRESSOR_LEN];
            fresh[quadratic.row] += quadratic.value(w, &mut slope[..w.len()]);
            add(&mut jacobian[quadratic.row * p..][..p], &slope);
        }
    }

    fn linearize_padded(
        &self,
        _knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        stride: usize,
        jacobian: &mut [f64],
    ) {
        let mut buffer = [0.0; MAX_REGRESSOR_LEN];
        let w = regressor(state, command, &mut buffer);
        self.linear_step(w, fresh);
        // Its rows are padded like those of `jacobian`.
        jacobian.copy_from_slice(&self.linear);
        for quadratic in &self.quadratic {
            let rows = quadratic.row * stride..(quadratic.row + 1) * stride;
            let slope = &mut jacobian[rows.clone()];
            slope.fill(0.0);
            fresh[quadratic.row] += quadratic.value(w, slope);
            add(slope, &self.linear[rows]);
        }
    }

    fn add_curvature(
        &self,
        _knot: usize,
        _state: &[f64],
        _command: &[f64],
        adjoint: &[f64],
        _stride: usize,
        hessian: &mut [f64],
    ) {
        for quadratic in &self.quadratic {
            // Its rows are padded like those of `hessian`.
            kernel::add_transpose_vector(&quadratic.hessian, &[adjoint[quadratic.row]], hessian);
        }
    }
}

impl LagModel {
    /// `c + L w`, with w padded.
    fn linear_step(&self, w: &[f64], fresh: &mut [f64]) {
        kernel::multiply(&self.linear, w, fresh);
        for (entry, offset) in fresh.iter_mut().zip(&self.offset) {
            *entry += offset;
        }
    }
}

/// `to += from`, as far as `to` goes.
fn add(to: &mut [f64], from: &[f64]) {
    for (entry, addend) in to.iter_mut().zip(from) {
        *entry += addend;
    }
}

impl QuadraticRow {
    /// `½ wᵀ H w`, with w padded; adds its gradient `H w` to `slope`.
    fn value(&self, w: &[f64], slope: &mut [f64]) -> f64 {
        kernel::add_transpose_vector(&self.hessian, &w[..self.hessian.len() / w.len()], slope);
        0.5 * w.iter().zip(slope).map(|(w, slope)| w * *slope).sum::<f64>()
    }
}

/// `w = (z, u, 0…)` in `buffer`, padded.
fn regressor<'a>(state: &[f64], command: &[f64], buffer: &'a mut [f64; MAX_REGRESSOR_LEN]) -> &'a [f64] {
    let (n, m) = (state.len(), command.len());
    buffer[..n].copy_from_slice(state);
    buffer[n..n + m].copy_from_slice(command);
    &buffer[..kernel::padded(n + m)]
}
