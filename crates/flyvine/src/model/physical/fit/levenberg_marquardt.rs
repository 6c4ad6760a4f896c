//! Levenberg–Marquardt with bounds, over the coordinates of the parameters.

use super::super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters, Scale};
use super::problem::{Problem, Quadratic};
use nalgebra::DVector;

/// Relative decrease below which the minimum is reached.
const TOLERANCE: f64 = 5e-4;
/// Damped steps tried per iteration.
const MAX_TRIALS: usize = 8;
/// Longest step per parameter and iteration: of a logarithm.
const LONGEST_LOG_STEP: f64 = 0.7;
/// Of a linear parameter, and the share of its prior's deviation that it may in any case go.
const LONGEST_STEP: (f64, f64) = (0.1, 0.3);

/// Where and how a minimization ended.
pub struct Minimum {
    /// The best parameters, one set per configuration.
    pub parameters: Vec<Parameters<f64>>,
    /// The objective there.
    pub value: f64,
    /// Mean distance of the simulated end effector from where it was seen, m.
    pub tip_error_m: f64,
    /// It decreased by less than the tolerance in the last iteration.
    pub converged: bool,
    /// Iterations done.
    pub iterations: usize,
}

/// Minimizes `problem` from `start`; held parameters stay, the others stay within their bounds. `progress` is
/// called after every iteration.
///
/// Each iteration solves `(H + λ diag H) δ = −g` over the parameters that no bound stops and tries the step,
/// with λ a fifth after a success and five times after a failure.
pub fn minimize(
    problem: &Problem,
    start: Vec<Parameters<f64>>,
    max_iterations: usize,
    progress: &mut dyn FnMut(&Minimum),
) -> Minimum {
    let (value, simulated) = problem.value(&start);
    let mut best = Minimum {
        parameters: start,
        value,
        tip_error_m: simulated.tip_error_m(),
        converged: false,
        iterations: 0,
    };
    let mut damping = 1e-2;
    while best.iterations < max_iterations && best.value.is_finite() {
        let before = best.value;
        let quadratic = problem.quadratic(&best.parameters);
        for _ in 0..MAX_TRIALS {
            if let Some(parameters) = damped_step(problem, &quadratic, &best.parameters, damping) {
                let (value, simulated) = problem.value(&parameters);
                if value < best.value {
                    best = Minimum {
                        parameters,
                        value,
                        tip_error_m: simulated.tip_error_m(),
                        ..best
                    };
                    damping = (0.2 * damping).max(1e-7);
                    break;
                }
            }
            damping *= 5.0;
        }
        best.iterations += 1;
        best.converged = before - best.value <= TOLERANCE * before;
        progress(&best);
        if best.converged {
            break;
        }
    }
    best
}

/// The parameters after one damped step; `None` if the equations are singular.
fn damped_step(
    problem: &Problem,
    quadratic: &Quadratic,
    parameters: &[Parameters<f64>],
    damping: f64,
) -> Option<Vec<Parameters<f64>>> {
    let (mut hessian, mut gradient) = (quadratic.hessian.clone(), quadratic.gradient.clone());
    let values: Vec<f64> = parameters.iter().flat_map(|own| own.to_array()).collect();
    for (entry, &value) in values.iter().enumerate() {
        let info = &PARAMETERS[entry % PARAMETER_COUNT];
        let stopped_below = value <= info.lower && gradient[entry] > 0.0;
        let stopped_above = value >= info.upper && gradient[entry] < 0.0;
        if stopped_below || stopped_above || problem.held.contains(&info.name) {
            hessian.row_mut(entry).fill(0.0);
            hessian.column_mut(entry).fill(0.0);
            hessian[(entry, entry)] = 1.0;
            gradient[entry] = 0.0;
        }
        hessian[(entry, entry)] *= 1.0 + damping;
    }
    let step: DVector<f64> = -hessian.cholesky()?.solve(&gradient);
    let moved = |(number, own): (usize, &Parameters<f64>)| {
        let mut coordinates = own.coordinates();
        for (i, info) in PARAMETERS.iter().enumerate() {
            let longest = match info.scale {
                Scale::Log | Scale::Beam => LONGEST_LOG_STEP,
                Scale::Linear => LONGEST_STEP.0.max(LONGEST_STEP.1 * info.prior_sigma),
            };
            coordinates[i] += step[number * PARAMETER_COUNT + i].clamp(-longest, longest);
        }
        Parameters::from_coordinates(coordinates)
    };
    Some(parameters.iter().enumerate().map(moved).collect())
}
