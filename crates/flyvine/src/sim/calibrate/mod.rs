//! Calibration: the vehicle's parameters by nonlinear least squares on replays of recorded flights.
//!
//! Minimizes `Σ_s (1/n_s) Σ_i (d_{s,i}/σ_s)²` over all signals s of all recordings, d the differences of
//! [`super::replay`] and σ_s the expected accuracy of that signal, within bounds, by Levenberg–Marquardt with
//! forward differences. Each free parameter is searched on a scale from 0 (its lower bound) to 1 (its upper).
//!
//! What the flights do not identify can be held by what is believed beforehand ([`prior`]): without the flights of a
//! configuration nothing else tells its beam.

pub mod prior;
mod search;
mod uncertainty;

use super::replay::{Recording, Signal};
use super::{SimulatedVehicle, VehicleParameters};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// A parameter to be found.
#[derive(Clone, Copy)]
pub struct FreeParameter {
    /// Its path in the vehicle's TOML.
    pub name: &'static str,
    /// Lower bound, in the parameter's unit.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
    /// How far from a start vehicle it may well be, one standard deviation: of the logarithm where the lower bound is
    /// positive, else in the parameter's unit.
    pub spread: f64,
    /// Difference step for its derivative, on the 0 to 1 scale; coarse where the vehicle answers in steps.
    pub difference: f64,
    /// Reads it.
    pub get: fn(&VehicleParameters) -> f64,
    /// Writes it.
    pub set: fn(&mut VehicleParameters, f64),
}

impl FreeParameter {
    /// Geometric scale where the bounds are positive and span more than a factor of 3, else linear.
    fn is_geometric(&self) -> bool {
        self.low > 0.0 && self.high > 3.0 * self.low
    }

    /// The value at `x` on the scale from 0 to 1.
    fn unscaled(&self, x: f64) -> f64 {
        if self.is_geometric() {
            self.low * (self.high / self.low).powf(x)
        } else {
            self.low + x * (self.high - self.low)
        }
    }

    fn scaled(&self, value: f64) -> f64 {
        if self.is_geometric() {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }
}

/// How a calibration searches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationOptions {
    /// Levenberg–Marquardt iterations per start.
    pub max_iterations: usize,
    /// Number of starts; the first is the given vehicle, the others are drawn within the bounds around it.
    pub starts: usize,
    /// Spread of the drawn starts, as a share of the bounds' range.
    pub spread: f64,
    /// Seed of the drawn starts.
    pub seed: u64,
    /// Stop when the cost falls by less than this share in an iteration.
    pub tolerance: f64,
    /// Expected accuracy of quadrotor signals, m.
    pub quadrotor_m: f64,
    /// Expected accuracy of end-effector signals, m.
    pub end_effector_m: f64,
    /// Expected accuracy of height differences, m.
    pub height_m: f64,
    /// Weight of what is believed beforehand ([`prior`]), against 1 for a signal that is met as accurately as expected; 0 for
    /// none.
    pub prior_weight: f64,
}

impl Default for CalibrationOptions {
    fn default() -> Self {
        CalibrationOptions {
            max_iterations: 20,
            starts: 1,
            spread: 0.2,
            seed: 1,
            tolerance: 1e-3,
            quadrotor_m: 0.04,
            end_effector_m: 0.06,
            height_m: 0.06,
            prior_weight: 0.0,
        }
    }
}

/// What a calibration found.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The best parameters.
    pub parameters: VehicleParameters,
    /// Their cost.
    pub cost: f64,
    /// Iterations of the best start.
    pub iterations: usize,
    /// One per free parameter, in the given order.
    pub estimates: Vec<Estimate>,
}

/// One calibrated parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Its path in the vehicle's TOML.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its standard error, linearized at the solution; infinite if the data do not identify it.
    pub standard_error: f64,
    /// True if it ended at a bound.
    pub at_bound: bool,
}

/// A point of the search, with its residuals.
struct Point {
    /// Position on the 0 to 1 scales.
    x: DVector<f64>,
    residuals: DVector<f64>,
    cost: f64,
}

struct Problem<'a> {
    start: &'a VehicleParameters,
    free: &'a [FreeParameter],
    recordings: &'a [Recording],
    options: &'a CalibrationOptions,
    /// Ties between free parameters, by their places in `free`.
    ties: Vec<(usize, usize, prior::Tie)>,
}

/// Calibrates `free` of `start` on `recordings`. `progress` hears (start, iteration, cost). Returns `None` if
/// the given start itself cannot fly the recordings. The result does not depend on the number of threads.
pub fn calibrate(
    start: &VehicleParameters,
    free: &[FreeParameter],
    recordings: &[Recording],
    options: &CalibrationOptions,
    progress: &(dyn Fn(usize, usize, f64, &VehicleParameters) + Sync),
) -> Option<Calibration> {
    let place = |name: &str| free.iter().position(|parameter| parameter.name == name);
    let ties = prior::beam_ties()
        .into_iter()
        .filter_map(|tie| Some((place(&tie.first)?, place(&tie.second)?, tie)))
        .collect();
    let problem = Problem {
        start,
        free,
        recordings,
        options,
        ties,
    };
    let given = problem.scaled(start);
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let mut best: Option<(Point, DMatrix<f64>, usize)> = None;
    for index in 0..options.starts.max(1) {
        let mut x = given.clone();
        if index > 0 {
            for value in x.iter_mut() {
                *value = (*value + options.spread * (2.0 * random.random::<f64>() - 1.0)).clamp(0.0, 1.0);
            }
        }
        let Some(point) = problem.evaluate(x) else {
            continue;
        };
        let result = problem.minimize(point, &|iteration, point: &Point| {
            progress(index, iteration, point.cost, &problem.parameters(&point.x));
        });
        if best
            .as_ref()
            .is_none_or(|(point, _, _)| result.0.cost < point.cost)
        {
            best = Some(result);
        }
    }
    let (point, jacobian, iterations) = best?;
    Some(Calibration {
        parameters: problem.parameters(&point.x),
        cost: point.cost,
        iterations,
        estimates: problem.estimates(&point, &jacobian),
    })
}

impl Problem<'_> {
    fn scaled(&self, parameters: &VehicleParameters) -> DVector<f64> {
        DVector::from_iterator(
            self.free.len(),
            self.free
                .iter()
                .map(|parameter| parameter.scaled((parameter.get)(parameters)).clamp(0.0, 1.0)),
        )
    }

    fn parameters(&self, x: &DVector<f64>) -> VehicleParameters {
        let mut parameters = self.start.clone();
        for (parameter, x) in self.free.iter().zip(x.iter()) {
            (parameter.set)(&mut parameters, parameter.unscaled(*x));
        }
        parameters
    }

    /// Weighted residuals, those of the prior last; `None` if the vehicle is invalid or does not survive a flight.
    fn residuals(&self, x: &DVector<f64>) -> Option<DVector<f64>> {
        let vehicle = SimulatedVehicle::new(self.parameters(x)).ok()?;
        let all = self
            .recordings
            .par_iter()
            .map(|recording| {
                let trajectory = recording.fly(&mut vehicle.clone()).ok()?;
                let mut weighted = vec![];
                for difference in recording.differences(&trajectory) {
                    let sigma = match difference.signal {
                        Signal::Quadrotor => self.options.quadrotor_m,
                        Signal::EndEffector => self.options.end_effector_m,
                        Signal::Height => self.options.height_m,
                    };
                    let points = (difference.values.len() / difference.components).max(1) as f64;
                    let weight = 1.0 / (sigma * points.sqrt());
                    weighted.extend(difference.values.iter().map(|value| weight * value));
                }
                Some(weighted)
            })
            .collect::<Option<Vec<_>>>()?;
        let mut all = all.concat();
        all.extend(self.prior_residuals(x));
        all.iter().all(|r| r.is_finite()).then(|| DVector::from_vec(all))
    }

    fn evaluate(&self, x: DVector<f64>) -> Option<Point> {
        let residuals = self.residuals(&x)?;
        Some(Point {
            cost: residuals.norm_squared(),
            x,
            residuals,
        })
    }
}

#[cfg(test)]
mod tests;
