//! How well a bank predicts recordings: one-step residuals, rollout errors, stability.

use super::band::PredictionBand;
use super::bank::Bank;
use super::error::ModelError;
use super::prediction::Prediction;
use super::rollout::{RolloutError, WindowError, summarize};
use super::support::arm_angle;
use super::track::Track;
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Horizons of the rollouts, in steps: 0.5, 1, 2.5, 5 and 10 s.
pub(crate) const HORIZONS: [usize; 5] = [10, 20, 50, 100, 200];

/// In a swing the arm leans farther than this from below the quadrotor, rad (30°).
const SWING_ANGLE: f64 = std::f64::consts::FRAC_PI_6;

/// How well a bank predicts recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckReport {
    /// One entry per flight, in the order given.
    pub flights: Vec<FlightCheck>,
    /// All flights together: every window, then the swings, then the rest; a horizon each.
    #[serde(default)]
    pub pooled: Vec<PooledError>,
    /// One entry per model of the bank.
    pub models: Vec<ModelCheck>,
    /// The bank's band of confidence, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band: Option<PredictionBand>,
}

/// Which windows an error is pooled over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WindowKind {
    /// All of them.
    All,
    /// Windows in which the arm leans farther than 30° from below the quadrotor.
    Swings,
    /// The others.
    Rest,
}

/// Rollout error over the windows of several flights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PooledError {
    /// Which windows.
    pub kind: WindowKind,
    /// Their error.
    pub error: RolloutError,
    /// Name of the flight with the worst window.
    pub worst_flight: Option<String>,
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
    let predicted = |flight| {
        let prediction = predict(bank, flight)?;
        let windows = prediction.windows(&HORIZONS);
        Ok(Predicted { prediction, windows })
    };
    let predicted: Vec<Predicted> = flights
        .par_iter()
        .map(predicted)
        .collect::<Result<_, ModelError>>()?;
    let band = bank.band();
    let kinds = [WindowKind::All, WindowKind::Swings, WindowKind::Rest];
    Ok(CheckReport {
        flights: predicted.iter().map(|own| check_flight(own, band)).collect(),
        pooled: kinds
            .into_iter()
            .flat_map(|kind| pooled(&predicted, kind, band))
            .collect(),
        models,
        band: band.cloned(),
    })
}

/// [`Prediction::new`], whose error names the flight.
pub(crate) fn predict<'a>(bank: &Bank, flight: &'a Flight) -> Result<Prediction<'a>, ModelError> {
    Prediction::new(bank, flight).map_err(|source| ModelError::Flight {
        flight: flight.name.clone(),
        source: Box::new(source),
    })
}

/// The windows of every flight, per horizon in `horizons` (steps, ascending).
///
/// # Errors
/// As [`predict`].
pub(crate) fn windows<'a>(
    bank: &Bank,
    flights: impl ParallelIterator<Item = &'a Flight>,
    horizons: &[usize],
) -> Result<Vec<Vec<Vec<WindowError>>>, ModelError> {
    flights
        .map(|flight| Ok(predict(bank, flight)?.windows(horizons)))
        .collect()
}

/// A flight and its windows, per horizon.
struct Predicted<'a> {
    prediction: Prediction<'a>,
    windows: Vec<Vec<WindowError>>,
}

fn check_flight(predicted: &Predicted, band: Option<&PredictionBand>) -> FlightCheck {
    let track = &predicted.prediction.track;
    let configurations = track.configurations();
    let error = |(&steps, list): (&usize, &Vec<WindowError>)| {
        let windows: Vec<_> = list.iter().map(|window| (track, window)).collect();
        summarize(steps, &windows, band).0
    };
    FlightCheck {
        path: track.flight.name.clone(),
        configuration: configurations[0],
        last_configuration: track
            .constant_configuration()
            .is_none()
            .then(|| configurations[configurations.len() - 1]),
        one_step_rmse: predicted.prediction.one_step_rmse(),
        rollout: HORIZONS.iter().zip(&predicted.windows).map(error).collect(),
    }
}

/// The windows of one kind of all flights, per horizon.
fn pooled(predicted: &[Predicted], kind: WindowKind, band: Option<&PredictionBand>) -> Vec<PooledError> {
    let at_horizon = |(number, &steps): (usize, &usize)| {
        let windows: Vec<(&Track, &WindowError)> = predicted
            .iter()
            .flat_map(|own| {
                own.windows[number]
                    .iter()
                    .map(move |window| (&own.prediction.track, window))
            })
            .filter(|(track, window)| {
                kind == WindowKind::All
                    || (kind == WindowKind::Swings) == is_swing(track, window.start, steps)
            })
            .collect();
        let (error, worst) = summarize(steps, &windows, band);
        PooledError {
            kind,
            error,
            worst_flight: worst.map(|track| track.flight.name.clone()),
        }
    };
    HORIZONS.iter().enumerate().map(at_horizon).collect()
}

/// Whether the arm leans far in any of `steps` rows from `start` on.
fn is_swing(track: &Track, start: usize, steps: usize) -> bool {
    (start..=start + steps).any(|row| arm_angle(track.state(row)) > SWING_ANGLE)
}
