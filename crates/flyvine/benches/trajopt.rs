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

/// One Riccati sweep along the solution, of a model that stays and of one that changes from knot to knot; and the same
/// with the shift of the lagged state hidden. `examples/riccati_sweep.rs` compares with other people's dense products.
fn sweep(criterion: &mut Criterion) {
    for name in ["linlem5_ES", "grow"] {
        let benchmark = read(name);
        let (problem, knots) = (&benchmark.problem, benchmark.problem.knots);
        let mut structured = Solver::new(problem, &benchmark.dynamics, Options::default()).expect("valid");
        structured.solve();
        criterion.bench_function(&format!("sweep, {name}, {knots} knots, structured"), |bencher| {
            bencher.iter(|| assert!(structured.sweep()));
        });
        let dense = Dense(&benchmark.dynamics);
        let mut dense = Solver::new(problem, &dense, Options::default()).expect("valid");
        dense.solve();
        criterion.bench_function(&format!("sweep, {name}, {knots} knots, dense"), |bencher| {
            bencher.iter(|| assert!(dense.sweep()));
        });
    }
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
