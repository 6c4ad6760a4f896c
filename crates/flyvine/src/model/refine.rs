//! Multi-step refinement: a least-squares model improved on what matters to a plan, its rollouts.
//!
//! One-step least squares weighs every sample alike and is biased by noise in the lagged states; over fifty
//! steps small biases add up. Here the linear coefficients (and the offsets of the quadratic rows) minimize the
//! simulation error over 2.5-s windows,
//!
//! ```text
//! Σ_windows Σ_steps Σ_signals weight · ρ(x̂ − x)² + strength · steps · Σ_j (rms_j (θ_j − θ_LS,j))²
//! ```
//!
//! by Levenberg–Marquardt. The sensitivities are analytic: with `S_k = ∂z_k/∂θ`, the fresh rows of `S_{k+1}`
//! are `J_z S_k + ∂f/∂θ`, the others are shifted. ρ is Huber's on the end-effector error, so that no window
//! that the model cannot explain rules the fit.

use super::lag::{LagModel, STATE_LEN};
use super::rollout::advance;
use super::track::Track;
use crate::trajopt::Dynamics;
use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};
use rayon::prelude::*;
use std::ops::Range;

/// Steps of a window.
const HORIZON: usize = 50;
/// Rows from one window's start to the next.
const STRIDE: usize = 50;
/// Steps from one compared row to the next: neighbours say nearly the same.
const COMPARE_EVERY: usize = 2;
/// Weights of the signals: what is planned for is the end effector; attitude is left free.
const WEIGHTS: [f64; STATE_LEN] = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
/// End-effector error at which ρ turns from squares to absolute values, m.
const HUBER_M: f64 = 0.15;
/// A window farther off than this is not followed any longer, m.
const LOST_M: f64 = 10.0;
/// Strength of the pull towards least squares.
const STRENGTH: f64 = 1e-5;
/// Most Levenberg–Marquardt iterations.
const MAX_ITERATIONS: usize = 6;
/// Relative improvement at which it stops.
const ENOUGH: f64 = 1e-2;
/// Windows are summed in this many groups, in fixed order, so that the sum does not depend on the threads.
const GROUPS: usize = 16;

/// Rows of one flight to roll out on.
pub(crate) type Stretch<'a> = (&'a Track<'a>, Range<usize>);

/// Refines `model` on windows inside `stretches`; `None` if no window fits in them.
pub(crate) fn refine(model: &LagModel, stretches: &[Stretch]) -> Option<LagModel> {
    let windows = windows(model.lags(), stretches);
    if windows.is_empty() {
        return None;
    }
    let start = Coefficients::of(model);
    let pull = start.pull(&windows, model.lags());
    let penalty = |coefficients: &Coefficients| -> f64 {
        let moved = coefficients.values.iter().zip(&start.values).zip(&pull);
        moved.map(|((now, then), pull)| pull * (now - then).powi(2)).sum()
    };
    let mut best = start.clone();
    let mut system = NormalEquations::of(model, &windows, start.values.len());
    let mut cost = system.cost;
    let mut damping = 1e-3;
    for _ in 0..MAX_ITERATIONS {
        let mut accepted = None;
        while accepted.is_none() && damping < 1e6 {
            let trial = best.stepped(&system, &start, &pull, damping)?;
            let trial_cost = simulation_cost(&trial.model(model)?, &windows) + penalty(&trial);
            if trial_cost < cost {
                accepted = Some((trial, trial_cost));
                damping *= 0.1;
            } else {
                damping *= 10.0;
            }
        }
        let Some((trial, trial_cost)) = accepted else {
            break;
        };
        let settled = trial_cost > (1.0 - ENOUGH) * cost;
        (best, cost) = (trial, trial_cost);
        if settled {
            break;
        }
        system = NormalEquations::of(&best.model(model)?, &windows, best.values.len());
    }
    best.model(model)
}

/// A window: its flight and the row that it starts from.
struct Window<'a> {
    track: &'a Track<'a>,
    start: usize,
}

fn windows<'a>(lags: usize, stretches: &[Stretch<'a>]) -> Vec<Window<'a>> {
    let inside = |(track, rows): &Stretch<'a>| {
        let (track, rows) = (*track, rows.clone());
        let starts = (rows.start + lags - 1..rows.end.saturating_sub(HORIZON)).step_by(STRIDE);
        starts
            .filter(move |&start| track.unbroken(start, lags, HORIZON))
            .map(move |start| Window { track, start })
    };
    stretches.iter().flat_map(inside).collect()
}

/// What is refined: nine rows of linear coefficients, then the offsets of the quadratic rows.
#[derive(Clone)]
struct Coefficients {
    values: Vec<f64>,
    quadratic_rows: Vec<usize>,
}

impl Coefficients {
    fn of(model: &LagModel) -> Self {
        let quadratic_rows: Vec<usize> = model.quadratic().iter().map(|terms| terms.row).collect();
        let offsets: Vec<f64> = quadratic_rows.iter().map(|&row| model.offset()[row]).collect();
        Self {
            values: [model.linear(), offsets].concat(),
            quadratic_rows,
        }
    }

    /// `model` with these coefficients; `None` if one is not finite.
    fn model(&self, model: &LagModel) -> Option<LagModel> {
        let (linear, offsets) = self.values.split_at(STATE_LEN * model.regressor_len());
        let mut offset = model.offset().to_vec();
        for (&row, &value) in self.quadratic_rows.iter().zip(offsets) {
            offset[row] = value;
        }
        LagModel::new(
            model.lags(),
            model.inputs(),
            offset,
            linear.to_vec(),
            &model.quadratic(),
        )
        .ok()
    }

    /// Pull towards least squares per coefficient: strength · steps · mean square of its regressor.
    fn pull(&self, windows: &[Window], lags: usize) -> Vec<f64> {
        let n = lags * STATE_LEN;
        let p = n + windows[0].track.command(0).len();
        let mut state = vec![0.0; n];
        let mut squares = vec![0.0; p];
        for window in windows {
            window.track.lagged_state(window.start, &mut state);
            let w = state.iter().chain(window.track.command(window.start));
            squares
                .iter_mut()
                .zip(w)
                .for_each(|(sum, value)| *sum += value * value);
        }
        let compared = (HORIZON / COMPARE_EVERY) as f64;
        let linear = squares
            .repeat(STATE_LEN)
            .into_iter()
            .map(|square| STRENGTH * compared * square);
        let offsets = self
            .quadratic_rows
            .iter()
            .map(|_| STRENGTH * compared * windows.len() as f64);
        linear.chain(offsets).collect()
    }

    /// The Levenberg–Marquardt step `(N + P + damping · diag N) δ = −(g + P (θ − θ_LS))`.
    fn stepped(&self, system: &NormalEquations, start: &Self, pull: &[f64], damping: f64) -> Option<Self> {
        let mut matrix = system.matrix.clone();
        for (j, pull) in pull.iter().enumerate() {
            matrix[(j, j)] += pull + damping * system.matrix[(j, j)];
        }
        let right = Mat::from_fn(pull.len(), 1, |j, _| {
            -(system.gradient[j] + pull[j] * (self.values[j] - start.values[j]))
        });
        let step = matrix.llt(Side::Lower).ok()?.solve(right);
        let values = self
            .values
            .iter()
            .zip(step.col_as_slice(0))
            .map(|(value, step)| value + step)
            .collect();
        Some(Self {
            values,
            quadratic_rows: self.quadratic_rows.clone(),
        })
    }
}

/// Gauss–Newton's approximation of the simulation error about a model.
struct NormalEquations {
    matrix: Mat<f64>,
    gradient: Vec<f64>,
    cost: f64,
}

impl NormalEquations {
    fn zero(len: usize) -> Self {
        Self {
            matrix: Mat::zeros(len, len),
            gradient: vec![0.0; len],
            cost: 0.0,
        }
    }

    fn of(model: &LagModel, windows: &[Window], len: usize) -> Self {
        let groups: Vec<Self> = windows
            .par_chunks(windows.len().div_ceil(GROUPS))
            .map(|group| {
                let mut sum = Self::zero(len);
                let mut sensitivities = Sensitivities::new(model, len);
                for window in group {
                    sensitivities.add(model, window, &mut sum);
                }
                sum
            })
            .collect();
        let mut total = Self::zero(len);
        for group in groups {
            total.matrix += group.matrix;
            total
                .gradient
                .iter_mut()
                .zip(&group.gradient)
                .for_each(|(sum, value)| *sum += value);
            total.cost += group.cost;
        }
        total
    }
}

/// Workspace of one rollout with sensitivities.
struct Sensitivities {
    state: Vec<f64>,
    /// `∂f/∂w` (9 × p).
    jacobian: Vec<f64>,
    /// `∂z/∂θ` (n × parameters), row-major.
    s: Vec<f64>,
    /// Its next fresh rows (9 × parameters).
    fresh_s: Vec<f64>,
    /// Weighted sensitivities of all compared residuals of the window, row-major.
    rows: Vec<f64>,
    residuals: Vec<f64>,
    quadratic_rows: Vec<usize>,
    len: usize,
}

impl Sensitivities {
    fn new(model: &LagModel, len: usize) -> Self {
        let n = model.state_len();
        Self {
            state: vec![0.0; n],
            jacobian: vec![0.0; STATE_LEN * model.regressor_len()],
            s: vec![0.0; n * len],
            fresh_s: vec![0.0; STATE_LEN * len],
            rows: Vec::new(),
            residuals: Vec::new(),
            quadratic_rows: model.quadratic().iter().map(|terms| terms.row).collect(),
            len,
        }
    }

    /// Adds `window` to the normal equations.
    fn add(&mut self, model: &LagModel, window: &Window, sum: &mut NormalEquations) {
        let (n, p, len) = (model.state_len(), model.regressor_len(), self.len);
        self.s.fill(0.0);
        self.rows.clear();
        self.residuals.clear();
        let Window { track, start } = *window;
        track.lagged_state(start, &mut self.state);
        let mut fresh = [0.0; STATE_LEN];
        for step in 1..=HORIZON {
            let command = track.command(start + step - 1);
            model.linearize(0, &self.state, command, &mut fresh, &mut self.jacobian);
            let by_state = MatRef::from_row_major_slice(&self.jacobian, STATE_LEN, p).subcols(0, n);
            let s = MatRef::from_row_major_slice(&self.s, n, len);
            let next = MatMut::from_row_major_slice_mut(&mut self.fresh_s, STATE_LEN, len);
            matmul(next, Accum::Replace, by_state, s, 1.0, Par::Seq);
            for row in 0..STATE_LEN {
                let own = &mut self.fresh_s[row * len + row * p..row * len + (row + 1) * p];
                let w = self.state.iter().chain(command);
                own.iter_mut().zip(w).for_each(|(entry, value)| *entry += value);
            }
            for (index, &row) in self.quadratic_rows.iter().enumerate() {
                self.fresh_s[row * len + STATE_LEN * p + index] += 1.0;
            }
            advance(&mut self.state, &fresh);
            advance(&mut self.s, &self.fresh_s);
            let comparison = Comparison::new(&fresh, track.state(start + step));
            if comparison.lost() {
                sum.cost += (HORIZON - step + 1) as f64 * Comparison::LOST_COST;
                break;
            }
            if step % COMPARE_EVERY != 0 {
                continue;
            }
            sum.cost += comparison.cost();
            for (signal, &weight) in WEIGHTS.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
                let factor = (weight * comparison.huber).sqrt();
                self.residuals.push(factor * comparison.residual[signal]);
                self.rows.extend(
                    self.fresh_s[signal * len..(signal + 1) * len]
                        .iter()
                        .map(|s| factor * s),
                );
            }
        }
        let rows = MatRef::from_row_major_slice(&self.rows, self.residuals.len(), len);
        matmul(
            sum.matrix.as_mut(),
            Accum::Add,
            rows.transpose(),
            rows,
            1.0,
            Par::Seq,
        );
        let residuals = MatRef::from_column_major_slice(&self.residuals, self.residuals.len(), 1);
        let gradient = MatMut::from_column_major_slice_mut(&mut sum.gradient, len, 1);
        matmul(gradient, Accum::Add, rows.transpose(), residuals, 1.0, Par::Seq);
    }
}

/// A predicted state beside the measured one.
struct Comparison {
    residual: [f64; STATE_LEN],
    tip_m: f64,
    /// Huber's weight of this step.
    huber: f64,
}

impl Comparison {
    /// Cost of a step that is not followed.
    const LOST_COST: f64 = HUBER_M * LOST_M;

    fn new(predicted: &[f64; STATE_LEN], measured: &[f64; STATE_LEN]) -> Self {
        let residual: [f64; STATE_LEN] = std::array::from_fn(|i| predicted[i] - measured[i]);
        let tip_m = residual[6].hypot(residual[7]).hypot(residual[8]);
        Self {
            residual,
            tip_m,
            huber: HUBER_M / tip_m.max(HUBER_M),
        }
    }

    fn lost(&self) -> bool {
        self.tip_m.is_nan() || self.tip_m >= LOST_M
    }

    fn cost(&self) -> f64 {
        let squares = self
            .residual
            .iter()
            .zip(WEIGHTS)
            .map(|(residual, weight)| weight * residual * residual);
        self.huber * squares.sum::<f64>()
    }
}

/// The simulation error alone.
fn simulation_cost(model: &LagModel, windows: &[Window]) -> f64 {
    let cost = |window: &Window| {
        let Window { track, start } = *window;
        let mut state = vec![0.0; model.state_len()];
        track.lagged_state(start, &mut state);
        let mut fresh = [0.0; STATE_LEN];
        let mut sum = 0.0;
        for step in 1..=HORIZON {
            model.step(0, &state, track.command(start + step - 1), &mut fresh);
            advance(&mut state, &fresh);
            let comparison = Comparison::new(&fresh, track.state(start + step));
            if comparison.lost() {
                return sum + (HORIZON - step + 1) as f64 * Comparison::LOST_COST;
            }
            if step % COMPARE_EVERY == 0 {
                sum += comparison.cost();
            }
        }
        sum
    };
    // Collected before it is summed: the order of the sum is the windows' own.
    windows
        .par_iter()
        .map(cost)
        .collect::<Vec<f64>>()
        .into_iter()
        .sum()
}

#[cfg(test)]
mod tests {
    use super::super::fit::tests::{ES, flight, system};
    use super::super::lag::CommandInputs;
    use super::*;

    /// `model` with every coefficient moved a little, so that rollouts err by centimetres.
    fn disturbed(model: &LagModel) -> LagModel {
        let mut coefficients = Coefficients::of(model);
        for (index, value) in coefficients.values.iter_mut().enumerate() {
            *value += 1e-3 * (0.7 * index as f64).sin();
        }
        coefficients.model(model).unwrap()
    }

    #[test]
    fn the_gradient_is_that_of_the_simulation_error() {
        let recording = flight("a", ES, 120, 1, 0.0);
        let track = Track::new(&recording, CommandInputs::Position).unwrap();
        let model = disturbed(&system());
        let windows = windows(model.lags(), &[(&track, 0..track.rows())]);
        assert_eq!(windows.len(), 2);
        let at = Coefficients::of(&model);
        let system = NormalEquations::of(&model, &windows, at.values.len());
        assert_eq!(system.cost, simulation_cost(&model, &windows));
        // Where no error is beyond Huber's corner, the cost is a sum of squares: ∂cost/∂θ = 2 Sᵀ W r.
        let cost_at = |index: usize, step: f64| {
            let mut moved = at.clone();
            moved.values[index] += step;
            simulation_cost(&moved.model(&model).unwrap(), &windows)
        };
        let largest = system.gradient.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        for index in (0..at.values.len()).step_by(7).chain([at.values.len() - 1]) {
            let step = 1e-6;
            let difference = (cost_at(index, step) - cost_at(index, -step)) / (2.0 * step);
            let analytic = 2.0 * system.gradient[index];
            assert!(
                (difference - analytic).abs() < 1e-6 * largest.max(analytic.abs()),
                "coefficient {index}: {analytic} against {difference}"
            );
        }
    }

    #[test]
    fn a_disturbed_model_finds_its_way_back() {
        let recordings = [flight("a", ES, 400, 2, 0.0), flight("b", ES, 200, 3, 0.0)];
        let tracks = recordings
            .each_ref()
            .map(|recording| Track::new(recording, CommandInputs::Position).unwrap());
        let kept = [(&tracks[0], 0..tracks[0].rows())];
        let model = disturbed(&system());
        let refined = refine(&model, &kept).unwrap();
        // On the flight that it has not seen.
        let unseen = windows(3, &[(&tracks[1], 0..tracks[1].rows())]);
        let (before, after) = (
            simulation_cost(&model, &unseen),
            simulation_cost(&refined, &unseen),
        );
        assert!(after < 0.05 * before, "{before} → {after}");
        assert!(refine(&model, &[(&tracks[0], 0..40)]).is_none(), "no window fits");
    }
}
