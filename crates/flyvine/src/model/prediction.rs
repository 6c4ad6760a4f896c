//! A bank's predictions of one flight, whichever the family.

use super::bank::Bank;
use super::error::ModelError;
use super::family::Model;
use super::lag::CommandInputs;
use super::one_step::{one_step_rmse, one_step_rmse_from};
use super::physical::{self, FlightData, observe};
use super::rollout::{WindowError, window_errors, window_errors_from};
use super::schedule::ScheduledModel;
use super::track::Track;
use crate::flight::Flight;
use std::collections::BTreeMap;

/// Rows in a row that must be valid where a physical model's windows start, as for three lags.
const OBSERVED_ROWS: usize = 3;

type FlatState = [f64; physical::STATE_LEN];

/// A flight, the models along its configurations, and the states that rollouts start from.
pub(crate) struct Prediction<'a> {
    pub track: Track<'a>,
    model: ScheduledModel,
    /// The states of a physical model, estimated row by row from the poses up to that row; `None` for a model
    /// whose state is made of lags. Rows outside every observed stretch are zero: no window starts there.
    hidden: Option<Vec<FlatState>>,
    /// Of how many of the bank's models the one of every row is made.
    models: Vec<f64>,
}

impl<'a> Prediction<'a> {
    /// Prepares predictions of `flight` by `bank`.
    ///
    /// # Errors
    /// A flight outside the bank's range (unless the bank allows extrapolation), without rows, or without the
    /// commanded velocity where the models take it.
    pub fn new(bank: &Bank, flight: &'a Flight) -> Result<Self, ModelError> {
        let inputs = match &bank.models()[0].model {
            Model::Lag(first) => first.inputs(),
            Model::Physical(_) => CommandInputs::Position,
        };
        let track = Track::new(flight, inputs)?;
        let configurations = track.configurations();
        let model = bank.scheduled(&configurations)?;
        Ok(Prediction {
            hidden: hidden_states(&model, flight)?,
            models: configurations.iter().map(|own| bank.models_at(*own)).collect(),
            track,
            model,
        })
    }

    /// The windows that fit the flight, per horizon in `horizons` (steps, ascending).
    pub fn windows(&self, horizons: &[usize]) -> Vec<Vec<WindowError>> {
        let rows = 0..self.track.rows();
        let mut windows = match &self.hidden {
            None => window_errors(&self.model, &self.track, rows, horizons),
            Some(states) => {
                let estimate = |row: usize, state: &mut [f64]| state.copy_from_slice(&states[row]);
                window_errors_from(&self.model, &self.track, rows, horizons, OBSERVED_ROWS, &estimate)
            }
        };
        for (list, steps) in windows.iter_mut().zip(horizons) {
            for window in list {
                let passed = &self.models[window.start..window.start + steps];
                window.models = passed.iter().copied().fold(1.0, f64::max);
            }
        }
        windows
    }

    /// Root-mean-square one-step error per signal.
    pub fn one_step_rmse(&self) -> BTreeMap<String, f64> {
        match &self.hidden {
            None => one_step_rmse(&self.model, &[&self.track]),
            Some(states) => {
                let estimate = |_, row: usize, state: &mut [f64]| state.copy_from_slice(&states[row]);
                one_step_rmse_from(&self.model, &[&self.track], OBSERVED_ROWS, &estimate)
            }
        }
    }
}

fn hidden_states(model: &ScheduledModel, flight: &Flight) -> Result<Option<Vec<FlatState>>, ModelError> {
    let Model::Physical(_) = model.at_knot(0) else {
        return Ok(None);
    };
    let mut states = vec![[0.0; physical::STATE_LEN]; flight.samples.len()];
    for stretch in FlightData::stretches(flight)? {
        let Model::Physical(first) = model.at_knot(stretch.first_row) else {
            unreachable!("a bank holds models of one family");
        };
        let estimates = observe(model, &first.parameters, &stretch, 0)?;
        states[stretch.first_row..][..estimates.len()].copy_from_slice(&estimates);
    }
    Ok(Some(states))
}
