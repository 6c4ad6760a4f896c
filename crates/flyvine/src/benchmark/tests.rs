//! The shipped problems to their known optima.

use super::{BenchmarkError, BenchmarkProblem, Dense, parse_problem, read_problem};
use crate::trajopt::{
    Dynamics, MultiStart, Options, Solution, Solver, Start, Status, multi_start, solve_batch,
};
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

/// Checks a solution against the problem without the solver's help: finite, a rollout of its commands, within the
/// command bounds, its cost and violation as reported, and, if converged, a stationary point for its multipliers.
pub(super) fn verify(case: &str, benchmark: &BenchmarkProblem, solution: &Solution) {
    let (problem, dynamics) = (&benchmark.problem, &benchmark.dynamics);
    let (n, m, fresh) = (problem.state_len(), problem.command_len(), dynamics.fresh_len());
    let steps = problem.knots - 1;
    let mut states = vec![0.0; problem.knots * n];
    states[..n].copy_from_slice(&problem.start);
    for k in 0..steps {
        let command = &solution.commands[k * m..][..m];
        for (j, u) in command.iter().enumerate() {
            assert!(
                (problem.command_lower[j]..=problem.command_upper[j]).contains(u),
                "{case}: u[{k}][{j}] = {u}"
            );
        }
        let (now, next) = states[k * n..][..2 * n].split_at_mut(n);
        dynamics.step(k, now, command, &mut next[..fresh]);
        next[fresh..].copy_from_slice(&now[..n - fresh]);
    }
    assert!(
        solution.states.iter().all(|z| z.is_finite()),
        "{case}: a state is not finite"
    );
    if matches!(solution.status, Status::GuessDiverges { .. }) {
        return;
    }
    assert!(states == solution.states, "{case}: not a rollout");

    let weighted = |value: &[f64], reference: &[f64], weight: &[f64]| -> f64 {
        let terms = value.iter().zip(reference).enumerate();
        terms
            .map(|(i, (v, r))| weight[i % weight.len()] * (v - r).powi(2))
            .sum()
    };
    let cost = weighted(&states, &problem.state_reference, &problem.state_weight)
        + weighted(
            &solution.commands,
            &problem.command_reference,
            &problem.command_weight,
        );
    assert!(
        (cost - solution.cost).abs() <= 1e-10 * (1.0 + cost),
        "{case}: J = {cost}, not {}",
        solution.cost
    );

    let mut violation = 0.0_f64;
    for bound in &problem.state_bounds {
        for k in bound.first_knot..=bound.last_knot {
            let z = states[k * n + bound.index];
            violation = violation.max(z - bound.upper).max(bound.lower - z);
        }
    }
    for equality in &problem.equalities {
        violation = violation.max((states[equality.knot * n + equality.index] - equality.value).abs());
    }
    assert!(
        (violation - solution.max_violation).abs() <= 1e-12,
        "{case}: violation {violation}"
    );
    let stationarity = stationarity(benchmark, solution);
    let tolerance = Options::default();
    match solution.status {
        Status::Converged => {
            assert!(
                violation <= tolerance.violation_tolerance,
                "{case}: violation {violation}"
            );
            assert!(
                stationarity <= 1.001 * tolerance.stationarity_tolerance,
                "{case}: stationarity {stationarity}"
            );
        }
        _ => assert!(
            violation > tolerance.violation_tolerance || stationarity > tolerance.stationarity_tolerance,
            "{case}: converged, but says {:?}",
            solution.status
        ),
    }
}

/// Largest projected gradient of the Lagrangian with respect to a command, divided by 1 + |J|.
fn stationarity(benchmark: &BenchmarkProblem, solution: &Solution) -> f64 {
    let problem = &benchmark.problem;
    let m = problem.command_len();
    let mut worst = 0.0_f64;
    for (i, (gradient, command)) in gradient(benchmark, solution)
        .iter()
        .zip(&solution.commands)
        .enumerate()
    {
        let held = (*command <= problem.command_lower[i % m] && *gradient > 0.0)
            || (*command >= problem.command_upper[i % m] && *gradient < 0.0);
        worst = if held { worst } else { worst.max(gradient.abs()) };
    }
    worst / (1.0 + solution.cost.abs())
}

/// Gradient of the Lagrangian with respect to the commands, by a dense adjoint recursion with the solution's
/// multipliers.
fn gradient(benchmark: &BenchmarkProblem, solution: &Solution) -> Vec<f64> {
    let (problem, dynamics) = (&benchmark.problem, &benchmark.dynamics);
    let (n, m, fresh) = (problem.state_len(), problem.command_len(), dynamics.fresh_len());
    let state_gradient = |k: usize| -> Vec<f64> {
        let z = |i: usize| solution.states[k * n + i] - problem.state_reference[k * n + i];
        let mut gradient: Vec<f64> = (0..n).map(|i| 2.0 * problem.state_weight[i] * z(i)).collect();
        for constraint in solution
            .multipliers
            .iter()
            .filter(|constraint| constraint.knot == k)
        {
            gradient[constraint.index] += constraint.multiplier;
        }
        gradient
    };
    let mut gradients = vec![0.0; solution.commands.len()];
    let mut jacobian = vec![0.0; fresh * (n + m)];
    let mut costate = state_gradient(problem.knots - 1);
    for k in (0..problem.knots - 1).rev() {
        let command = &solution.commands[k * m..][..m];
        dynamics.jacobian(k, &solution.states[k * n..][..n], command, &mut jacobian);
        let product = |j: usize| {
            (0..fresh)
                .map(|r| jacobian[r * (n + m) + j] * costate[r])
                .sum::<f64>()
        };
        for j in 0..m {
            let deviation = command[j] - problem.command_reference[k * m + j];
            gradients[k * m + j] = 2.0 * problem.command_weight[j] * deviation + product(n + j);
        }
        let shifted = |i: usize| costate.get(fresh + i).copied().unwrap_or(0.0);
        costate = state_gradient(k)
            .iter()
            .enumerate()
            .map(|(i, g)| g + product(i) + shifted(i))
            .collect();
    }
    gradients
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

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        self.0.jacobian(knot, state, command, jacobian);
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

#[test]
fn warm_starts_need_fewer_steps() {
    let benchmark = read("kick_ES");
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
    let cold = solver.solve().clone();
    let again = solver.solve_from(Start::Previous).expect("valid").clone();
    assert_eq!((again.status, again.iterations), (Status::Converged, 0));

    let mut moved = benchmark.problem.start.clone();
    moved[0] += 0.001;
    solver.set_start(&moved).expect("valid");
    let warm = solver.solve_from(Start::Previous).expect("valid").clone();
    assert_eq!(warm.status, Status::Converged);
    assert!(
        warm.iterations < cold.iterations,
        "{} against {}",
        warm.iterations,
        cold.iterations
    );

    solver.set_start(&benchmark.problem.start).expect("valid");
    let trajectory = Start::Trajectory {
        states: &cold.states,
        commands: &cold.commands,
    };
    let steered = solver.solve_from(trajectory).expect("valid");
    assert_eq!(steered.status, Status::Converged);
    assert!((steered.cost - cold.cost).abs() < 1e-6 * cold.cost);
    assert!(solver.solve_from(Start::Commands(&[0.0])).is_err());
    assert!(
        solver
            .solve_from(Start::Commands(&vec![f64::NAN; cold.commands.len()]))
            .is_err()
    );
}

#[test]
fn budgets_return_the_answer_so_far() {
    let benchmark = read("kick_EL");
    let options = Options {
        max_iterations: 10,
        ..Options::default()
    };
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, options).expect("valid");
    let solution = solver.solve().clone();
    assert_eq!(
        (solution.status, solution.iterations),
        (Status::IterationLimit, 10)
    );
    verify("10 iterations", &benchmark, &solution);
    let worst = solution.diagnosis(1e-6);
    assert_eq!(worst[0].violation, solution.max_violation);

    let options = Options {
        time_limit: Some(std::time::Duration::ZERO),
        ..Options::default()
    };
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, options).expect("valid");
    assert_eq!(solver.solve().status, Status::TimeLimit);
}

#[test]
fn impossible_targets_are_diagnosed() {
    let mut benchmark = read("kick_ES");
    benchmark.problem.equalities[0].value = 3.0;
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
    let solution = solver.solve();
    assert_ne!(solution.status, Status::Converged);
    verify("impossible", &benchmark, solution);
    assert!(!solution.diagnosis(1e-6).is_empty());
}

/// With a price above the multiplier of the hard constraint nothing changes; with a low one the constraint gives way,
/// and its multiplier is the price.
#[test]
fn soft_constraints_give_way_at_their_price() {
    let mut benchmark = read("kick_ES");
    let mut solver = Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
    let hard = solver.solve().clone();
    let highest = hard
        .multipliers
        .iter()
        .map(|constraint| constraint.multiplier.abs())
        .fold(0.0, f64::max);
    let mut solve_at = |price: f64| {
        for bound in &mut benchmark.problem.state_bounds {
            bound.price = price;
        }
        for equality in &mut benchmark.problem.equalities {
            equality.price = price;
        }
        let mut solver =
            Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
        solver.solve().clone()
    };
    let dear = solve_at(2.0 * highest);
    assert_eq!(dear.status, Status::Converged);
    assert!(
        (dear.cost + dear.soft_cost - hard.cost).abs() <= 1e-5 * hard.cost,
        "J = {}",
        dear.cost
    );
    assert!(dear.soft_cost <= 1e-4);

    let price = 0.2 * highest;
    let cheap = solve_at(price);
    assert_eq!(cheap.status, Status::Converged);
    assert_eq!(cheap.max_violation, 0.0, "no constraint is hard");
    assert!(cheap.diagnosis(1e-6).is_empty());
    assert!(cheap.soft_cost > 1.0 && cheap.cost + cheap.soft_cost < hard.cost - 1.0);
    let mut gave_way = 0;
    for constraint in &cheap.multipliers {
        assert!(constraint.multiplier.abs() <= price);
        if constraint.violation > 1e-6 {
            gave_way += 1;
            assert!((constraint.multiplier.abs() - price).abs() <= 1e-9 * price);
        }
    }
    assert!(gave_way > 0);
}

/// Multipliers are the sensitivities that they are documented to be: moving a bound changes the optimum by them.
#[test]
fn multipliers_are_sensitivities() {
    let mut benchmark = read("kick_ES");
    let mut solve = |by: f64| {
        benchmark.problem.equalities[0].value += by;
        let mut solver =
            Solver::new(&benchmark.problem, &benchmark.dynamics, Options::default()).expect("valid");
        let solution = solver.solve().clone();
        benchmark.problem.equalities[0].value -= by;
        solution
    };
    let step = 1e-4;
    let slope = (solve(step).cost - solve(-step).cost) / (2.0 * step);
    let solution = solve(0.0);
    let source = crate::trajopt::ConstraintSource::Equality(0);
    let multiplier = solution.worst(source).expect("exists").multiplier;
    assert!(
        (slope + multiplier).abs() <= 1e-3 * slope.abs(),
        "{slope} against −{multiplier}"
    );
}

/// Results of parallel work do not depend on the number of threads, and many starts find the better minimum of the
/// two that kick_IS is known to have (851.94 and 1173.6).
#[test]
fn parallel_solves_are_the_same_on_any_number_of_threads() {
    let names = ["kick_ES", "kick_IS", "linkick_ES", "kick_EL"];
    let benchmarks = names.map(read);
    let problems: Vec<_> = benchmarks
        .iter()
        .map(|benchmark| (&benchmark.problem, &benchmark.dynamics))
        .collect();
    let search = MultiStart {
        starts: 6,
        spread: 1.0,
        seed: 3,
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            let batch = solve_batch(&problems, &Options::default());
            let many = multi_start(problems[1].0, problems[1].1, &Options::default(), search).expect("valid");
            (batch, many)
        })
    };
    let (batch, many) = run(1);
    for (benchmark, solution) in benchmarks.iter().zip(&batch) {
        let solution = solution.as_ref().expect("valid");
        assert_eq!(solution.status, Status::Converged);
        verify(&benchmark.name, benchmark, solution);
    }
    assert!(many.best.cost < 851.944, "{:?}", many.reached);
    assert_eq!(many.reached.len(), 6);
    assert!(
        (batch, many) == run(3),
        "another number of threads, another result"
    );
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
