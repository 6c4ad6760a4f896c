//! Rollouts of recorded commands, and their end-effector error against the recording.
//!
//! A window starts at every tenth row with a valid lagged state; the model then runs on its own predictions.
//! The error of a window is the mean 3-D end-effector distance over its steps; a window has *diverged* when a
//! prediction is not finite or more than 1 m off anywhere in it. Windows that contain a rejected row are skipped.

use super::band::PredictionBand;
use super::lag::STATE_LEN;
use super::support::arm_angle;
use super::track::Track;
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Rows from one window's start to the next.
const WINDOW_STRIDE: usize = 10;
/// A prediction farther off than this has diverged, m.
const DIVERGED_M: f64 = 1.0;

/// The end-effector error of one window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WindowError {
    /// Row that it starts from.
    pub start: usize,
    /// Mean 3-D distance, m; infinite if a prediction was not finite.
    pub mean_m: f64,
    /// Distance at its last step, m; likewise.
    pub last_m: f64,
    /// How far the predicted arm leans from below the quadrotor at most, rad: what is known of the window before it is
    /// flown.
    pub arm_angle: f64,
    /// Of how many models its prediction is made at most ([`super::Bank::models_at`]).
    pub models: f64,
    pub diverged: bool,
}

/// Rollout error over one horizon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RolloutError {
    /// Length of the windows, s.
    pub horizon_s: f64,
    /// Number of windows.
    pub windows: usize,
    /// Median of the windows' errors, m. Diverged windows are counted with the error they have, the ones that
    /// left the finite numbers as worse than any other; `None` (null) if the median is one of those, or if
    /// there is no window.
    pub median_m: Option<f64>,
    /// 95th percentile, m; likewise.
    pub p95_m: Option<f64>,
    /// The worst window's error, m; likewise.
    pub worst_m: Option<f64>,
    /// Time at which the worst window starts, s.
    pub worst_start_s: Option<f64>,
    /// Share of the windows that diverged, 0 to 1.
    pub diverged_share: f64,
    /// Share of the windows whose end lies within the bank's band of confidence; `None` without a band.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within_band: Option<f64>,
}

/// Rolls `dynamics` out from every window start in `rows` of `track` (with all lags and steps inside `rows`) and
/// returns, per horizon in `horizons` (steps, ascending), the windows that fit.
pub(crate) fn window_errors(
    dynamics: &impl Dynamics,
    track: &Track,
    rows: Range<usize>,
    horizons: &[usize],
) -> Vec<Vec<WindowError>> {
    let lags = dynamics.state_len() / STATE_LEN;
    let lagged_state = |row: usize, state: &mut [f64]| track.lagged_state(row, state);
    window_errors_from(dynamics, track, rows, horizons, lags, &lagged_state)
}

/// [`window_errors`] with windows that start from what `write_state` writes for a row, for models whose state is
/// not made of lags; windows still begin where `lags` rows in a row are valid.
pub(crate) fn window_errors_from(
    dynamics: &impl Dynamics,
    track: &Track,
    rows: Range<usize>,
    horizons: &[usize],
    lags: usize,
    write_state: &dyn Fn(usize, &mut [f64]),
) -> Vec<Vec<WindowError>> {
    let mut windows = vec![Vec::new(); horizons.len()];
    let mut state = vec![0.0; dynamics.state_len()];
    let first = rows.start + lags - 1;
    for start in (first..rows.end).step_by(WINDOW_STRIDE) {
        let fits = |steps: usize| start + steps < rows.end && track.unbroken(start, lags, steps);
        let fitting = horizons.iter().take_while(|&&steps| fits(steps)).count();
        if fitting == 0 {
            continue;
        }
        write_state(start, &mut state);
        let errors = roll_window(dynamics, track, start, &mut state, &horizons[..fitting]);
        for (list, error) in windows.iter_mut().zip(errors) {
            list.push(error);
        }
    }
    windows
}

/// One window, its error at each of `horizons`.
fn roll_window(
    dynamics: &impl Dynamics,
    track: &Track,
    start: usize,
    state: &mut [f64],
    horizons: &[usize],
) -> Vec<WindowError> {
    let mut fresh = vec![0.0; dynamics.fresh_len()];
    let mut errors = Vec::with_capacity(horizons.len());
    let (mut sum, mut worst, mut last) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut widest = arm_angle(state);
    for step in 1..=horizons[horizons.len() - 1] {
        if sum.is_finite() {
            let row = start + step - 1;
            dynamics.step(row, state, track.command(row), &mut fresh);
            advance(state, &fresh);
            let finite = fresh.iter().all(|value| value.is_finite());
            let distance = if finite {
                tip_distance(&fresh, track.state(row + 1))
            } else {
                f64::INFINITY
            };
            sum += distance;
            worst = worst.max(distance);
            last = distance;
            widest = widest.max(arm_angle(&fresh));
        }
        if horizons.contains(&step) {
            let diverged = worst > DIVERGED_M;
            errors.push(WindowError {
                start,
                mean_m: sum / step as f64,
                last_m: last,
                arm_angle: widest,
                models: 1.0,
                diverged,
            });
        }
    }
    errors
}

/// `z ← (fresh, z without its oldest x)`.
pub(crate) fn advance(state: &mut [f64], fresh: &[f64]) {
    let kept = state.len() - fresh.len();
    state.copy_within(..kept, fresh.len());
    state[..fresh.len()].copy_from_slice(fresh);
}

/// 3-D distance between the end effectors of two states, m.
fn tip_distance(a: &[f64], b: &[f64]) -> f64 {
    (6..9).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// Median, percentile and worst of `windows` of `horizon` steps, and where the worst is.
pub(crate) fn summarize<'a>(
    horizon: usize,
    windows: &[(&'a Track<'a>, &WindowError)],
    band: Option<&PredictionBand>,
) -> (RolloutError, Option<&'a Track<'a>>) {
    let mut sorted: Vec<f64> = windows.iter().map(|(_, window)| window.mean_m).collect();
    sorted.sort_by(f64::total_cmp);
    let finite = |value: f64| value.is_finite().then_some(value);
    let worst = windows.iter().max_by(|a, b| a.1.mean_m.total_cmp(&b.1.mean_m));
    let share = |of: &dyn Fn(&WindowError) -> bool| {
        let count = windows.iter().filter(|(_, window)| of(window)).count();
        count as f64 / windows.len().max(1) as f64
    };
    let horizon_s = horizon as f64 * crate::DT;
    let error = RolloutError {
        horizon_s,
        windows: windows.len(),
        median_m: quantile(&sorted, 0.5).and_then(finite),
        p95_m: quantile(&sorted, 0.95).and_then(finite),
        worst_m: worst.and_then(|(_, window)| finite(window.mean_m)),
        worst_start_s: worst.map(|(track, window)| track.flight.samples[window.start].t_s),
        diverged_share: share(&|window| window.diverged),
        within_band: band.filter(|_| !windows.is_empty()).map(|band| {
            share(&|window| window.last_m <= band.radius_m(horizon_s, window.arm_angle, window.models))
        }),
    };
    (error, worst.map(|(track, _)| *track))
}

/// Quantile of ascending values by linear interpolation between order statistics (Hyndman & Fan's type 7).
pub(crate) fn quantile(sorted: &[f64], fraction: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let position = fraction * last as f64;
    let below = position.floor() as usize;
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    let share = position - below as f64;
    // ∞ − ∞ and 0 · ∞ are not numbers.
    Some(if share == 0.0 || low == high {
        low
    } else {
        low + share * (high - low)
    })
}

/// The windows of [`window_errors`] for the prediction that nothing moves.
pub(crate) fn standing_still_errors(
    track: &Track,
    rows: Range<usize>,
    horizons: &[usize],
) -> Vec<Vec<WindowError>> {
    struct StandingStill {
        command_len: usize,
    }
    impl Dynamics for StandingStill {
        fn state_len(&self) -> usize {
            STATE_LEN
        }
        fn command_len(&self) -> usize {
            self.command_len
        }
        fn fresh_len(&self) -> usize {
            STATE_LEN
        }
        fn step(&self, _knot: usize, state: &[f64], _command: &[f64], fresh: &mut [f64]) {
            fresh.copy_from_slice(&state[..STATE_LEN]);
        }
        fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
            self.step(knot, z, u, fresh);
            let width = STATE_LEN + self.command_len;
            jacobian.fill(0.0);
            for row in 0..STATE_LEN {
                jacobian[row * width + row] = 1.0;
            }
        }
    }
    window_errors(
        &StandingStill {
            command_len: track.command(0).len(),
        },
        track,
        rows,
        horizons,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::{Configuration, Flight, Pose, Sample};
    use crate::model::lag::CommandInputs;

    /// An end effector that moves along x at 1 m/s below a hovering quadrotor.
    fn drifting(rows: usize) -> Flight {
        let sample = |row: usize| Sample {
            t_s: row as f64 * crate::DT,
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.0,
            },
            command: [0.0, 0.0, 1.5],
            command_velocity: None,
            quadrotor: Some(Pose {
                position: [0.0, 0.0, 1.5],
                attitude: [1.0, 0.0, 0.0, 0.0],
            }),
            end_effector: Some([row as f64 * crate::DT, 0.0, 0.8]),
        };
        Flight {
            name: "drifting".into(),
            samples: (0..rows).map(sample).collect(),
        }
    }

    #[test]
    fn standing_still_errs_by_the_mean_distance() {
        let flight = drifting(100);
        let track = Track::new(&flight, CommandInputs::Position).unwrap();
        let windows = standing_still_errors(&track, 0..100, &[10, 30]);
        // Steps 1 … H at 0.05 m each: mean 0.05 (H + 1) / 2; over 1 m from step 21 on.
        assert_eq!(windows[0].len(), 9);
        assert_eq!(windows[1].len(), 7);
        for window in &windows[0] {
            assert!((window.mean_m - 0.05 * 5.5).abs() < 1e-12 && !window.diverged);
        }
        for window in &windows[1] {
            assert!((window.mean_m - 0.05 * 15.5).abs() < 1e-12 && window.diverged);
        }
        let pairs: Vec<_> = windows[1].iter().map(|window| (&track, window)).collect();
        let (summary, worst) = summarize(30, &pairs, None);
        assert_eq!(worst.unwrap().flight.name, "drifting");
        assert_eq!((summary.windows, summary.diverged_share), (7, 1.0));
        assert!((summary.horizon_s - 1.5).abs() < 1e-12);
    }

    #[test]
    fn windows_with_a_rejected_row_are_skipped() {
        let mut flight = drifting(100);
        flight.samples[55].end_effector = None;
        let track = Track::new(&flight, CommandInputs::Position).unwrap();
        let starts: Vec<usize> = standing_still_errors(&track, 0..100, &[10])[0]
            .iter()
            .map(|window| window.start)
            .collect();
        assert_eq!(starts, [0, 10, 20, 30, 40, 60, 70, 80]);
    }

    #[test]
    fn quantiles_interpolate_and_keep_infinity() {
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[1.0, 2.0], 0.5), Some(1.5));
        assert_eq!(
            quantile(&[1.0, f64::INFINITY, f64::INFINITY], 0.75),
            Some(f64::INFINITY)
        );
    }
}
