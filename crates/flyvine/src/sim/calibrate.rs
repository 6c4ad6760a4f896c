//! Calibration: the vehicle's parameters by nonlinear least squares on replays of recorded flights.
//!
//! Minimizes `Σ_s (1/n_s) Σ_i (d_{s,i}/σ_s)²` over all signals s of all recordings, d the differences of
//! [`super::replay`] and σ_s the expected accuracy of that signal, within bounds, by Levenberg–Marquardt with
//! forward differences. Each free parameter is searched on a scale from 0 (its lower bound) to 1 (its upper).

use super::replay::{Recording, Signal};
use super::{SimulatedVehicle, VehicleParameters};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Residuals that are taken as one when standard errors are found: a second of a position.
const CLUSTER: usize = 60;

/// A parameter to be found.
#[derive(Clone, Copy)]
pub struct FreeParameter {
    /// Its path in the vehicle's TOML.
    pub name: &'static str,
    /// Lower bound, in the parameter's unit.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
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
    let problem = Problem {
        start,
        free,
        recordings,
        options,
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

    /// Weighted residuals; `None` if the vehicle is invalid or does not survive a flight.
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
        let all = all.concat();
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

    /// Forward differences, away from the nearer bound.
    fn jacobian(&self, point: &Point) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> = (0..self.free.len())
            .into_par_iter()
            .map(|j| {
                let step = self.free[j].difference * if point.x[j] > 0.5 { -1.0 } else { 1.0 };
                let mut x = point.x.clone();
                x[j] += step;
                match self.residuals(&x) {
                    Some(residuals) => (residuals - &point.residuals) / step,
                    None => DVector::zeros(point.residuals.len()),
                }
            })
            .collect();
        DMatrix::from_columns(&columns)
    }

    /// Levenberg–Marquardt with bounds: coordinates that sit at a bound and want out are held.
    fn minimize(&self, mut point: Point, progress: &dyn Fn(usize, &Point)) -> (Point, DMatrix<f64>, usize) {
        let mut damping = 1e-2;
        let mut jacobian = self.jacobian(&point);
        for iteration in 0..self.options.max_iterations {
            progress(iteration, &point);
            let before = point.cost;
            let gradient = jacobian.tr_mul(&point.residuals);
            let held: Vec<bool> = (0..point.x.len())
                .map(|j| (point.x[j] <= 0.0 && gradient[j] > 0.0) || (point.x[j] >= 1.0 && gradient[j] < 0.0))
                .collect();
            let normal = jacobian.tr_mul(&jacobian);
            let mut accepted = None;
            while accepted.is_none() && damping < 1e6 {
                // All damped steps of a ladder are tried at once.
                let ladder: Vec<f64> = (0..4).map(|k| damping * 8.0_f64.powi(k - 1)).collect();
                let trials: Vec<Option<Point>> = ladder
                    .par_iter()
                    .map(|damping| {
                        let mut matrix = normal.clone();
                        let mut rhs = -gradient.clone();
                        for j in 0..point.x.len() {
                            matrix[(j, j)] += damping * (normal[(j, j)] + 1e-3);
                            if held[j] {
                                matrix.row_mut(j).fill(0.0);
                                matrix.column_mut(j).fill(0.0);
                                matrix[(j, j)] = 1.0;
                                rhs[j] = 0.0;
                            }
                        }
                        let x = &point.x + matrix.cholesky()?.solve(&rhs);
                        self.evaluate(x.map(|v| v.clamp(0.0, 1.0)))
                    })
                    .collect();
                let best = trials
                    .into_iter()
                    .zip(&ladder)
                    .filter_map(|(trial, damping)| trial.map(|trial| (trial, *damping)))
                    .min_by(|(a, _), (b, _)| a.cost.total_cmp(&b.cost));
                match best {
                    Some((trial, used)) if trial.cost < point.cost => {
                        damping = (0.5 * used).max(1e-8);
                        accepted = Some(trial);
                    }
                    _ => damping *= 512.0,
                }
            }
            let Some(accepted) = accepted else {
                return (point, jacobian, iteration);
            };
            point = accepted;
            jacobian = self.jacobian(&point);
            if point.cost > (1.0 - self.options.tolerance) * before {
                return (point, jacobian, iteration + 1);
            }
        }
        (point, jacobian, self.options.max_iterations)
    }

    /// Standard errors from the covariance `N⁺ (Σ_c g_c g_cᵀ) N⁺`, with `N = JᵀJ` and `g_c = J_cᵀ r_c` summed over
    /// clusters c of neighbouring residuals, which are far from independent (Liang and Zeger, "Longitudinal data
    /// analysis using generalized linear models", Biometrika 1986). Directions that the data do not see
    /// (eigenvalue below 1e-6 of the greatest) make every parameter that they contain unidentified.
    fn estimates(&self, point: &Point, jacobian: &DMatrix<f64>) -> Vec<Estimate> {
        let free = self.free.len();
        let eigen = jacobian.tr_mul(jacobian).symmetric_eigen();
        let greatest = eigen.eigenvalues.max();
        let mut inverse = DMatrix::zeros(free, free);
        let mut unseen = vec![0.0; free];
        for (k, eigenvalue) in eigen.eigenvalues.iter().enumerate() {
            let direction = eigen.eigenvectors.column(k);
            if *eigenvalue > 1e-6 * greatest {
                inverse += direction * direction.transpose() / *eigenvalue;
            } else {
                for (unseen, component) in unseen.iter_mut().zip(&direction) {
                    *unseen += component * component;
                }
            }
        }
        let mut clusters = DMatrix::zeros(free, free);
        for first in (0..point.residuals.len()).step_by(CLUSTER) {
            let rows = CLUSTER.min(point.residuals.len() - first);
            let gradient = jacobian
                .rows(first, rows)
                .tr_mul(&point.residuals.rows(first, rows));
            clusters += &gradient * gradient.transpose();
        }
        let covariance = &inverse * clusters * &inverse;
        let estimate = |(j, parameter): (usize, &FreeParameter)| {
            let x = point.x[j];
            let slope = (parameter.unscaled(x + 1e-4) - parameter.unscaled(x - 1e-4)) / 2e-4;
            let on_scale = if unseen[j] > 1e-2 {
                f64::INFINITY
            } else {
                covariance[(j, j)].max(0.0).sqrt()
            };
            Estimate {
                name: parameter.name,
                value: parameter.unscaled(x),
                standard_error: slope * on_scale,
                at_bound: x <= 0.0 || x >= 1.0,
            }
        };
        self.free.iter().enumerate().map(estimate).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Configuration;
    use crate::sim::free;
    use crate::sim::replay::Measured;

    fn swing(parameters: &VehicleParameters) -> Recording {
        let configuration = Configuration {
            length_m: 0.7,
            pressure_kpa: 0.0,
        };
        let commands: Vec<[f64; 3]> = (0..60)
            .map(|k| [if k % 40 < 20 { 0.8 } else { -0.4 }, 0.0, 1.5])
            .collect();
        let mut recording = Recording {
            name: "made".to_owned(),
            configurations: vec![configuration; commands.len()],
            velocities: vec![[0.0; 3]; commands.len()],
            commands,
            measured: Measured::Rows {
                quadrotor: vec![],
                end_effector: vec![],
            },
        };
        let mut vehicle = SimulatedVehicle::new(parameters.clone()).expect("valid");
        let flown = recording.fly(&mut vehicle).expect("flies");
        recording.measured = Measured::Rows {
            quadrotor: flown.quadrotor.iter().map(|p| Some((*p).into())).collect(),
            end_effector: flown.end_effector.iter().map(|p| Some((*p).into())).collect(),
        };
        recording
    }

    fn named(names: &[&str]) -> Vec<FreeParameter> {
        free::all()
            .into_iter()
            .filter(|parameter| names.contains(&parameter.name))
            .collect()
    }

    #[test]
    fn finds_the_parameters_that_made_a_flight() {
        let truth = VehicleParameters::default();
        let mut start = truth.clone();
        start.autopilot.position.xy_p *= 1.2;
        start.arm.corners.empty_short.stiffness_n_m2 *= 0.7;
        let free = named(&[
            "autopilot.position.xy_p",
            "arm.corners.empty_short.stiffness_n_m2",
            "arm.corners.inflated_long.stiffness_n_m2",
        ]);
        let options = CalibrationOptions {
            tolerance: 1e-6,
            ..CalibrationOptions::default()
        };
        let found =
            calibrate(&start, &free, &[swing(&truth)], &options, &|_, _, _, _| ()).expect("the start flies");
        assert!(found.cost < 1e-4, "{}", found.cost);
        for estimate in &found.estimates[..2] {
            let parameter = named(&[estimate.name])[0];
            let expected = (parameter.get)(&truth);
            assert!(
                (estimate.value / expected - 1.0).abs() < 0.02,
                "{estimate:?}, expected {expected}"
            );
            assert!(estimate.standard_error < 0.1 * expected, "{estimate:?}");
        }
        // A short, empty arm's flight says nothing about the long, inflated one.
        assert!(
            found.estimates[2].standard_error.is_infinite(),
            "{:?}",
            found.estimates[2]
        );
    }

    #[test]
    fn default_lies_within_the_bounds() {
        let parameters = VehicleParameters::default();
        for free in free::all() {
            let value = (free.get)(&parameters);
            assert!(
                (free.low - 1e-12..=free.high * (1.0 + 1e-3)).contains(&value),
                "{} = {value}",
                free.name
            );
            let mut changed = parameters.clone();
            (free.set)(&mut changed, free.low);
            assert_eq!((free.get)(&changed), free.low, "{}", free.name);
        }
    }
}
