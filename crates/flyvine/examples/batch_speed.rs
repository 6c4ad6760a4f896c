//! What more threads make of a batch of problems: [`solve_batch`] on one thread and on several, interleaved.
//!
//! ```text
//! cargo run --release -p flyvine --example batch_speed -- bench/problems/kick_ES.json [THREADS [ROUNDS]]
//! ```
//!
//! The batch is the problem from many slightly different starts, and rounds of one thread and of THREADS (2) alternate.
//! Prints one JSON object; times are wall-clock ms, so they mean something on an otherwise idle machine only.

#![allow(clippy::print_stdout)] // an example is a program

use flyvine::benchmark::read_problem;
use flyvine::trajopt::{Options, Problem, Status, solve_batch};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Instant;

/// Problems of a batch: a second of work.
const PROBLEMS: usize = 400;
/// Largest displacement of a start, m.
const DISPLACEMENT_M: f64 = 0.02;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let benchmark = read_problem(arguments.next().ok_or("expected a problem")?.as_ref())?;
    let threads: usize = arguments.next().map_or(Ok(2), |threads| threads.parse())?;
    let rounds: usize = arguments.next().map_or(Ok(15), |rounds| rounds.parse())?;

    let problems = displaced(&benchmark.problem);
    let batch: Vec<_> = problems
        .iter()
        .map(|problem| (problem, &benchmark.dynamics))
        .collect();
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pools = [pool(1)?, pool(threads)?];
    let mut times = [vec![], vec![]];
    let mut answers = Vec::new();
    for _ in 0..rounds.max(1) {
        for (pool, times) in pools.iter().zip(&mut times) {
            let started = Instant::now();
            let solutions = pool.install(|| solve_batch(&batch, &Options::default()));
            times.push(1e3 * started.elapsed().as_secs_f64());
            let solutions: Vec<_> = solutions.into_iter().collect::<Result<_, _>>()?;
            if answers.is_empty() {
                answers = solutions;
            } else if answers != solutions {
                return Err("another number of threads, another answer".into());
            }
        }
    }
    let converged = answers
        .iter()
        .filter(|solution| solution.status == Status::Converged);
    let ratios: Vec<f64> = times[0]
        .iter()
        .zip(&times[1])
        .map(|(one, many)| one / many)
        .collect();
    let [one, many] = times.map(median);
    println!(
        "{}",
        serde_json::json!({
            "problem": benchmark.name,
            "problems": PROBLEMS,
            "converged": converged.count(),
            "threads": threads,
            "one_thread_ms": one,
            "threads_ms": many,
            "speed_up": median(ratios),
        })
    );
    Ok(())
}

/// The problem from starts a little beside its own.
fn displaced(problem: &Problem) -> Vec<Problem> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut displace = || {
        let mut problem = problem.clone();
        for entry in &mut problem.start {
            *entry += random.random_range(-DISPLACEMENT_M..=DISPLACEMENT_M);
        }
        problem
    };
    (0..PROBLEMS).map(|_| displace()).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
