//! The simulation error of a lag model over windows of recordings, and its derivatives by the parameters.

use super::super::lag::{LagModel, STATE_LEN};
use super::super::rollout::advance;
use super::super::track::Track;
use super::parameters::Parameters;
use crate::trajopt::Dynamics;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::ops::Range;

/// Steps of a window.
pub(super) const HORIZON: usize = 50;
/// Rows from one window's start to the next.
const STRIDE: usize = 50;
/// Steps from one compared row to the next: neighbours say nearly the same.
pub(super) const COMPARE_EVERY: usize = 2;
/// Weights of the signals: what is planned for is the end effector; attitude is left free.
const WEIGHTS: [f64; STATE_LEN] = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
/// End-effector error at which ρ turns from squares to absolute values, m.
const HUBER_M: f64 = 0.15;
/// A window farther off than this is not followed any longer, m.
const LOST_M: f64 = 10.0;
/// Windows are summed in this many groups, in fixed order, so that the sum does not depend on the threads.
const GROUPS: usize = 16;

/// Rows of one flight to roll out on.
pub(crate) type Stretch<'a> = (&'a Track<'a>, Range<usize>);

/// A window: its flight and the row that it starts from.
pub(super) struct Window<'a> {
    track: &'a Track<'a>,
    lags: usize,
    start: usize,
}

impl Window<'_> {
    /// `w = (z, u)` of its first row.
    pub fn regressor(&self) -> Vec<f64> {
        let mut w = vec![0.0; self.lags * STATE_LEN + self.track.command(self.start).len()];
        self.track.regressors(self.start, self.lags, &mut w);
        w
    }
}

/// The windows inside `stretches`.
pub(super) fn windows<'a>(lags: usize, stretches: &[Stretch<'a>]) -> Vec<Window<'a>> {
    let inside = |(track, rows): &Stretch<'a>| {
        let (track, rows) = (*track, rows.clone());
        let starts = (rows.start + lags - 1..rows.end.saturating_sub(HORIZON)).step_by(STRIDE);
        starts
            .filter(move |&start| track.unbroken(start, lags, HORIZON))
            .map(move |start| Window { track, lags, start })
    };
    stretches.iter().flat_map(inside).collect()
}

/// Gauss–Newton's approximation of the simulation error about a model.
pub(super) struct NormalEquations {
    pub matrix: Mat<f64>,
    pub gradient: Vec<f64>,
    pub cost: f64,
}

impl NormalEquations {
    fn zero(len: usize) -> Self {
        Self {
            matrix: Mat::zeros(len, len),
            gradient: vec![0.0; len],
            cost: 0.0,
        }
    }

    /// Those of all windows.
    pub fn of(model: &LagModel, parameters: &Parameters, windows: &[Window]) -> Self {
        let len = parameters.len();
        let groups: Vec<Self> = windows
            .par_chunks(windows.len().div_ceil(GROUPS))
            .map(|group| {
                let mut sum = Self::zero(len);
                let mut sensitivities = Sensitivities::new(model, parameters);
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
struct Sensitivities<'a> {
    parameters: &'a Parameters,
    /// w, of which z comes first.
    w: Vec<f64>,
    regressors: Vec<f64>,
    /// `∂f/∂w` (9 × p).
    jacobian: Vec<f64>,
    /// `∂z/∂θ` (n × parameters), row-major.
    s: Vec<f64>,
    /// Its next fresh rows (9 × parameters).
    fresh_s: Vec<f64>,
    /// Weighted sensitivities of all compared residuals of the window, row-major.
    rows: Vec<f64>,
    residuals: Vec<f64>,
}

impl<'a> Sensitivities<'a> {
    fn new(model: &LagModel, parameters: &'a Parameters) -> Self {
        let (n, len) = (model.state_len(), parameters.len());
        Self {
            parameters,
            w: vec![0.0; model.regressor_len()],
            regressors: vec![0.0; parameters.regressors()],
            jacobian: vec![0.0; STATE_LEN * model.regressor_len()],
            s: vec![0.0; n * len],
            fresh_s: vec![0.0; STATE_LEN * len],
            rows: Vec::new(),
            residuals: Vec::new(),
        }
    }

    /// Adds `window` to the normal equations.
    fn add(&mut self, model: &LagModel, window: &Window, sum: &mut NormalEquations) {
        let (n, p, len) = (model.state_len(), model.regressor_len(), self.parameters.len());
        self.s.fill(0.0);
        self.rows.clear();
        self.residuals.clear();
        let Window { track, start, .. } = *window;
        track.lagged_state(start, &mut self.w[..n]);
        let mut fresh = [0.0; STATE_LEN];
        for step in 1..=HORIZON {
            self.w[n..].copy_from_slice(track.command(start + step - 1));
            let (state, command) = self.w.split_at(n);
            model.linearize(0, state, command, &mut fresh, &mut self.jacobian);
            let by_state = MatRef::from_row_major_slice(&self.jacobian, STATE_LEN, p).subcols(0, n);
            let s = MatRef::from_row_major_slice(&self.s, n, len);
            let next = MatMut::from_row_major_slice_mut(&mut self.fresh_s, STATE_LEN, len);
            matmul(next, Accum::Replace, by_state, s, 1.0, Par::Seq);
            self.parameters.write_regressors(&self.w, &mut self.regressors);
            self.parameters.add_direct(&self.regressors, &mut self.fresh_s);
            advance(&mut self.w[..n], &fresh);
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
pub(super) fn simulation_cost(model: &LagModel, windows: &[Window]) -> f64 {
    let cost = |window: &Window| {
        let Window { track, start, .. } = *window;
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
