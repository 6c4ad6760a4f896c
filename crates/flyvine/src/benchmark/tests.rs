//! The shipped problems to their known optima.

use super::{BenchmarkError, BenchmarkProblem, parse_problem, read_problem};
use crate::trajopt::{Options, Solution, Solver, Status};
use std::path::PathBuf;

fn problem_path(name: &str) -> PathBuf {
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
    assert_optimum("lem10_ES", 8.57257, 4);
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
    assert_optimum("kick_ES", 887.2412, 60);
    assert_optimum("kick_IS", 851.94358, 60);
    assert_optimum("kick_EL", 1084.7346, 200);
}

#[test]
fn convex_problems_reach_their_optima() {
    assert_optimum("linlem5_ES", 38.8183919, 1);
    assert_optimum("linkick_ES", 870.5007208, 20);
}

#[test]
fn repeated_solves_are_bitwise_equal() {
    let benchmark = read("kick_ES");
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
    let first = solver.solve().clone();
    assert_eq!(&first, solver.solve());
}

/// The document with the value at `pointer` replaced.
fn with(document: &str, pointer: &str, value: serde_json::Value) -> String {
    let mut json: serde_json::Value = serde_json::from_str(document).expect("valid");
    *json.pointer_mut(pointer).expect("exists") = value;
    json.to_string()
}

#[test]
fn broken_files_are_refused_by_name() {
    let text = std::fs::read_to_string(problem_path("kick_ES")).expect("shipped");
    let null = serde_json::Value::Null;
    for (broken, place) in [
        (with(&text, "/zref/3/5", null.clone()), "zref[3][5]: found null"),
        (
            with(&text, "/N", 51.into()),
            "zref: found a list of 50, expected a list of 51",
        ),
        (with(&text, "/N", 1.into()), "at least 2 knots"),
        (
            with(&text, "/umin/0", 9.0.into()),
            "command bounds[0]: found the interval [9, 2]",
        ),
        (
            with(&text, "/equalities/0/k", 77.into()),
            "equalities[0]: found knots 77..=77",
        ),
        (
            with(&text, "/equalities/0/idx", 27.into()),
            "equalities[0]: found state index 27",
        ),
        (
            with(&text, "/state_bounds/0/k1", 50.into()),
            "state_bounds[0]: found knots 1..=50",
        ),
        (
            with(&text, "/state_bounds/0/k0", 0.into()).replace("1.02", "-0.5"),
            "state_bounds[0]: the start",
        ),
        (with(&text, "/R/1", (-1.0).into()), "command_weight[1]: found -1"),
        (
            with(&text, "/models/0/A/8", null.clone()),
            "models[0].A[8]: found null",
        ),
        (
            with(&text, "/models", serde_json::json!([])),
            "models: found a list of 0",
        ),
        (text.replace("\"schedule\"", "\"other\""), "schedule: missing"),
        (text[..text.len() / 2].to_string(), "not JSON"),
        (text.replacen("0.0", "NaN", 1), "not JSON"),
    ] {
        let message = parse_problem(&broken).expect_err(place).to_string();
        assert!(message.contains(place), "{message:?} should contain {place:?}");
    }
    let missing = read_problem(&problem_path("absent")).expect_err("no such file");
    assert!(matches!(missing, BenchmarkError::Io { .. }));
}
