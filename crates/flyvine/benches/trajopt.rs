//! Times of the planner on the shipped problems: `cargo bench -p flyvine --bench trajopt`.
#![allow(missing_docs)] // criterion's macros make public functions

use criterion::{Criterion, criterion_group, criterion_main};
use flyvine::benchmark::{BenchmarkProblem, read_problem};
use flyvine::trajopt::{Dynamics, Options, Solver, Start};
use std::hint::black_box;

fn read(name: &str) -> BenchmarkProblem {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bench/problems");
    read_problem(format!("{folder}/{name}.json").as_ref()).expect("shipped")
}

/// The same dynamics with the shift hidden, so that the solver takes its dense path.
struct Dense<'a, D>(&'a D);

impl<D: Dynamics> Dynamics for Dense<'_, D> {
    fn state_len(&self) -> usize {
        self.0.state_len()
    }

    fn command_len(&self) -> usize {
        self.0.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.0.state_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], next: &mut [f64]) {
        let (fresh, shifted) = next.split_at_mut(self.0.fresh_len());
        self.0.step(knot, state, command, fresh);
        shifted.copy_from_slice(&state[..shifted.len()]);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let (width, fresh) = (state.len() + command.len(), self.0.fresh_len());
        jacobian.fill(0.0);
        let (top, bottom) = jacobian.split_at_mut(fresh * width);
        self.0.jacobian(knot, state, command, top);
        for (i, row) in bottom.chunks_exact_mut(width).enumerate() {
            row[i] = 1.0;
        }
    }
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

criterion_group!(benches, sweep, rollout, solve);
criterion_main!(benches);
