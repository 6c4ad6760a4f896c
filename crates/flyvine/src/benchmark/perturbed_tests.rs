//! Shipped problems with starts, targets, bounds, references and models disturbed at random: the solver converges, or
//! says truthfully why not, and never leaves the finite numbers.

#![allow(clippy::print_stdout)] // a tally for people

use super::tests::{problem_path, verify};
use super::{BenchmarkProblem, parse_problem};
use crate::trajopt::{
    ConstraintSource, Dynamics, Equality, Options, Problem, Solution, Solver, StateBound, Status, Violation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::collections::BTreeMap;

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

/// How much of the models is noise, as a share of each coefficient.
#[derive(Debug, Clone, Copy)]
struct ModelNoise {
    linear: f64,
    /// The height row's coefficients are large and nearly cancel, so that noise makes many of its models run away.
    height: f64,
}

const MILD: ModelNoise = ModelNoise {
    linear: 5e-4,
    height: 1e-5,
};
const STRONG: ModelNoise = ModelNoise {
    linear: 2e-3,
    height: 1e-3,
};

fn scale_model(json: &mut Value, noise: ModelNoise, random: &mut ChaCha8Rng) {
    for (part, share) in [
        ("/A", noise.linear),
        ("/B", noise.linear),
        ("/height/lin", noise.height),
        ("/height/quad", noise.height),
    ] {
        scale(
            json["models"][0].pointer_mut(part).expect("exists"),
            share,
            random,
        );
    }
}

fn disturbed(text: &str, noise: ModelNoise, random: &mut ChaCha8Rng) -> BenchmarkProblem {
    let mut json: Value = serde_json::from_str(text).expect("shipped");
    disturb(&mut json["z0"], 0.005, random);
    disturb(&mut json["uref"], 0.1, random);
    disturb(&mut json["u_init"], 0.1, random);
    scale_model(&mut json, noise, random);
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

/// Solves `count` disturbed problems, half of them with strong noise; returns how many of the others converged.
fn campaign(count: usize) -> usize {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let texts = NAMES.map(|name| std::fs::read_to_string(problem_path(name)).expect("shipped"));
    let mut statuses = [BTreeMap::new(), BTreeMap::new()];
    for case in 0..count {
        let strong = case % 2;
        let noise = [MILD, STRONG][strong];
        let benchmark = disturbed(&texts[case / 2 % texts.len()], noise, &mut random);
        let mut solver =
            Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
        let solution = solver.solve().clone();
        *statuses[strong].entry(solution.status.name()).or_insert(0) += 1;
        verify(&format!("case {case}"), &benchmark, &solution);
        verify_diagnosis(&format!("case {case}"), &benchmark, &solution);
    }
    println!("mild noise: {:?}\nstrong noise: {:?}", statuses[0], statuses[1]);
    statuses[0].get(Status::Converged.name()).copied().unwrap_or(0)
}

/// What is not converged says why, and the reason stands up: where constraints are violated, the answer satisfies a
/// problem in which they are relaxed as the diagnosis says; where none is, the cost is not stationary; where a rollout
/// diverges, it does.
fn verify_diagnosis(case: &str, benchmark: &BenchmarkProblem, solution: &Solution) {
    let problem = &benchmark.problem;
    match solution.status {
        Status::Converged => {}
        Status::GuessDiverges { knot } => assert!(diverges(benchmark, knot), "{case}: the guess is finite"),
        status => {
            let diagnosis = solution.diagnosis(Options::default().violation_tolerance);
            // Nothing violated: then what is missing is optimality, and the answer says by how much.
            assert!(
                !diagnosis.is_empty() || solution.stationarity > Options::default().stationarity_tolerance,
                "{case}: {status:?}, yet nothing is violated and the cost is stationary"
            );
            let n = problem.state_len();
            let relaxed = relax(problem, &diagnosis);
            for StateBound {
                first_knot,
                last_knot,
                index,
                lower,
                upper,
                ..
            } in relaxed.state_bounds
            {
                for knot in first_knot..=last_knot {
                    let value = solution.states[knot * n + index];
                    assert!(
                        (lower - 1e-8..=upper + 1e-8).contains(&value),
                        "{case}: relaxed in vain"
                    );
                }
            }
            for Equality {
                knot, index, value, ..
            } in relaxed.equalities
            {
                let distance = (solution.states[knot * n + index] - value).abs();
                assert!(distance <= 1e-8, "{case}: relaxed in vain");
            }
        }
    }
}

/// The problem with every named constraint relaxed by a little more than its violation.
fn relax(problem: &Problem, diagnosis: &[Violation]) -> Problem {
    let mut relaxed = problem.clone();
    for violation in diagnosis {
        let by = violation.violation;
        match violation.source {
            ConstraintSource::StateBound(i) => {
                relaxed.state_bounds[i].lower -= by;
                relaxed.state_bounds[i].upper += by;
            }
            ConstraintSource::Equality(i) => {
                let Equality {
                    knot, index, value, ..
                } = problem.equalities[i];
                relaxed.state_bounds.push(StateBound {
                    first_knot: knot,
                    last_knot: knot,
                    index,
                    lower: value - by,
                    upper: value + by,
                    price: f64::INFINITY,
                });
            }
        }
    }
    let named = |i: &usize| {
        let source = ConstraintSource::Equality(*i);
        diagnosis.iter().any(|violation| violation.source == source)
    };
    let mut position = 0..;
    relaxed
        .equalities
        .retain(|_| !named(&position.next().expect("endless")));
    relaxed
}

/// Whether the rollout of the command guess leaves the finite numbers, or all reason, by `knot`.
fn diverges(benchmark: &BenchmarkProblem, knot: usize) -> bool {
    let BenchmarkProblem {
        problem, dynamics, ..
    } = benchmark;
    let (n, m, fresh) = (problem.state_len(), problem.command_len(), dynamics.fresh_len());
    let mut state = problem.start.clone();
    for k in 0..knot {
        let command: Vec<f64> = (0..m)
            .map(|j| {
                problem.command_guess[k * m + j].clamp(problem.command_lower[j], problem.command_upper[j])
            })
            .collect();
        let mut next = vec![0.0; n];
        dynamics.step(k, &state, &command, &mut next[..fresh]);
        next[fresh..].copy_from_slice(&state[..n - fresh]);
        state = next;
    }
    !state.iter().all(|entry| entry.abs() < 1e100)
}

#[test]
fn disturbed_problems_converge_or_are_diagnosed() {
    assert!(campaign(60) >= 28);
}

/// The last steps of a swing change the merit by less than it is rounded: they must be taken all the same.
#[test]
fn rounding_does_not_decide_whether_a_swing_converges() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let rounding = ModelNoise {
        linear: 1e-13,
        height: 1e-13,
    };
    for name in ["kick_ES", "kick_IS", "kick_EL"] {
        let text = std::fs::read_to_string(problem_path(name)).expect("shipped");
        for case in 0..20 {
            let mut json: Value = serde_json::from_str(&text).expect("shipped");
            scale_model(&mut json, rounding, &mut random);
            let benchmark = parse_problem(&json.to_string()).expect("still valid");
            let mut solver =
                Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
            assert_eq!(solver.solve().status, Status::Converged, "{name}, case {case}");
        }
    }
}

/// `cargo test --release -p flyvine --lib disturbed -- --ignored --nocapture`
#[test]
#[ignore = "a minute; run before releases"]
fn a_thousand_disturbed_problems_converge_or_are_diagnosed() {
    assert!(campaign(1000) >= 475);
}
