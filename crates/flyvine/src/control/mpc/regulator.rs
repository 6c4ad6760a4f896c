//! The time-varying linear-quadratic regulator along a trajectory.

use super::condensed::{Stage, TrackingWeights};
use nalgebra::DMatrix;

/// Gains and costs to go along a trajectory of N knots.
#[derive(Debug, Clone)]
pub struct Regulator {
    /// K_k (N − 1, each m × n) in `u = u*_k + K_k (z − z*_k)`.
    pub gains: Vec<DMatrix<f64>>,
    /// P_k (N, each n × n): cost to go from knot k on, without what the knot itself costs.
    pub cost_to_go: Vec<DMatrix<f64>>,
}

/// The regulator for stages with these `jacobians`, by the Riccati recursion from P = 0 behind the last knot:
///
/// ```text
/// S = Q + P_{k+1},   K_k = −(R + Bᵀ S B)⁻¹ Bᵀ S A,   P_k = Aᵀ S A + Aᵀ S B K_k
/// ```
///
/// where the weights on command and change of command together are R.
pub fn regulate(stage: &Stage, jacobians: &[f64], weights: &TrackingWeights) -> Regulator {
    let n = stage.state;
    let mut gains = Vec::new();
    let mut cost_to_go = vec![DMatrix::zeros(n, n)];
    for jacobian in jacobians.rchunks_exact(stage.jacobian_len()) {
        let (a, b) = stage.transition(jacobian);
        let mut s = cost_to_go[cost_to_go.len() - 1].clone();
        for i in 0..n {
            s[(i, i)] += weights.state[i];
        }
        let (sa, sb) = (&s * &a, &s * &b);
        let mut command = b.transpose() * &sb;
        for i in 0..stage.command {
            command[(i, i)] += weights.command[i] + weights.command_change[i];
        }
        let cross = b.transpose() * &sa;
        // Weights are positive, so only a model that has left the finite numbers has no factor: no feedback then.
        let gain = command.cholesky().map_or_else(
            || DMatrix::zeros(stage.command, n),
            |factor| -factor.solve(&cross),
        );
        let cost = a.transpose() * sa + cross.transpose() * &gain;
        cost_to_go.push(0.5 * (&cost + cost.transpose()));
        gains.push(gain);
    }
    gains.reverse();
    cost_to_go.reverse();
    Regulator { gains, cost_to_go }
}
