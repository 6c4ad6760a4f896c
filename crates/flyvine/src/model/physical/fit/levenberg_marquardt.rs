//! Levenberg–Marquardt with bounds, over the coordinates of the parameters.

use super::super::parameters::{PARAMETERS, Parameters, Scale};
use super::residual::{Column, NormalEquations, Objective};

/// Relative decrease below which the minimum is reached.
const TOLERANCE: f64 = 1e-3;
/// Damped steps tried per iteration.
const MAX_TRIALS: usize = 8;
/// Longest step per parameter and iteration: of a logarithm, of a linear parameter.
const LONGEST_STEP: (f64, f64) = (0.7, 0.1);

/// Where and how a minimization ended.
pub struct Minimum {
    /// The best parameters.
    pub parameters: Parameters<f64>,
    /// The objective there.
    pub value: f64,
    /// It decreased by less than the tolerance in the last iteration.
    pub converged: bool,
    /// Iterations done.
    pub iterations: usize,
}

/// Minimizes `objective` from `start`; parameters in `held` stay, the others stay within their bounds.
///
/// Each iteration solves `(H + λ diag H) δ = −g` over the parameters that no bound stops and tries the step,
/// with λ a fifth after a success and five times after a failure.
pub fn minimize(
    objective: &Objective,
    start: &Parameters<f64>,
    held: &[&str],
    max_iterations: usize,
    progress: &mut dyn FnMut(usize, f64),
) -> Minimum {
    let mut best = Minimum {
        parameters: *start,
        value: objective.value(start),
        converged: false,
        iterations: 0,
    };
    let mut damping = 1e-2;
    while best.iterations < max_iterations && best.value.is_finite() {
        let before = best.value;
        let equations = objective.normal_equations(&best.parameters);
        for _ in 0..MAX_TRIALS {
            let candidate = damped_step(&equations, &best.parameters, held, damping);
            let value = candidate.map_or(f64::INFINITY, |parameters| objective.value(&parameters));
            if let (true, Some(parameters)) = (value < best.value, candidate) {
                best.parameters = parameters;
                best.value = value;
                damping = (0.2 * damping).max(1e-7);
                break;
            }
            damping *= 5.0;
        }
        best.iterations += 1;
        progress(best.iterations, best.value);
        if before - best.value <= TOLERANCE * before {
            best.converged = true;
            break;
        }
    }
    best
}

/// The parameters after one damped step; `None` if the equations are singular.
fn damped_step(
    equations: &NormalEquations,
    parameters: &Parameters<f64>,
    held: &[&str],
    damping: f64,
) -> Option<Parameters<f64>> {
    let values = parameters.to_array();
    let mut hessian = equations.hessian;
    let mut gradient = equations.gradient;
    for (i, info) in PARAMETERS.iter().enumerate() {
        let stopped_below = values[i] <= info.lower && gradient[i] > 0.0;
        let stopped_above = values[i] >= info.upper && gradient[i] < 0.0;
        if stopped_below || stopped_above || held.contains(&info.name) {
            hessian.row_mut(i).fill(0.0);
            hessian.column_mut(i).fill(0.0);
            hessian[(i, i)] = 1.0;
            gradient[i] = 0.0;
        }
        hessian[(i, i)] *= 1.0 + damping;
    }
    let step: Column = -hessian.cholesky()?.solve(&gradient);
    let mut coordinates = parameters.coordinates();
    for (i, info) in PARAMETERS.iter().enumerate() {
        let longest = match info.scale {
            Scale::Log => LONGEST_STEP.0,
            Scale::Linear => LONGEST_STEP.1,
        };
        coordinates[i] += step[i].clamp(-longest, longest);
    }
    Some(Parameters::from_coordinates(coordinates))
}
