//! Many solves on all cores: batches of problems, and one problem from many starts.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{Dynamics, Options, Problem, ProblemError, Solution, Solver, Start, Status};

/// Solves every problem from its own guess, on the threads of rayon's pool. Results are in the problems' order, and
/// the same whatever the number of threads.
///
/// # Errors
/// Each result on its own: see [`ProblemError`].
pub fn solve_batch<D: Dynamics>(
    problems: &[(&Problem, &D)],
    options: &Options,
) -> Vec<Result<Solution, ProblemError>> {
    problems
        .par_iter()
        .map(|(problem, dynamics)| {
            let mut solver = Solver::new(problem, *dynamics, options.clone())?;
            Ok(solver.solve().clone())
        })
        .collect()
}

/// How [`multi_start`] looks around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MultiStart {
    /// Number of starts; the first is the problem's own guess.
    pub starts: usize,
    /// Largest deviation of the others from it, in the command's unit.
    pub spread: f64,
    /// Seed of the deviations.
    pub seed: u64,
}

/// The best of several local minima.
#[derive(Debug, Clone, PartialEq)]
pub struct BestOfMany {
    /// The converged solution of lowest cost, else the least violated one; the earlier start where they tie.
    pub best: Solution,
    /// Status and cost reached from every start.
    pub reached: Vec<(Status, f64)>,
}

/// Solves one problem from many starts, on the threads of rayon's pool: its guess, and smooth random deviations from
/// it. Swings have several local minima, and a local method finds the one whose valley it starts in.
///
/// # Errors
/// See [`ProblemError`].
pub fn multi_start<D: Dynamics + ?Sized>(
    problem: &Problem,
    dynamics: &D,
    options: &Options,
    search: MultiStart,
) -> Result<BestOfMany, ProblemError> {
    let solutions = (0..search.starts.max(1))
        .into_par_iter()
        .map(|start| {
            let mut solver = Solver::new(problem, dynamics, options.clone())?;
            let commands = deviate(problem, search, start);
            Ok(solver.solve_from(Start::Commands(&commands))?.clone())
        })
        .collect::<Result<Vec<Solution>, ProblemError>>()?;
    let reached = solutions
        .iter()
        .map(|solution| (solution.status, solution.cost))
        .collect();
    let key = |solution: &Solution| match solution.status {
        Status::Converged => (0, solution.cost + solution.soft_cost),
        _ => (1, solution.max_violation),
    };
    let best = solutions.into_iter().min_by(|a, b| {
        let ((class_a, value_a), (class_b, value_b)) = (key(a), key(b));
        class_a.cmp(&class_b).then(value_a.total_cmp(&value_b))
    });
    Ok(BestOfMany {
        best: best.expect("at least one start"),
        reached,
    })
}

/// The guess plus two slow random waves per entry of the command; start 0 is the guess itself.
fn deviate(problem: &Problem, search: MultiStart, start: usize) -> Vec<f64> {
    let (m, steps) = (problem.command_len(), problem.knots - 1);
    let mut commands = problem.command_guess.clone();
    if start == 0 {
        return commands;
    }
    let mut random = ChaCha8Rng::seed_from_u64(search.seed);
    random.set_stream(start as u64);
    for j in 0..m {
        for _ in 0..2 {
            let amplitude = 0.5 * search.spread * random.random_range(-1.0..=1.0);
            let waves = random.random_range(0.5..=3.0);
            let phase = random.random_range(0.0..std::f64::consts::TAU);
            for k in 0..steps {
                let angle = std::f64::consts::TAU * waves * k as f64 / steps as f64 + phase;
                commands[k * m + j] += amplitude * angle.sin();
            }
        }
    }
    commands
}
