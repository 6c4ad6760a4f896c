//! Times of the planner on the shipped problems: `cargo bench -p flyvine --bench trajopt`.
#![allow(missing_docs)] // criterion's macros make public functions

use criterion::{Criterion, criterion_group, criterion_main};
use flyvine::benchmark::{BenchmarkProblem, Dense, read_problem};
use flyvine::trajopt::{Options, Solver, Start, solve_batch};
use std::hint::black_box;

fn read(name: &str) -> BenchmarkProblem {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bench/problems");
    read_problem(format!("{folder}/{name}.json").as_ref()).expect("shipped")
}

/// One Newton step of a convex problem: a rollout, one factorization, one closed-loop rollout.
fn sweep(criterion: &mut Criterion) {
    let benchmark = read("linlem5_ES");
    let one_step = || Options {
        max_iterations: 1,
        ..Options::default()
    };
    let mut structured = Solver::new(&benchmark.problem, &benchmark.dynamics, one_step()).expect("valid");
    criterion.bench_function("one step, 160 knots, structured", |bencher| {
        bencher.iter(|| black_box(structured.solve().cost));
    });
    let dense = Dense(&benchmark.dynamics);
    let mut dense = Solver::new(&benchmark.problem, &dense, one_step()).expect("valid");
    criterion.bench_function("one step, 160 knots, dense", |bencher| {
        bencher.iter(|| black_box(dense.solve().cost));
    });
}

/// Rolling commands out and linearizing along them.
fn rollout(criterion: &mut Criterion) {
    for name in ["lem10_ES", "grow"] {
        let benchmark = read(name);
        let options = Options {
            max_iterations: 0,
            ..Options::default()
        };
        let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, options).expect("valid");
        let commands = benchmark.problem.command_guess.clone();
        criterion.bench_function(&format!("rollout, {name}"), |bencher| {
            bencher.iter(|| black_box(solver.solve_from(Start::Commands(&commands)).expect("valid").cost));
        });
    }
}

fn solve(criterion: &mut Criterion) {
    for name in [
        "lem5_ES",
        "lem10_ES",
        "grow",
        "kick_ES",
        "kick_IS",
        "kick_EL",
        "linkick_ES",
    ] {
        let benchmark = read(name);
        let mut solver =
            Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
        criterion.bench_function(&format!("solve, {name}"), |bencher| {
            bencher.iter(|| black_box(solver.solve().cost));
        });
    }
}

/// Sixty-four swings on one thread and on two.
fn batch(criterion: &mut Criterion) {
    let benchmark = read("kick_ES");
    let problems = vec![(&benchmark.problem, &benchmark.dynamics); 64];
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        criterion.bench_function(&format!("64 solves of kick_ES, {threads} threads"), |bencher| {
            bencher.iter(|| pool.install(|| black_box(solve_batch(&problems, &Options::default()).len())));
        });
    }
}

criterion_group!(benches, sweep, rollout, solve, batch);
criterion_main!(benches);
