//! One-step predictions against the recording.

use super::lag::STATE_LEN;
use super::track::Track;
use crate::flight::SIGNALS;
use crate::trajopt::Dynamics;
use std::collections::BTreeMap;

/// Root-mean-square one-step error per signal over all valid transitions of `tracks`, m (positions) or 1
/// (attitude); empty if there is none.
pub(crate) fn one_step_rmse(model: &impl Dynamics, tracks: &[&Track]) -> BTreeMap<String, f64> {
    let lags = model.state_len() / STATE_LEN;
    let lagged_state = |track: usize, row: usize, state: &mut [f64]| tracks[track].lagged_state(row, state);
    one_step_rmse_from(model, tracks, lags, &lagged_state)
}

/// [`one_step_rmse`] from the states that `write_state` writes for a track and row.
pub(crate) fn one_step_rmse_from(
    model: &impl Dynamics,
    tracks: &[&Track],
    lags: usize,
    write_state: &dyn Fn(usize, usize, &mut [f64]),
) -> BTreeMap<String, f64> {
    let mut state = vec![0.0; model.state_len()];
    let (mut squares, mut count) = ([0.0; STATE_LEN], 0_u32);
    let mut predicted = vec![0.0; model.fresh_len()];
    for (number, track) in tracks.iter().enumerate() {
        for row in (0..track.rows()).filter(|&row| track.unbroken(row, lags, 1)) {
            write_state(number, row, &mut state);
            model.step(row, &state, track.command(row), &mut predicted);
            let measured = track.state(row + 1);
            for signal in 0..STATE_LEN {
                squares[signal] += (predicted[signal] - measured[signal]).powi(2);
            }
            count += 1;
        }
    }
    if count == 0 {
        return BTreeMap::new();
    }
    SIGNALS
        .map(String::from)
        .into_iter()
        .zip(squares.map(|sum: f64| (sum / f64::from(count)).sqrt()))
        .collect()
}
