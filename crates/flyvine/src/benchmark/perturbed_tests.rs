//! Shipped problems with starts, targets, bounds, references and models disturbed at random: the solver converges, or
//! says truthfully why not, and never leaves the finite numbers.

use super::tests::{problem_path, verify};
use super::{BenchmarkProblem, parse_problem};
use crate::trajopt::{Options, Solver, Status};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

const NAMES: [&str; 6] = [
    "kick_ES",
    "kick_IS",
    "kick_EL",
    "linkick_ES",
    "lem5_ES",
    "lem5_EL",
];

/// Adds a uniform `±amount` to every number below `value`.
fn disturb(value: &mut Value, amount: f64, random: &mut ChaCha8Rng) {
    match value {
        Value::Number(number) => {
            *value = (number.as_f64().expect("a double") + random.random_range(-amount..=amount)).into();
        }
        Value::Array(items) => items.iter_mut().for_each(|item| disturb(item, amount, random)),
        _ => {}
    }
}

/// Multiplies every number below `value` by a uniform `1 ± share`.
fn scale(value: &mut Value, share: f64, random: &mut ChaCha8Rng) {
    match value {
        Value::Number(number) => {
            *value =
                (number.as_f64().expect("a double") * random.random_range(1.0 - share..=1.0 + share)).into();
        }
        Value::Array(items) => items.iter_mut().for_each(|item| scale(item, share, random)),
        _ => {}
    }
}

fn disturbed(text: &str, random: &mut ChaCha8Rng) -> BenchmarkProblem {
    let mut json: Value = serde_json::from_str(text).expect("shipped");
    disturb(&mut json["z0"], 0.005, random);
    disturb(&mut json["uref"], 0.1, random);
    disturb(&mut json["u_init"], 0.1, random);
    // The models' quadratic coefficients are large and nearly cancel; more noise makes most of them run away.
    for (part, share) in [
        ("/A", 5e-4),
        ("/B", 5e-4),
        ("/height/lin", 1e-5),
        ("/height/quad", 1e-5),
    ] {
        scale(
            json["models"][0].pointer_mut(part).expect("exists"),
            share,
            random,
        );
    }
    // The target moves as a whole: its two knots also fix the velocity.
    let shift = [6, 8].map(|index| (index, random.random_range(-0.1..=0.1)));
    for equality in json["equalities"].as_array_mut().expect("a list") {
        let moved = shift
            .iter()
            .find(|(index, _)| equality["idx"] == *index)
            .map_or(0.0, |(_, by)| *by);
        equality["value"] = (equality["value"].as_f64().expect("a double") + moved).into();
    }
    for bound in json["state_bounds"].as_array_mut().expect("a list") {
        disturb(&mut bound["hi"], 0.02, random);
    }
    for bounds in ["umin", "umax"] {
        disturb(&mut json[bounds], 0.04, random);
    }
    parse_problem(&json.to_string()).expect("still valid")
}

/// Solves `count` disturbed problems; returns how many converged.
fn campaign(count: usize) -> usize {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let texts = NAMES.map(|name| std::fs::read_to_string(problem_path(name)).expect("shipped"));
    let mut statuses = std::collections::BTreeMap::new();
    for case in 0..count {
        let benchmark = disturbed(&texts[case % texts.len()], &mut random);
        let mut solver =
            Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
        let solution = solver.solve();
        *statuses.entry(solution.status.name()).or_insert(0) += 1;
        verify(&format!("case {case}"), &benchmark, solution);
        if solution.status == Status::ProbablyInfeasible {
            let tolerance = Options::default().violation_tolerance;
            assert!(
                !solution.diagnosis(tolerance).is_empty(),
                "case {case}: infeasible, yet nothing is violated"
            );
        }
    }
    assert_eq!(statuses.values().sum::<usize>(), count, "{statuses:?}");
    statuses.remove(Status::Converged.name()).unwrap_or(0)
}

#[test]
fn a_hundred_disturbed_problems_converge_or_are_diagnosed() {
    assert!(campaign(100) >= 95);
}

/// `cargo test --release -p flyvine disturbed -- --ignored`
#[test]
#[ignore = "a minute; run before releases"]
fn a_thousand_disturbed_problems_converge_or_are_diagnosed() {
    assert!(campaign(1000) >= 950);
}
