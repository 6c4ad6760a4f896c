//! How well a bank predicts recordings: one-step residuals, rollout errors, stability.

use super::bank::Bank;
use super::error::ModelError;
use super::family::Model;
use super::one_step::one_step_rmse;
use super::rollout::{RolloutError, summarize, window_errors};
use super::track::Track;
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Horizons of the rollouts, in steps: 0.5, 1, 2.5, 5 and 10 s.
const HORIZONS: [usize; 5] = [10, 20, 50, 100, 200];

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
    let Model::Lag(first) = &bank.models()[0].model;
    let track = Track::new(flight, first.inputs())?;
    let configurations = track.configurations();
    let model = bank.scheduled(&configurations)?;
    let windows = window_errors(&model, &track, 0..track.rows(), &HORIZONS);
    Ok(FlightCheck {
        path: flight.name.clone(),
        configuration: configurations[0],
        last_configuration: track
            .constant_configuration()
            .is_none()
            .then(|| configurations[configurations.len() - 1]),
        one_step_rmse: one_step_rmse(&model, &[&track]),
        rollout: HORIZONS
            .iter()
            .zip(&windows)
            .map(|(&steps, list)| summarize(&track, steps, list))
            .collect(),
    })
}
