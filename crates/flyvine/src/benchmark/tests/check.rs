//! Answers checked without the solver's help: by a rollout of their commands and a dense adjoint recursion.

use super::super::BenchmarkProblem;
use crate::trajopt::{Dynamics, Options, Solution, Status};

/// Checks a solution against the problem without the solver's help: finite, a rollout of its commands, within the
/// command bounds, its cost and violation as reported, and, if converged, a stationary point for its multipliers.
pub fn verify(case: &str, benchmark: &BenchmarkProblem, solution: &Solution) {
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
pub fn gradient(benchmark: &BenchmarkProblem, solution: &Solution) -> Vec<f64> {
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
