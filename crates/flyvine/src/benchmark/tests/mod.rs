//! The shipped problems to their known optima.

mod check;
mod constraints;
mod files;
mod starts;

pub(super) use check::verify;

use super::{BenchmarkProblem, Dense, read_problem};
use crate::trajopt::{Dynamics, Options, Solution, Solver, Status};
use check::gradient;
use std::path::PathBuf;

pub(super) fn problem_path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../bench/problems")
        .join(format!("{name}.json"))
}

fn read(name: &str) -> BenchmarkProblem {
    read_problem(&problem_path(name)).expect("the shipped problems are valid")
}

fn solve(name: &str) -> Solution {
    let benchmark = read(name);
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
    solver.solve().clone()
}

/// Converged to `cost` within 1e-6 relative, violation within 1e-8, and in no more iterations than it took when
/// this was written: slower convergence fails here.
fn assert_optimum(name: &str, cost: f64, max_iterations: usize) {
    let solution = solve(name);
    verify(name, &read(name), &solution);
    assert_eq!(solution.status, Status::Converged, "{name}");
    assert!(
        (solution.cost - cost).abs() <= 1e-6 * cost,
        "{name}: J = {}",
        solution.cost
    );
    assert!(
        solution.max_violation <= 1e-8,
        "{name}: violation {}",
        solution.max_violation
    );
    assert!(
        solution.stationarity <= 1e-6,
        "{name}: stationarity {}",
        solution.stationarity
    );
    assert!(
        solution.iterations <= max_iterations,
        "{name}: {} iterations",
        solution.iterations
    );
}

#[test]
fn lemniscates_reach_the_known_optima() {
    assert_optimum("lem10_ES", 8.572568, 4);
    assert_optimum("lem5_ES", 39.05654, 4);
    assert_optimum("lem10_IL", 10.86917, 4);
    assert_optimum("lem5_EL", 42.28083, 4);
}

#[test]
fn deployment_reaches_the_known_optimum() {
    assert_optimum("grow", 15.40063, 5);
}

#[test]
fn swings_reach_the_best_known_optima() {
    assert_optimum("kick_ES", 887.2412, 19);
    assert_optimum("kick_IS", 851.94358, 18);
    assert_optimum("kick_EL", 1084.7346, 54);
}

#[test]
fn convex_problems_reach_their_optima() {
    assert_optimum("linlem5_ES", 38.8183919, 1);
    assert_optimum("linkick_ES", 870.5007208, 13);
}

#[test]
fn dense_dynamics_give_the_same_solution() {
    for name in ["lem5_ES", "kick_ES"] {
        let benchmark = read(name);
        let dense = Dense(&benchmark.dynamics);
        let mut solver = Solver::new(&benchmark.problem, &dense, Options::default()).expect("valid");
        let (dense, structured) = (solver.solve(), solve(name));
        assert_eq!(dense.status, Status::Converged);
        assert_eq!(dense.iterations, structured.iterations);
        for (a, b) in dense.commands.iter().zip(&structured.commands) {
            assert!((a - b).abs() < 1e-6, "{name}: {a} and {b}");
        }
    }
}

/// The same dynamics without second derivatives.
struct WithoutCurvature<'a, D>(&'a D);

impl<D: Dynamics> Dynamics for WithoutCurvature<'_, D> {
    fn state_len(&self) -> usize {
        self.0.state_len()
    }

    fn command_len(&self) -> usize {
        self.0.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.0.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.0.step(knot, state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.0.linearize(knot, z, u, fresh, jacobian);
    }
}

/// Where a model gives no curvature it is estimated well enough for swings, whose multipliers are large.
#[test]
fn models_without_curvature_reach_the_same_optima() {
    for (name, cost, most_iterations) in [("lem5_ES", 39.05654, 10), ("kick_ES", 887.2412, 100)] {
        let benchmark = read(name);
        let hidden = WithoutCurvature(&benchmark.dynamics);
        let mut solver = Solver::new(&benchmark.problem, &hidden, Options::default()).expect("valid");
        let solution = solver.solve();
        assert_eq!(solution.status, Status::Converged, "{name}");
        verify(name, &benchmark, solution);
        assert!(
            (solution.cost - cost).abs() <= 1e-6 * cost,
            "{name}: {}",
            solution.cost
        );
        assert!(
            solution.iterations <= most_iterations,
            "{name}: {}",
            solution.iterations
        );
    }
}

/// The adjoint recursion that the checks above rely on, against central differences of the solver's cost.
#[test]
fn reduced_gradient_matches_finite_differences() {
    let mut benchmark = read("grow");
    let commands = benchmark.problem.command_guess.clone();
    let m = benchmark.problem.command_len();
    for (k, j) in [(3, 0), (120, 1), (250, 2), (390, 0)] {
        let mut cost = |offset: f64| {
            let mut moved = commands.clone();
            moved[k * m + j] += offset;
            benchmark.problem.command_guess = moved;
            let options = Options {
                max_iterations: 0,
                ..Options::default()
            };
            let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, options).expect("valid");
            solver.solve().clone()
        };
        let difference = (cost(1e-4).cost - cost(-1e-4).cost) / 2e-4;
        let solution = cost(0.0);
        let gradient = gradient(&benchmark, &solution)[k * m + j];
        assert!(
            (gradient - difference).abs() <= 1e-6 * (1.0 + difference.abs()),
            "{gradient} against {difference}"
        );
    }
}
