//! How well a bank predicts recordings: one-step residuals, rollout errors, stability.

use super::bank::Bank;
use super::error::ModelError;
use super::family::Model;
use super::lag::CommandInputs;
use super::one_step::{one_step_rmse, one_step_rmse_from};
use super::physical::{self, FlightData, observe};
use super::rollout::{RolloutError, summarize, window_errors, window_errors_from};
use super::schedule::ScheduledModel;
use super::track::Track;
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Horizons of the rollouts, in steps: 0.5, 1, 2.5, 5 and 10 s.
const HORIZONS: [usize; 5] = [10, 20, 50, 100, 200];

/// Rows in a row that must be valid where a physical model's windows start, as for three lags.
const OBSERVED_ROWS: usize = 3;

type FlatState = [f64; physical::STATE_LEN];

/// How well a bank predicts recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckReport {
    /// One entry per flight, in the order given.
    pub flights: Vec<FlightCheck>,
    /// One entry per model of the bank.
    pub models: Vec<ModelCheck>,
}

/// How well a bank predicts one recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightCheck {
    /// Name of the flight.
    pub path: String,
    /// Its configuration; of its first row, where it changes.
    pub configuration: Configuration,
    /// Configuration of its last row, where it changes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_configuration: Option<Configuration>,
    /// Root-mean-square error of one-step predictions per signal, m (positions) or 1 (attitude); empty if no
    /// row has valid lags.
    pub one_step_rmse: BTreeMap<String, f64>,
    /// End-effector rollout error per horizon.
    pub rollout: Vec<RolloutError>,
}

/// Numbers of one model of the bank.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelCheck {
    /// Where it sits.
    pub configuration: Configuration,
    /// Spectral radius of the Jacobian at rest.
    pub spectral_radius: f64,
    /// Condition number of its fit.
    pub condition_number: f64,
}

/// Predicts `flights` with `bank`: through the interpolation where a configuration lies between the models,
/// time-varying where it changes.
///
/// # Errors
/// A flight outside the bank's range (unless the bank allows extrapolation), without rows, or without the
/// commanded velocity where the models take it; the eigenvalues of a model did not converge.
pub fn check(bank: &Bank, flights: &[Flight]) -> Result<CheckReport, ModelError> {
    let models = bank
        .models()
        .iter()
        .map(|model| {
            Ok(ModelCheck {
                configuration: model.configuration,
                spectral_radius: model.model.spectral_radius(model.configuration)?,
                condition_number: model.diagnostics.condition_number,
            })
        })
        .collect::<Result<_, ModelError>>()?;
    let named = |flight: &Flight| {
        check_flight(bank, flight).map_err(|source| ModelError::Flight {
            flight: flight.name.clone(),
            source: Box::new(source),
        })
    };
    Ok(CheckReport {
        flights: flights.par_iter().map(named).collect::<Result<_, _>>()?,
        models,
    })
}

fn check_flight(bank: &Bank, flight: &Flight) -> Result<FlightCheck, ModelError> {
    let inputs = match &bank.models()[0].model {
        Model::Lag(first) => first.inputs(),
        Model::Physical(_) => CommandInputs::Position,
    };
    let track = Track::new(flight, inputs)?;
    let configurations = track.configurations();
    let model = bank.scheduled(&configurations)?;
    let rows = 0..track.rows();
    let (windows, one_step_rmse) = match hidden_states(&model, flight)? {
        None => (
            window_errors(&model, &track, rows, &HORIZONS),
            one_step_rmse(&model, &[&track]),
        ),
        Some(states) => {
            let estimate = |row: usize, state: &mut [f64]| state.copy_from_slice(&states[row]);
            let one_step = |_, row: usize, state: &mut [f64]| estimate(row, state);
            (
                window_errors_from(&model, &track, rows, &HORIZONS, OBSERVED_ROWS, &estimate),
                one_step_rmse_from(&model, &[&track], OBSERVED_ROWS, &one_step),
            )
        }
    };
    Ok(FlightCheck {
        path: flight.name.clone(),
        configuration: configurations[0],
        last_configuration: track
            .constant_configuration()
            .is_none()
            .then(|| configurations[configurations.len() - 1]),
        one_step_rmse,
        rollout: HORIZONS
            .iter()
            .zip(&windows)
            .map(|(&steps, list)| summarize(&track, steps, list))
            .collect(),
    })
}

/// The states of a physical model along `flight`, estimated row by row from the poses up to that row; `None` for
/// a model whose state is made of lags. Rows outside every observed stretch are zero: no window starts there.
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
