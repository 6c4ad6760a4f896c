//! A fitted physical model: parameters, how sure they are, and where they came from.

use super::arm::ArmLength;
use super::dynamics::PhysicalDynamics;
use super::error::PhysicalError;
use super::fit::PhysicalFitOptions;
use super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters, Part};
use super::state::{STATE_LEN, State};
use crate::flight::Configuration;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// A fitted physical model at one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicalModel {
    /// The parameters.
    pub parameters: Parameters<f64>,
    /// Posterior covariance of the parameters' coordinates ([`Parameters::coordinates`]),
    /// [`PARAMETER_COUNT`] × [`PARAMETER_COUNT`]; empty for a model that was not fitted.
    pub covariance: Vec<Vec<f64>>,
    /// Where it came from.
    pub fit: FitSummary,
}

/// Provenance of a fitted model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitSummary {
    /// Program and version that fitted it.
    pub tool: String,
    /// Names of the flights.
    pub flights: Vec<String>,
    /// Their configuration.
    pub configuration: Configuration,
    /// Rows simulated.
    pub rows: usize,
    /// The objective at the parameters.
    pub objective: f64,
    /// Iterations on whole flights.
    pub iterations: usize,
    /// Whether the objective had stopped decreasing.
    pub converged: bool,
    /// Options of the fit.
    pub options: PhysicalFitOptions,
}

impl PhysicalModel {
    /// Standard deviation of every parameter's coordinate: for logarithmic ones a relative error.
    pub fn standard_deviations(&self) -> Vec<f64> {
        self.covariance
            .iter()
            .enumerate()
            .map(|(i, row)| row[i].sqrt())
            .collect()
    }

    /// Refuses what a damaged file may hold.
    ///
    /// # Errors
    /// A parameter outside its bounds, or a covariance of the wrong size.
    pub fn validate(&self) -> Result<(), PhysicalError> {
        PhysicalError::check_bounds(&self.parameters)?;
        let sizes = std::iter::once(self.covariance.len()).chain(self.covariance.iter().map(Vec::len));
        for found in sizes {
            if !self.covariance.is_empty() && found != PARAMETER_COUNT {
                return Err(PhysicalError::Shape {
                    what: "rows or columns of the parameters' covariance",
                    found,
                    expected: PARAMETER_COUNT,
                });
            }
        }
        Ok(())
    }

    /// Dynamics for planning at a constant arm length.
    ///
    /// # Errors
    /// As [`PhysicalDynamics::new`].
    pub fn dynamics(&self, length_m: f64) -> Result<PhysicalDynamics, PhysicalError> {
        PhysicalDynamics::new(vec![self.parameters], vec![ArmLength::constant(length_m)])
    }

    /// The flat state at rest at `position`.
    pub fn rest_state(&self, length_m: f64, position: [f64; 3]) -> Vec<f64> {
        let mut flat = vec![0.0; STATE_LEN];
        State::rest(&self.parameters, length_m, position).write_flat(&mut flat);
        flat
    }
}

/// The vehicle that several fits, of arms in different configurations, agree on: the mean of their vehicle
/// parameters weighted by their precision, `(Σ S_c)⁻¹ Σ S_c a_c`, where `S_c` is the inverse of the posterior
/// covariance of those parameters' coordinates. The arm's parameters of the result are the first model's.
///
/// # Errors
/// No model, or one without a (positive definite) covariance.
pub fn pooled_vehicle(models: &[PhysicalModel]) -> Result<Parameters<f64>, PhysicalError> {
    let vehicle: Vec<usize> = (0..PARAMETER_COUNT)
        .filter(|&i| PARAMETERS[i].part == Part::Vehicle)
        .collect();
    let count = vehicle.len();
    let mut precision = DMatrix::zeros(count, count);
    let mut weighted = DVector::zeros(count);
    for model in models {
        model.validate()?;
        let coordinates = model.parameters.coordinates();
        let own = DVector::from_fn(count, |i, _| coordinates[vehicle[i]]);
        let covariance = (model.covariance.len() == PARAMETER_COUNT)
            .then(|| DMatrix::from_fn(count, count, |i, j| model.covariance[vehicle[i]][vehicle[j]]));
        let inverse = covariance
            .and_then(DMatrix::cholesky)
            .ok_or(PhysicalError::NoCovariance)?
            .inverse();
        weighted += &inverse * own;
        precision += inverse;
    }
    let first = models.first().ok_or(PhysicalError::NoFlights)?;
    let pooled = precision
        .cholesky()
        .ok_or(PhysicalError::NoCovariance)?
        .solve(&weighted);
    let mut coordinates = first.parameters.coordinates();
    for (i, &index) in vehicle.iter().enumerate() {
        coordinates[index] = pooled[i];
    }
    Ok(Parameters::from_coordinates(coordinates))
}
