//! Problems with bounds on functions of the motion: distances from obstacles, speeds.
//!
//! The state is joined by outputs y in every lag, so that the companion form stays:
//!
//! ```text
//! (x, y)⁺ = (f(z, u), g(w)),   w = (first entries of x⁺, first entries of x, u)
//! ```
//!
//! A bound on y, hard or at a price, and a cost of y² are then those of a state: the solver needs no other kind of
//! constraint.

use super::joined::Joined;
use super::{Dynamics, Problem, StateBound};
use crate::kernel;
use std::sync::Arc;

/// A twice differentiable function y of `w = (x⁺, x, u)`, of x only the entries that [`WithOutputs`] shows.
pub trait Output: Send + Sync + std::fmt::Debug {
    /// y.
    fn value(&self, w: &[f64]) -> f64;

    /// y, with ∂y/∂w and ∂²y/∂w² (full, row-major) written.
    fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64;
}

/// A model that also says what some functions of its motion are.
#[derive(Debug)]
pub struct WithOutputs<'o, D> {
    dynamics: D,
    outputs: &'o [Arc<dyn Output>],
    joined: Joined,
    /// Entries of x that outputs see.
    seen: usize,
}

impl<'o, D: Dynamics> WithOutputs<'o, D> {
    /// Joins `outputs` of the first `seen` entries of x to the state of `dynamics`, which is a whole number of lags.
    pub fn new(dynamics: D, outputs: &'o [Arc<dyn Output>], seen: usize) -> Self {
        debug_assert!(seen <= dynamics.fresh_len());
        Self {
            joined: Joined::new(&dynamics, outputs.len()),
            dynamics,
            outputs,
            seen,
        }
    }

    /// A name for every entry of the state, from those of the model's own and of the outputs.
    pub fn names(&self, own: &[String], outputs: &[String]) -> Vec<String> {
        self.joined.names(own, outputs)
    }

    /// The model's own states (N × n) out of the joined ones.
    pub fn own_states(&self, joined: &[f64]) -> Vec<f64> {
        self.joined.own_states(joined)
    }

    /// `problem` with a weight on the square of each output, and bounds on outputs, whose index is the output's.
    pub fn pose(&self, problem: &Problem, weights: &[f64], bounds: &[StateBound]) -> Problem {
        let at_start = &problem.start[..self.seen];
        let w = [at_start, at_start, &problem.command_guess[..self.joined.command]].concat();
        let start: Vec<f64> = self.outputs.iter().map(|output| output.value(&w)).collect();
        let mut posed = self.joined.pose(problem, &start);
        posed.state_weight[self.joined.fresh..][..weights.len()].copy_from_slice(weights);
        posed.state_bounds.extend(bounds.iter().map(|bound| StateBound {
            index: self.joined.fresh + bound.index,
            ..bound.clone()
        }));
        posed
    }

    fn arguments(&self, next: &[f64], own: &[f64], command: &[f64]) -> Vec<f64> {
        [&next[..self.seen], &own[..self.seen], command].concat()
    }

    /// ∂w/∂(z, u), one row for each argument, out of the model's Jacobian.
    fn argument_jacobian(&self, own: &[f64]) -> Vec<f64> {
        let Joined { state, command, .. } = self.joined;
        let width = state + command;
        let mut rows = vec![0.0; (2 * self.seen + command) * width];
        rows[..self.seen * width].copy_from_slice(&own[..self.seen * width]);
        let others = (0..self.seen).chain(state..width);
        for (row, variable) in rows[self.seen * width..].chunks_exact_mut(width).zip(others) {
            row[variable] = 1.0;
        }
        rows
    }
}

impl<D: Dynamics> Dynamics for WithOutputs<'_, D> {
    fn state_len(&self) -> usize {
        self.joined.state_len()
    }

    fn command_len(&self) -> usize {
        self.joined.command
    }

    fn fresh_len(&self) -> usize {
        self.joined.block()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let (next, outputs) = fresh.split_at_mut(self.joined.fresh);
        let own = self.joined.gather(state);
        self.dynamics.step(knot, &own, command, next);
        let w = self.arguments(next, &own, command);
        for (y, output) in outputs.iter_mut().zip(self.outputs) {
            *y = output.value(&w);
        }
    }

    fn linearize(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let own_width = self.joined.state + self.joined.command;
        let width = self.state_len() + self.joined.command;
        let (next, outputs) = fresh.split_at_mut(self.joined.fresh);
        let own = self.joined.gather(state);
        let mut own_jacobian = vec![0.0; self.joined.fresh * own_width];
        self.dynamics
            .linearize(knot, &own, command, next, &mut own_jacobian);
        jacobian.fill(0.0);
        self.joined.spread_jacobian(&own_jacobian, width, jacobian);

        let w = self.arguments(next, &own, command);
        let by_variable = self.argument_jacobian(&own_jacobian);
        let (mut gradient, mut hessian) = (vec![0.0; w.len()], vec![0.0; w.len() * w.len()]);
        let rows = jacobian[self.joined.fresh * width..].chunks_exact_mut(width);
        for ((y, row), output) in outputs.iter_mut().zip(rows).zip(self.outputs) {
            *y = output.derivatives(&w, &mut gradient, &mut hessian);
            for (slope, argument) in gradient.iter().zip(by_variable.chunks_exact(own_width)) {
                if *slope != 0.0 {
                    for (i, entry) in argument.iter().enumerate() {
                        row[self.joined.variable(i)] += slope * entry;
                    }
                }
            }
        }
    }

    /// `∇²(λ·g(w)) = Dᵀ (λ·∇²g) D + Σ_i (λ·∂g/∂x⁺_i) ∇²f_i`, with D = ∂w/∂(z, u).
    fn add_curvature(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        let own_width = self.joined.state + self.joined.command;
        let own_stride = kernel::padded(own_width);
        let mut own_hessian = vec![0.0; own_width * own_stride];
        let own = self.joined.gather(state);
        let mut own_adjoint = adjoint[..self.joined.fresh].to_vec();
        let prices = &adjoint[self.joined.fresh..];
        if prices.iter().any(|&price| price != 0.0) {
            let mut next = vec![0.0; self.joined.fresh];
            let mut own_jacobian = vec![0.0; self.joined.fresh * own_width];
            self.dynamics
                .linearize(knot, &own, command, &mut next, &mut own_jacobian);
            let w = self.arguments(&next, &own, command);
            let len = w.len();
            let mut sum = vec![0.0; len * len];
            let (mut gradient, mut second) = (vec![0.0; len], vec![0.0; len * len]);
            for (&price, output) in prices
                .iter()
                .zip(self.outputs)
                .filter(|(price, _)| **price != 0.0)
            {
                output.derivatives(&w, &mut gradient, &mut second);
                for (total, slope) in own_adjoint.iter_mut().zip(&gradient[..self.seen]) {
                    *total += price * slope;
                }
                for (total, entry) in sum.iter_mut().zip(&second) {
                    *total += price * entry;
                }
            }
            let rows = self.argument_jacobian(&own_jacobian);
            let row = |argument: usize| &rows[argument * own_width..][..own_width];
            for (a, line) in sum.chunks_exact(len).enumerate() {
                // Σ_b (λ·∇²g)_ab D_b
                let mut product = vec![0.0; own_width];
                for (b, &entry) in line.iter().enumerate().filter(|(_, entry)| **entry != 0.0) {
                    for (total, factor) in product.iter_mut().zip(row(b)) {
                        *total += entry * factor;
                    }
                }
                for (i, &factor) in row(a).iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
                    for (total, entry) in own_hessian[i * own_stride..].iter_mut().zip(&product) {
                        *total += factor * entry;
                    }
                }
            }
        }
        self.dynamics
            .add_curvature(knot, &own, command, &own_adjoint, own_stride, &mut own_hessian);
        self.joined.add_hessian(&own_hessian, own_stride, stride, hessian);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::derivatives::{Toy, assert_derivatives, toy_problem};
    use crate::trajopt::{Options, Solution, Solver, Status};

    /// `y = (x⁺)² x + (x⁺ − x) u`.
    #[derive(Debug)]
    struct Product;

    impl Output for Product {
        fn value(&self, w: &[f64]) -> f64 {
            w[0] * w[0] * w[1] + (w[0] - w[1]) * w[2]
        }

        fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
            gradient.copy_from_slice(&[2.0 * w[0] * w[1] + w[2], w[0] * w[0] - w[2], w[0] - w[1]]);
            hessian.copy_from_slice(&[
                2.0 * w[1],
                2.0 * w[0],
                1.0, //
                2.0 * w[0],
                0.0,
                -1.0, //
                1.0,
                -1.0,
                0.0,
            ]);
            self.value(w)
        }
    }

    /// `y = x⁺ − x`.
    #[derive(Debug)]
    struct Change;

    impl Output for Change {
        fn value(&self, w: &[f64]) -> f64 {
            w[0] - w[1]
        }

        fn derivatives(&self, w: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
            gradient.copy_from_slice(&[1.0, -1.0, 0.0]);
            hessian.fill(0.0);
            self.value(w)
        }
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let outputs: [Arc<dyn Output>; 2] = [Arc::new(Product), Arc::new(Change)];
        let model = WithOutputs::new(Toy, &outputs, 1);
        let point = [0.3, -0.2, 0.1, 0.4, 0.5, -0.6, 0.7];
        assert_derivatives(&model, &point, &[1.5, -2.0, 0.5]);
    }

    fn solve(largest: f64, price: f64) -> (Solution, f64) {
        let outputs: [Arc<dyn Output>; 1] = [Arc::new(Change)];
        let model = WithOutputs::new(Toy, &outputs, 1);
        let bound = StateBound {
            first_knot: 1,
            last_knot: toy_problem().knots - 1,
            index: 0,
            lower: f64::NEG_INFINITY,
            upper: largest,
            price,
        };
        let problem = model.pose(&toy_problem(), &[0.0], &[bound]);
        let mut solver = Solver::new(&problem, &model, Options::default()).unwrap();
        let solution = solver.solve().clone();
        assert_eq!(solution.status, Status::Converged);
        let x: Vec<f64> = model
            .own_states(&solution.states)
            .chunks_exact(2)
            .map(|z| z[0])
            .collect();
        let found = x
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .fold(f64::NEG_INFINITY, f64::max);
        (solution, found)
    }

    #[test]
    fn a_bound_on_an_output_holds_or_costs_its_price() {
        let (_, free) = solve(f64::INFINITY, f64::INFINITY);
        let (_, hard) = solve(0.6 * free, f64::INFINITY);
        assert!((hard - 0.6 * free).abs() < 1e-7, "{hard} of {free}");
        let (_, soft) = solve(0.6 * free, 1e-3);
        assert!(
            soft > hard + 1e-3 && soft <= free,
            "{soft} between {hard} and {free}"
        );
    }
}
