//! Which rows of a flight follow one another without a break.

use std::ops::Range;

use super::error::{FlightError, Problem};
use super::{Flight, Sample};
use crate::DT;

/// Largest deviation of a time step from [`DT`] that is taken for jitter of the time stamps, s.
pub const CLOCK_TOLERANCE_S: f64 = 0.1 * DT;

/// Largest share by which a flight's median time step may differ from [`DT`].
const RATE_TOLERANCE: f64 = 0.02;

impl Flight {
    /// The maximal ranges of rows that all have a state and follow one another at [`DT`], in time order.
    /// Nothing that looks back in time may reach across the border of two segments.
    pub fn segments(&self) -> Vec<Range<usize>> {
        let mut segments: Vec<Range<usize>> = Vec::new();
        for (k, sample) in self.samples.iter().enumerate() {
            if sample.state().is_none() {
                continue;
            }
            match segments.last_mut() {
                Some(segment) if segment.end == k && !self.clock_gap_before(k) => segment.end = k + 1,
                _ => segments.push(k..k + 1),
            }
        }
        segments
    }

    /// The rows `k` from which a model with `lags` lagged states can be taught or judged by one step:
    /// rows `k − lags + 1 ..= k` and the next row `k + 1` all have states and follow one another at [`DT`].
    pub fn valid_transitions(&self, lags: usize) -> Vec<usize> {
        let rows_after_lags =
            |segment: Range<usize>| (segment.start + lags.max(1)..segment.end).map(|next| next - 1);
        self.segments().into_iter().flat_map(rows_after_lags).collect()
    }

    /// Whether the time between row `k − 1` and row `k` is not [`DT`].
    pub(super) fn clock_gap_before(&self, k: usize) -> bool {
        k > 0 && (self.samples[k].t_s - self.samples[k - 1].t_s - DT).abs() > CLOCK_TOLERANCE_S
    }
}

/// Refuses a flight of which the median rate is not 20 Hz.
pub(super) fn check_rate(file: &str, samples: &[Sample]) -> Result<(), FlightError> {
    match median_step(samples.iter().map(|sample| sample.t_s)) {
        Some(step_s) if (step_s / DT - 1.0).abs() > RATE_TOLERANCE => {
            Err(FlightError::in_file(file, Problem::NotTwentyHertz { step_s }).field("t_s"))
        }
        _ => Ok(()),
    }
}

/// The median difference of successive times, `None` if there are fewer than two.
pub(super) fn median_step(times: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let mut steps: Vec<f64> = times
        .clone()
        .skip(1)
        .zip(times)
        .map(|(next, t)| next - t)
        .collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}
