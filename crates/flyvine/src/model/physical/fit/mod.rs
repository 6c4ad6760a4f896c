//! Fit by simulation error: every flight is simulated from its first row to its last, and the parameters are
//! those whose simulations stay closest to what was seen, given their priors.
//!
//! Simulation error has many minima, since a wrong attitude loop oscillates and a wrong arm swings out of
//! phase. So the fit begins with the first seconds of every flight, with the priors strong and the limits of
//! the autopilot held, from one start after another until one explains them; only then whole flights are
//! simulated, with the priors as they are and everything free.

mod correction;
mod levenberg_marquardt;
mod problem;
mod residual;
#[cfg(test)]
mod tests;
mod timing;

use super::error::PhysicalError;
use super::flight_data::FlightData;
use super::model::{FitSummary, PhysicalModel};
use super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters, Part};
use crate::flight::Flight;
pub use correction::CorrectionEquations;
use levenberg_marquardt::{Minimum, minimize};
use nalgebra::DMatrix;
use problem::Problem;
use residual::Misfit;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
pub use timing::{Estimate, FlightTiming, StreamTiming};

/// Options of [`fit_physical`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhysicalFitOptions {
    /// Size of an ordinary position residual, model error included, m. Default 0.01.
    pub position_sigma_m: f64,
    /// Size of an ordinary residual of the attitude's vector part (half an angle). Default 0.03.
    pub attitude_sigma: f64,
    /// Position errors beyond this count less and less, m. Default 0.05.
    pub robust_scale_m: f64,
    /// Rows that share one model error: residuals of neighbouring rows are not independent. Default 30.
    pub correlated_rows: f64,
    /// Most iterations on whole flights. Default 20.
    pub max_iterations: usize,
    /// Hold the parameters of the vehicle at these ([`Part::Vehicle`]) and fit the arm alone. Default: fit all.
    pub vehicle: Option<Parameters<f64>>,
    /// Further starts, tried before the built-in variations of the defaults: another configuration's result.
    pub starts: Vec<Parameters<f64>>,
    /// How much the rows of a flight count, by its name. Default: every flight 1.
    pub weights: BTreeMap<String, f64>,
    /// Where a fit continues from known parameters ([`fit_configurations`]), keep near them: every coordinate has
    /// this many standard deviations of its prior for a radius. Default: no such radius.
    pub trust_radius: Option<f64>,
    /// Try a small [`super::Correction`] on top ([`crate::model::fit_physical_bank`]). Default: physics alone.
    pub correction: bool,
}

impl Default for PhysicalFitOptions {
    fn default() -> Self {
        PhysicalFitOptions {
            position_sigma_m: 0.01,
            attitude_sigma: 0.03,
            robust_scale_m: 0.05,
            correlated_rows: 30.0,
            max_iterations: 20,
            vehicle: None,
            starts: Vec::new(),
            weights: BTreeMap::new(),
            trust_radius: None,
            correction: false,
        }
    }
}

/// The first stage simulates this many rows of every flight.
const FIRST_ROWS: usize = 200;
/// Its robust scale, m, and its correlated rows (that is, stronger priors).
const FIRST_SCALE_M: f64 = 0.3;
const FIRST_CORRELATED_ROWS: f64 = 100.0;
const FIRST_ITERATIONS: usize = 15;
/// A start explains the first rows if their mean loss is below this: residuals of about 3 σ.
const EXPLAINED_LOSS: f64 = 9.0;
/// Limits that ordinary flights do not reach, held in the first stage.
const LIMITS: [&str; 4] = [
    "rate_limit",
    "tilt_limit",
    "thrust_maximum",
    "vertical_speed_limit",
];

/// What a fit is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitStage {
    /// Explaining the first seconds of every flight from one of several starts.
    FirstSeconds {
        /// Number of the start, from 0.
        start: usize,
    },
    /// Simulating whole flights of one configuration.
    WholeFlights,
    /// Simulating whole flights of all configurations of one vehicle.
    AllConfigurations,
}

/// Where a fit is, for progress reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitProgress {
    /// What it is doing.
    pub stage: FitStage,
    /// Iterations done in this stage.
    pub iteration: usize,
    /// Mean distance of the simulated end effector from where it was seen, m, over whole simulations from each
    /// flight's first row.
    pub tip_error_m: f64,
}

/// Fits the physical model to `flights`, all of one configuration.
///
/// Deterministic, whatever the number of threads.
///
/// # Errors
/// No flight, flights at different configurations or with a configuration that changes, a flight that cannot be
/// simulated ([`FlightData::stretches`]), or simulations that diverge from every start.
pub fn fit_physical(
    flights: &[Flight],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(FitProgress),
) -> Result<PhysicalModel, PhysicalError> {
    let stretches = one_configuration(flights, options)?;
    let first = first_stage(&stretches, options, progress).ok_or(PhysicalError::Diverged)?;
    let problem = Problem {
        misfits: vec![whole_flights(&stretches, options)],
        held: held(options, &[]),
        trust: None,
    };
    let minimum = minimize(
        &problem,
        first.parameters,
        options.max_iterations,
        &mut |minimum| report(FitStage::WholeFlights, minimum, progress),
    );
    let mut models = posterior(&problem, &minimum, &[(flights, &stretches)], options)?;
    Ok(models.remove(0))
}

/// Fits all configurations of one vehicle together: `groups` holds the flights of each, `starts` the parameters to
/// begin with: those that were found for each on its own, or for all together earlier. The configurations keep
/// parameters of their own, drawn towards each other.
///
/// # Errors
/// As [`fit_physical`].
pub fn fit_configurations(
    groups: &[Vec<Flight>],
    starts: &[Parameters<f64>],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(FitProgress),
) -> Result<Vec<PhysicalModel>, PhysicalError> {
    if starts.is_empty() || starts.len() != groups.len() {
        return Err(PhysicalError::Shape {
            what: "parameters to start the configurations' fits from",
            found: starts.len(),
            expected: groups.len().max(1),
        });
    }
    let stretches = groups
        .iter()
        .map(|flights| one_configuration(flights, options))
        .collect::<Result<Vec<_>, _>>()?;
    let problem = Problem {
        misfits: stretches.iter().map(|own| whole_flights(own, options)).collect(),
        held: held(options, &[]),
        trust: options.trust_radius.map(|radius| (starts.to_vec(), radius)),
    };
    let start = starts.iter().map(|start| {
        let start = match &options.vehicle {
            Some(vehicle) => start.with_vehicle(vehicle),
            None => *start,
        };
        sent_velocities(start, stretches.iter().flatten())
    });
    let minimum = minimize(
        &problem,
        start.collect(),
        options.max_iterations,
        &mut |minimum| report(FitStage::AllConfigurations, minimum, progress),
    );
    let groups: Vec<(&[Flight], &[FlightData])> = groups
        .iter()
        .zip(&stretches)
        .map(|(flights, stretches)| (flights.as_slice(), stretches.as_slice()))
        .collect();
    posterior(&problem, &minimum, &groups, options)
}

/// How late the streams of each of `flights`, all of one configuration, are behind their commands, by `model`, which
/// was fitted to them.
///
/// # Errors
/// As [`fit_physical`]; the model's equations are singular.
pub fn stream_timing(
    model: &PhysicalModel,
    flights: &[Flight],
    options: &PhysicalFitOptions,
) -> Result<StreamTiming, PhysicalError> {
    let stretches = one_configuration(flights, options)?;
    timing::timing(&whole_flights(&stretches, options), &model.parameters).ok_or(PhysicalError::Diverged)
}

fn whole_flights<'a>(flights: &'a [FlightData], options: &'a PhysicalFitOptions) -> Misfit<'a> {
    Misfit {
        flights,
        rows: usize::MAX,
        robust_scale_m: options.robust_scale_m,
        correlated_rows: options.correlated_rows,
        options,
    }
}

fn report(stage: FitStage, minimum: &Minimum, progress: &mut dyn FnMut(FitProgress)) {
    progress(FitProgress {
        stage,
        iteration: minimum.iterations,
        tip_error_m: minimum.tip_error_m,
    });
}

/// The models at a minimum, with the posterior of their coordinates by Gauss–Newton; the prior keeps the Hessian
/// positive definite.
fn posterior(
    problem: &Problem,
    minimum: &Minimum,
    groups: &[(&[Flight], &[FlightData])],
    options: &PhysicalFitOptions,
) -> Result<Vec<PhysicalModel>, PhysicalError> {
    if !minimum.value.is_finite() {
        return Err(PhysicalError::Diverged);
    }
    let hessian = problem.quadratic(&minimum.parameters).hessian;
    let covariance: DMatrix<f64> = hessian.cholesky().ok_or(PhysicalError::Diverged)?.inverse();
    let model = |(number, &(flights, stretches)): (usize, &(&[Flight], &[FlightData]))| {
        let own = number * PARAMETER_COUNT..(number + 1) * PARAMETER_COUNT;
        let row = |i: usize| own.clone().map(|j| covariance[(i, j)]).collect();
        PhysicalModel {
            parameters: minimum.parameters[number],
            arm: stretches[0].arms[0],
            correction: None,
            covariance: own.clone().map(row).collect(),
            fit: Some(FitSummary {
                tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).into(),
                flights: flights.iter().map(|flight| flight.name.clone()).collect(),
                configuration: stretches[0].configurations[0],
                rows: problem.misfits[number].counted_rows(),
                tip_error_m: problem.misfits[number]
                    .value(&minimum.parameters[number])
                    .tip_error_m(),
                objective: minimum.value,
                iterations: minimum.iterations,
                converged: minimum.converged,
                options: options.clone(),
            }),
        }
    };
    Ok(groups.iter().enumerate().map(model).collect())
}

/// All stretches of all flights, after a check that their configuration is one and the same.
fn one_configuration(
    flights: &[Flight],
    options: &PhysicalFitOptions,
) -> Result<Vec<FlightData>, PhysicalError> {
    let mut stretches = Vec::new();
    for flight in flights {
        let weight = *options.weights.get(&flight.name).unwrap_or(&1.0);
        if !(weight.is_finite() && weight >= 0.0) {
            return Err(PhysicalError::Weight {
                flight: flight.name.clone(),
                found: weight,
            });
        }
        let own = FlightData::stretches(flight)?;
        stretches.extend(own.into_iter().map(|stretch| FlightData { weight, ..stretch }));
    }
    let expected = stretches.first().ok_or(PhysicalError::NoFlights)?.configurations[0];
    for stretch in &stretches {
        let differs = |found: &&_| !super::super::bank::same(found, &expected);
        if let Some(found) = stretch.configurations.iter().find(differs) {
            return Err(PhysicalError::MixedConfigurations {
                flight: stretch.name.clone(),
                found: *found,
                expected,
            });
        }
    }
    Ok(stretches)
}

/// The first start that explains the flights' first rows, or the best of all; `None` if all diverged.
fn first_stage(
    flights: &[FlightData],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(FitProgress),
) -> Option<Minimum> {
    let misfit = Misfit {
        flights,
        rows: FIRST_ROWS,
        robust_scale_m: FIRST_SCALE_M,
        correlated_rows: FIRST_CORRELATED_ROWS,
        options,
    };
    let counted_rows = misfit.counted_rows() as f64;
    let problem = Problem {
        misfits: vec![misfit],
        held: held(options, &LIMITS),
        trust: None,
    };
    let mut best: Option<Minimum> = None;
    let starts = options.starts.iter().copied().chain(built_in_starts());
    for (number, mut start) in starts.enumerate() {
        if let Some(vehicle) = &options.vehicle {
            start = start.with_vehicle(vehicle);
        }
        let start = sent_velocities(start, flights);
        let minimum = minimize(&problem, vec![start], FIRST_ITERATIONS, &mut |minimum| {
            report(FitStage::FirstSeconds { start: number }, minimum, progress)
        });
        let mean_loss = minimum.value * FIRST_CORRELATED_ROWS / counted_rows;
        if minimum.value < best.as_ref().map_or(f64::INFINITY, |best| best.value) {
            best = Some(minimum);
        }
        if mean_loss < EXPLAINED_LOSS {
            break;
        }
    }
    best
}

/// `start` with a feed-forward if the flights were sent velocities, and without one, which is then no variable, if not.
fn sent_velocities<'a>(
    start: Parameters<f64>,
    flights: impl IntoIterator<Item = &'a FlightData>,
) -> Parameters<f64> {
    let sent = flights.into_iter().all(|flight| flight.commanded_velocity);
    match start.velocity_feedforward {
        _ if !sent => Parameters {
            velocity_feedforward: 0.0,
            acceleration_feedforward: 0.0,
            ..start
        },
        0.0 => Parameters {
            velocity_feedforward: 1.0, // what is sent is most likely followed
            ..start
        },
        _ => start,
    }
}

/// Names of the parameters that stay: `limits`, and the vehicle's where it is known.
fn held<'a>(options: &PhysicalFitOptions, limits: &[&'a str]) -> Vec<&'a str> {
    let vehicle = PARAMETERS
        .iter()
        .filter(|info| options.vehicle.is_some() && info.part == Part::Vehicle);
    limits
        .iter()
        .copied()
        .chain(vehicle.map(|info| info.name))
        .collect()
}

/// The defaults, then arms and autopilots a good deal softer or stiffer, then autopilots that limit the horizontal speed to
/// what flights in a room reach: far below it the limit is not felt, so a fit does not find it by itself.
fn built_in_starts() -> impl Iterator<Item = Parameters<f64>> {
    const UNLIMITED: f64 = 12.0;
    const VARIATIONS: [(f64, f64, f64); 7] = [
        (1.0, 1.0, UNLIMITED),
        (0.2, 1.0, UNLIMITED),
        (5.0, 1.0, UNLIMITED),
        (1.0, 0.6, UNLIMITED),
        (1.0, 1.6, UNLIMITED),
        (1.0, 1.0, 1.5),
        (1.0, 1.6, 1.5),
    ];
    VARIATIONS.into_iter().map(|(stiffness, gain, speed)| {
        let mut start = Parameters::defaults();
        start.horizontal_speed_limit = speed;
        start.base_stiffness *= stiffness;
        start.joint_stiffness *= stiffness;
        start.position_gain_xy *= gain;
        start.velocity_gain_xy *= gain;
        start.attitude_gain *= gain;
        start
    })
}
