//! Convex problems against Clarabel, an interior-point solver that shares nothing with this one: the same optima, and
//! the same verdict on problems that have no feasible point.

#![allow(clippy::print_stdout)] // a tally for people

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};
use flyvine::benchmark::{BenchmarkProblem, read_problem};
use flyvine::trajopt::{ConstraintSource, Dynamics, Options, Problem, Solver, Status};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Rows of `A x + s = b`, as triplets.
#[derive(Default)]
struct Rows {
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    right: Vec<f64>,
}

impl Rows {
    fn push(&mut self, entries: impl IntoIterator<Item = (usize, f64)>, right: f64) {
        for (column, value) in entries {
            if value != 0.0 {
                self.rows.push(self.right.len());
                self.columns.push(column);
                self.values.push(value);
            }
        }
        self.right.push(right);
    }
}

/// What Clarabel makes of a problem.
enum Verdict {
    /// The optimal commands and cost.
    Optimal(Vec<f64>, f64),
    /// There is no feasible point, by proof.
    Infeasible,
    /// Neither to its tolerance: close to the edge of feasibility.
    None,
}

/// Clarabel on a problem with affine dynamics. Variables are (u_0, z_1, u_1, z_2, …).
fn reference_solution(problem: &Problem, dynamics: &dyn Dynamics) -> Verdict {
    let (n, m, steps) = (problem.state_len(), problem.command_len(), problem.knots - 1);
    let command = |k: usize, j: usize| k * (n + m) + j;
    let state = |k: usize, i: usize| (k - 1) * (n + m) + m + i;
    let variables = steps * (n + m);

    let (mut hessian, mut gradient) = (vec![0.0; variables], vec![0.0; variables]);
    let mut constant = (0..n)
        .map(|i| problem.state_weight[i] * (problem.start[i] - problem.state_reference[i]).powi(2))
        .sum::<f64>();
    let mut add_square = |variable: usize, weight: f64, reference: f64| {
        hessian[variable] += 2.0 * weight;
        gradient[variable] -= 2.0 * weight * reference;
        constant += weight * reference * reference;
    };
    for k in 0..steps {
        for j in 0..m {
            add_square(
                command(k, j),
                problem.command_weight[j],
                problem.command_reference[k * m + j],
            );
        }
        for i in 0..n {
            let reference = problem.state_reference[(k + 1) * n + i];
            add_square(state(k + 1, i), problem.state_weight[i], reference);
        }
    }

    let (mut equal, mut below) = (Rows::default(), Rows::default());
    for k in 0..steps {
        add_dynamics(problem, dynamics, k, &mut equal);
    }
    for equality in problem.equalities.iter().filter(|equality| equality.knot > 0) {
        equal.push([(state(equality.knot, equality.index), 1.0)], equality.value);
    }
    let mut add_interval = |variable: usize, lower: f64, upper: f64| {
        if upper.is_finite() {
            below.push([(variable, 1.0)], upper);
        }
        if lower.is_finite() {
            below.push([(variable, -1.0)], -lower);
        }
    };
    for k in 0..steps {
        for j in 0..m {
            add_interval(command(k, j), problem.command_lower[j], problem.command_upper[j]);
        }
    }
    for bound in &problem.state_bounds {
        for k in bound.first_knot.max(1)..=bound.last_knot {
            add_interval(state(k, bound.index), bound.lower, bound.upper);
        }
    }

    let cones = [ZeroConeT(equal.right.len()), NonnegativeConeT(below.right.len())];
    let offset = equal.right.len();
    let rows = equal
        .rows
        .into_iter()
        .chain(below.rows.iter().map(|row| row + offset))
        .collect();
    let columns = [equal.columns, below.columns].concat();
    let values = [equal.values, below.values].concat();
    let right = [equal.right, below.right].concat();
    let matrix = CscMatrix::new_from_triplets(right.len(), variables, rows, columns, values);
    let diagonal = (0..variables).collect::<Vec<_>>();
    let hessian = CscMatrix::new_from_triplets(variables, variables, diagonal.clone(), diagonal, hessian);
    let settings = DefaultSettings {
        verbose: false,
        max_threads: 1,
        tol_gap_abs: 1e-8,
        tol_gap_rel: 1e-8,
        tol_feas: 1e-8,
        ..DefaultSettings::default()
    };
    let mut solver =
        DefaultSolver::new(&hessian, &gradient, &matrix, &right, &cones, settings).expect("well posed");
    solver.solve();
    match solver.solution.status {
        SolverStatus::Solved => {
            let commands = (0..steps * m)
                .map(|i| solver.solution.x[command(i / m, i % m)])
                .collect();
            Verdict::Optimal(commands, solver.solution.obj_val + constant)
        }
        SolverStatus::PrimalInfeasible => Verdict::Infeasible,
        _ => Verdict::None,
    }
}

/// `z_{k+1} − A z_k − B u_k = c`, shifted copies included.
fn add_dynamics(problem: &Problem, dynamics: &dyn Dynamics, k: usize, equal: &mut Rows) {
    let (n, m, fresh) = (problem.state_len(), problem.command_len(), dynamics.fresh_len());
    let (mut offset, mut jacobian) = (vec![0.0; fresh], vec![0.0; fresh * (n + m)]);
    dynamics.linearize(k, &vec![0.0; n], &vec![0.0; m], &mut offset, &mut jacobian);
    for i in 0..n {
        let mut row = vec![0.0; n + m];
        if i < fresh {
            row.copy_from_slice(&jacobian[i * (n + m)..][..n + m]);
        } else {
            row[i - fresh] = 1.0;
        }
        let mut right = offset.get(i).copied().unwrap_or(0.0);
        let mut entries = vec![(k * (n + m) + m + i, 1.0)];
        entries.extend((0..m).map(|j| (k * (n + m) + j, -row[n + j])));
        if k > 0 {
            entries.extend((0..n).map(|j| ((k - 1) * (n + m) + m + j, -row[j])));
        } else {
            right += (0..n).map(|j| row[j] * problem.start[j]).sum::<f64>();
        }
        equal.push(entries, right);
    }
}

fn read(name: &str) -> BenchmarkProblem {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bench/problems");
    read_problem(format!("{folder}/{name}.json").as_ref()).expect("shipped")
}

/// Whether the problem is feasible, after checking that both solvers agree on that, and on the optimum; `None` if Clarabel
/// cannot tell.
fn agree(case: &str, benchmark: &BenchmarkProblem) -> Option<bool> {
    let BenchmarkProblem {
        problem, dynamics, ..
    } = benchmark;
    let mut solver = Solver::new(problem, dynamics, Options::default()).expect("valid");
    let solution = solver.solve();
    let (commands, cost) = match reference_solution(problem, dynamics) {
        Verdict::Optimal(commands, cost) => (commands, cost),
        Verdict::Infeasible => {
            assert_eq!(
                solution.status,
                Status::ProbablyInfeasible,
                "{case}: there is no feasible point"
            );
            relaxing_helps(case, benchmark, solution.diagnosis(1e-8));
            return Some(false);
        }
        Verdict::None => return None,
    };
    assert_eq!(solution.status, Status::Converged, "{case}");
    let relative = (solution.cost - cost) / cost;
    assert!(
        relative.abs() <= 1e-6,
        "{case}: J = {}, Clarabel {cost}",
        solution.cost
    );
    for (i, (found, expected)) in solution.commands.iter().zip(&commands).enumerate() {
        assert!(
            (found - expected).abs() <= 1e-3,
            "{case}: command {i} is {found}, Clarabel {expected}"
        );
    }
    Some(true)
}

/// What a diagnosis claims: with every named constraint relaxed by its violation there are feasible points.
fn relaxing_helps(case: &str, benchmark: &BenchmarkProblem, diagnosis: Vec<flyvine::trajopt::Violation>) {
    assert!(
        !diagnosis.is_empty(),
        "{case}: infeasible, yet nothing is violated"
    );
    let mut problem = benchmark.problem.clone();
    let mut relaxed_equalities = Vec::new();
    for violation in diagnosis {
        let by = violation.violation + 1e-6;
        match violation.source {
            ConstraintSource::StateBound(i) => {
                problem.state_bounds[i].lower -= by;
                problem.state_bounds[i].upper += by;
            }
            ConstraintSource::Equality(i) => relaxed_equalities.push((i, by)),
        }
    }
    relaxed_equalities.sort_by_key(|(i, _)| std::cmp::Reverse(*i));
    for (i, by) in relaxed_equalities {
        let equality = problem.equalities.remove(i);
        problem.state_bounds.push(flyvine::trajopt::StateBound {
            first_knot: equality.knot,
            last_knot: equality.knot,
            index: equality.index,
            lower: equality.value - by,
            upper: equality.value + by,
            price: f64::INFINITY,
        });
    }
    assert!(
        !matches!(
            reference_solution(&problem, &benchmark.dynamics),
            Verdict::Infeasible
        ),
        "{case}: relaxed in vain"
    );
}

#[test]
fn shipped_convex_problems_have_the_same_optima() {
    for name in ["linlem5_ES", "linkick_ES"] {
        assert_eq!(agree(name, &read(name)), Some(true), "{name} is feasible");
    }
}

/// Swings with other starts, targets, bounds and references.
fn disturbed(random: &mut ChaCha8Rng) -> BenchmarkProblem {
    let mut benchmark = read("linkick_ES");
    let problem = &mut benchmark.problem;
    let start: Vec<f64> = problem.start[..9]
        .iter()
        .map(|x| x + random.random_range(-0.01..=0.01))
        .collect();
    problem.start = start.repeat(3);
    for reference in &mut problem.command_reference {
        *reference += random.random_range(-0.1..=0.1);
    }
    // From well within reach to well beyond it.
    let shift = [random.random_range(-1.0..=3.0), random.random_range(-0.5..=1.0)];
    for equality in &mut problem.equalities {
        equality.value += shift[usize::from(equality.index == 8)];
    }
    for bound in &mut problem.state_bounds {
        bound.upper += random.random_range(-0.01..=0.05);
    }
    for upper in &mut problem.command_upper {
        *upper += random.random_range(-0.05..=0.05);
    }
    benchmark
}

fn campaign(count: usize) {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let verdicts: Vec<Option<bool>> = (0..count)
        .map(|case| agree(&format!("case {case}"), &disturbed(&mut random)))
        .collect();
    let number = |verdict| verdicts.iter().filter(|v| **v == verdict).count();
    let (feasible, infeasible) = (number(Some(true)), number(Some(false)));
    println!("of {count} swings {feasible} are feasible and {infeasible} are not, by both solvers");
    assert!(
        feasible > count / 10 && infeasible > 0,
        "too one-sided to say much"
    );
    assert!(
        feasible + infeasible >= count * 9 / 10,
        "too often without a verdict"
    );
}

#[test]
fn disturbed_swings_have_the_same_optima_or_none() {
    campaign(30);
}

/// `cargo test --release -p flyvine --test convex -- --ignored`
#[test]
#[ignore = "a minute; run before releases"]
fn a_thousand_disturbed_swings_have_the_same_optima_or_none() {
    campaign(1000);
}
