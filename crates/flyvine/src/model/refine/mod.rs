//! Multi-step refinement: a least-squares model improved on what matters to a plan, its rollouts.
//!
//! One-step least squares weighs every sample alike and is biased by noise in the lagged states; over fifty
//! steps small biases add up. Here the linear coefficients (and the offsets of the rows that have them) minimize the
//! simulation error over 2.5-s windows,
//!
//! ```text
//! Σ_windows Σ_steps Σ_signals weight · ρ(x̂ − x)² + strength · steps · Σ_j (rms_j (θ_j − θ_LS,j))²
//! ```
//!
//! by Levenberg–Marquardt. The sensitivities are analytic: with `S_k = ∂z_k/∂θ`, the fresh rows of `S_{k+1}`
//! are `J_z S_k + ∂f/∂θ`, the others are shifted. ρ is Huber's on the end-effector error, so that no window
//! that the model cannot explain rules the fit.

mod parameters;
mod simulation;

pub(crate) use self::simulation::Stretch;

use self::parameters::Parameters;
use self::simulation::{COMPARE_EVERY, HORIZON, NormalEquations, Window, simulation_cost, windows};
use super::lag::{LagModel, STATE_LEN};
use super::options::Positions;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Strength of the pull towards least squares.
const STRENGTH: f64 = 1e-5;
/// Most Levenberg–Marquardt iterations.
const MAX_ITERATIONS: usize = 6;
/// Relative improvement at which it stops.
const ENOUGH: f64 = 1e-2;

/// Refines `model` on windows inside `stretches`; `None` if no window fits in them. A model of relative positions stays
/// one.
pub(crate) fn refine(model: &LagModel, positions: Positions, stretches: &[Stretch]) -> Option<LagModel> {
    let windows = windows(model.lags(), stretches);
    if windows.is_empty() {
        return None;
    }
    let parameters = Parameters::of(model, positions);
    let pull = pull(&parameters, &windows);
    let penalty = |moves: &[f64]| -> f64 { moves.iter().zip(&pull).map(|(m, pull)| pull * m * m).sum() };
    let mut best = vec![0.0; parameters.len()];
    let mut system = NormalEquations::of(model, &parameters, &windows);
    let mut cost = system.cost;
    let mut damping = 1e-3;
    for _ in 0..MAX_ITERATIONS {
        let mut accepted = None;
        while accepted.is_none() && damping < 1e6 {
            let trial = stepped(&best, &system, &pull, damping)?;
            let trial_cost = simulation_cost(&parameters.moved(model, &trial)?, &windows) + penalty(&trial);
            if trial_cost < cost {
                accepted = Some((trial, trial_cost));
                damping *= 0.1;
            } else {
                damping *= 10.0;
            }
        }
        let Some((trial, trial_cost)) = accepted else {
            break;
        };
        let settled = trial_cost > (1.0 - ENOUGH) * cost;
        (best, cost) = (trial, trial_cost);
        if settled {
            break;
        }
        system = NormalEquations::of(&parameters.moved(model, &best)?, &parameters, &windows);
    }
    parameters.moved(model, &best)
}

/// Pull towards least squares per parameter: strength · steps · mean square of its regressor.
fn pull(parameters: &Parameters, windows: &[Window]) -> Vec<f64> {
    let mut regressors = vec![0.0; parameters.regressors()];
    let mut squares = vec![0.0; parameters.regressors()];
    for window in windows {
        parameters.write_regressors(&window.regressor(), &mut regressors);
        for (sum, value) in squares.iter_mut().zip(&regressors) {
            *sum += value * value;
        }
    }
    let compared = (HORIZON / COMPARE_EVERY) as f64;
    let mut pull: Vec<f64> = squares
        .repeat(STATE_LEN)
        .into_iter()
        .map(|square| STRENGTH * compared * square)
        .collect();
    pull.resize(parameters.len(), STRENGTH * compared * windows.len() as f64);
    pull
}

/// The Levenberg–Marquardt step `(N + P + damping · diag N) δ = −(g + P m)` from the moves m = θ − θ_LS; `None` if the
/// matrix is not positive definite.
fn stepped(moves: &[f64], system: &NormalEquations, pull: &[f64], damping: f64) -> Option<Vec<f64>> {
    let mut matrix = system.matrix.clone();
    for (j, pull) in pull.iter().enumerate() {
        matrix[(j, j)] += pull + damping * system.matrix[(j, j)];
    }
    let right = Mat::from_fn(pull.len(), 1, |j, _| -(system.gradient[j] + pull[j] * moves[j]));
    let step = matrix.llt(Side::Lower).ok()?.solve(right);
    let sum = moves.iter().zip(step.col_as_slice(0)).map(|(m, step)| m + step);
    Some(sum.collect())
}

#[cfg(test)]
mod tests {
    use super::super::fit::tests::{ES, flight, system};
    use super::super::lag::CommandInputs;
    use super::super::track::Track;
    use super::*;

    /// `model` with every parameter moved a little, so that rollouts err by centimetres.
    fn disturbed(model: &LagModel, positions: Positions) -> LagModel {
        let parameters = Parameters::of(model, positions);
        let move_of = |index: usize| 1e-3 * (0.7 * index as f64).sin();
        let moves: Vec<f64> = (0..parameters.len()).map(move_of).collect();
        parameters.moved(model, &moves).unwrap()
    }

    #[test]
    fn the_gradient_is_that_of_the_simulation_error() {
        let recording = flight("a", ES, 120, 1, 0.0);
        let track = Track::new(&recording, CommandInputs::Position).unwrap();
        for positions in [Positions::Absolute, Positions::Relative] {
            let model = disturbed(&system(), positions);
            let windows = windows(model.lags(), &[(&track, 0..track.rows())]);
            assert_eq!(windows.len(), 2);
            let parameters = Parameters::of(&model, positions);
            let system = NormalEquations::of(&model, &parameters, &windows);
            assert_eq!(system.cost, simulation_cost(&model, &windows));
            // Where no error is beyond Huber's corner, the cost is a sum of squares: ∂cost/∂θ = 2 Sᵀ W r.
            let cost_at = |index: usize, step: f64| {
                let mut moves = vec![0.0; parameters.len()];
                moves[index] = step;
                simulation_cost(&parameters.moved(&model, &moves).unwrap(), &windows)
            };
            let largest = system.gradient.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            for index in (0..parameters.len()).step_by(7).chain([parameters.len() - 1]) {
                let step = 1e-6;
                let difference = (cost_at(index, step) - cost_at(index, -step)) / (2.0 * step);
                let analytic = 2.0 * system.gradient[index];
                assert!(
                    (difference - analytic).abs() < 1e-6 * largest.max(analytic.abs()),
                    "{positions:?}, parameter {index}: {analytic} against {difference}"
                );
            }
        }
    }

    #[test]
    fn a_disturbed_model_finds_its_way_back() {
        let recordings = [flight("a", ES, 400, 2, 0.0), flight("b", ES, 200, 3, 0.0)];
        let tracks = recordings
            .each_ref()
            .map(|recording| Track::new(recording, CommandInputs::Position).unwrap());
        let kept = [(&tracks[0], 0..tracks[0].rows())];
        let model = disturbed(&system(), Positions::Absolute);
        let refined = refine(&model, Positions::Absolute, &kept).unwrap();
        // On the flight that it has not seen.
        let unseen = windows(3, &[(&tracks[1], 0..tracks[1].rows())]);
        let (before, after) = (
            simulation_cost(&model, &unseen),
            simulation_cost(&refined, &unseen),
        );
        assert!(after < 0.05 * before, "{before} → {after}");
        let short = [(&tracks[0], 0..40)];
        assert!(
            refine(&model, Positions::Absolute, &short).is_none(),
            "no window fits"
        );
    }
}
