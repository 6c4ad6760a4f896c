//! What constraints cost, and what is said where they cannot all be met.

use super::{read, verify};
use crate::trajopt::{Bounds, ConstraintSource, Loosening, Options, Solver, Status};

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
    let source = ConstraintSource::Equality(0);
    let multiplier = solution.worst(source).expect("exists").multiplier;
    assert!(
        (slope + multiplier).abs() <= 1e-3 * slope.abs(),
        "{slope} against −{multiplier}"
    );
}

/// A target 20 cm farther than the shipped one: the diagnosis names the commanded heights among what stands in the way, and
/// what it says of every bound holds.
#[test]
fn bounds_that_stand_in_the_way_are_named() {
    let mut benchmark = read("kick_ES");
    for equality in &mut benchmark.problem.equalities {
        if equality.index == 6 {
            equality.value += 0.2;
        }
    }
    let (problem, dynamics, options) = (&benchmark.problem, &benchmark.dynamics, Options::default());
    let mut solver = Solver::new(problem, dynamics, options.clone()).expect("valid");
    let failed = solver.solve();
    assert_eq!(failed.status, Status::ProbablyInfeasible);
    let found = Loosening::find(problem, dynamics, &options, failed).expect("valid");
    assert!(
        found
            .iter()
            .any(|loosening| loosening.bounds == Bounds::Command(2))
    );
    for loosening in &found {
        let mut loose = problem.clone();
        match loosening.bounds {
            Bounds::Command(entry) => {
                loose.command_lower[entry] -= loosening.by;
                loose.command_upper[entry] += loosening.by;
            }
            Bounds::State(index) => {
                for bound in loose.state_bounds.iter_mut().filter(|bound| bound.index == index) {
                    bound.lower -= loosening.by;
                    bound.upper += loosening.by;
                }
            }
        }
        let mut solver = Solver::new(&loose, dynamics, options.clone()).expect("valid");
        let solved = solver.solve().status == Status::Converged;
        assert_eq!(solved, loosening.status == Status::Converged, "{loosening:?}");
    }
}
