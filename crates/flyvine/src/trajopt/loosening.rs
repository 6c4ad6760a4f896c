//! What would make a problem solvable that is not: which bounds, moved out by how much.
//!
//! Where the violations v cannot get smaller, their multipliers y have grown until the cost hardly counts, and the
//! multipliers λ of the bounds that hold balance them: a bound moved out by ε takes `ε Σ |λ|` off `yᵀ v`, with the sum over
//! the knots at which it is active. To first order it would alone have to move by
//!
//! ```text
//! ε = yᵀ v / Σ |λ|
//! ```
//!
//! Curvature makes it less or more, and what becomes active next more; so the problem is solved again with the bound moved
//! out, and what is said here has been tried.

use super::{
    ConstraintSource, Dynamics, Options, Problem, ProblemError, Solution, Solver, Start, StateBound, Status,
};
use rayon::prelude::*;

/// Bounds that are tried: those that would have to move least.
const TRIED: usize = 3;
/// How far they are moved, in first-order estimates, until that is enough.
const REACHES: [f64; 3] = [0.3, 1.1, 4.0];
/// An attempt may take as many steps as the failed solve did, and at least these.
const LEAST_STEPS: usize = 100;

/// Multipliers below this share of the bounds' largest are the cost's, not the violation's.
const SHARE_THAT_MATTERS: f64 = 1e-3;

/// Bounds that move out together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bounds {
    /// Both bounds on this entry of the command.
    Command(usize),
    /// All hard bounds on this entry of the state.
    State(usize),
}

/// Bounds that keep a problem from being solved, and what came of moving them out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loosening {
    /// The bounds.
    pub bounds: Bounds,
    /// First knot at which they stand in the way.
    pub first_knot: usize,
    /// Last knot at which they do.
    pub last_knot: usize,
    /// How far they were moved out, two significant digits.
    pub by: f64,
    /// How the solve ended then; if it did not converge, moving these alone is not known to help.
    pub status: Status,
}

impl Loosening {
    /// For a `solution` of `problem` that violates constraints: the few bounds that would alone have to move least, each moved
    /// out until the problem was solved, or well beyond the estimate. On rayon's pool; the same whatever its threads.
    ///
    /// # Errors
    /// See [`ProblemError`].
    pub fn find<D: Dynamics + ?Sized>(
        problem: &Problem,
        dynamics: &D,
        options: &Options,
        solution: &Solution,
    ) -> Result<Vec<Self>, ProblemError> {
        let hard = solution.multipliers.iter().filter(|constraint| constraint.hard);
        let wanted: f64 = hard
            .map(|constraint| constraint.multiplier.abs() * constraint.violation)
            .sum();
        if wanted == 0.0 {
            return Ok(Vec::new());
        }
        let mut pressures = pressures(solution, problem.command_len());
        pressures.sort_by(|a, b| b.sum().total_cmp(&a.sum()));
        pressures.truncate(TRIED);
        let options = Options {
            max_iterations: options.max_iterations.min(solution.iterations.max(LEAST_STEPS)),
            ..options.clone()
        };
        pressures
            .into_par_iter()
            .map(|pressure| pressure.loosen(problem, dynamics, &options, solution, wanted))
            .collect()
    }
}

/// The multipliers of some bounds.
#[derive(Debug, Clone)]
struct Pressure {
    bounds: Bounds,
    /// Knots at which they are active, and |λ| there.
    at: Vec<(usize, f64)>,
}

/// The pressures of all active bounds.
fn pressures(solution: &Solution, command_len: usize) -> Vec<Pressure> {
    let on_commands = solution
        .command_multipliers
        .iter()
        .enumerate()
        .map(|(i, &multiplier)| (Bounds::Command(i % command_len), i / command_len, multiplier));
    let on_states = solution
        .multipliers
        .iter()
        .filter(|constraint| constraint.hard && matches!(constraint.source, ConstraintSource::StateBound(_)))
        .map(|constraint| {
            (
                Bounds::State(constraint.index),
                constraint.knot,
                constraint.multiplier,
            )
        });
    let mut pressures: Vec<Pressure> = Vec::new();
    for (bounds, knot, multiplier) in on_commands.chain(on_states) {
        if multiplier == 0.0 {
            continue;
        }
        let here = (knot, multiplier.abs());
        match pressures.iter_mut().find(|known| known.bounds == bounds) {
            Some(known) => known.at.push(here),
            None => pressures.push(Pressure {
                bounds,
                at: vec![here],
            }),
        }
    }
    pressures
}

impl Pressure {
    /// Σ |λ|.
    fn sum(&self) -> f64 {
        self.at.iter().map(|(_, multiplier)| multiplier).sum()
    }

    /// First and last knot at which the bounds matter, and not only for the cost.
    fn knots(&self) -> (usize, usize) {
        let most = self
            .at
            .iter()
            .map(|(_, multiplier)| *multiplier)
            .fold(0.0, f64::max);
        let matters = |(_, multiplier): &&(usize, f64)| *multiplier >= SHARE_THAT_MATTERS * most;
        let knots = || self.at.iter().filter(matters).map(|(knot, _)| *knot);
        (knots().min().unwrap_or(0), knots().max().unwrap_or(0))
    }

    /// Moves the bounds out, ever further, until the problem is solved; `wanted` is `yᵀ v`.
    fn loosen<D: Dynamics + ?Sized>(
        self,
        problem: &Problem,
        dynamics: &D,
        options: &Options,
        solution: &Solution,
        wanted: f64,
    ) -> Result<Loosening, ProblemError> {
        let (first_knot, last_knot) = self.knots();
        let mut loosening = Loosening {
            bounds: self.bounds,
            first_knot,
            last_knot,
            by: 0.0,
            status: solution.status,
        };
        for reach in REACHES {
            loosening.by = two_digits_up(reach * wanted / self.sum());
            let loose = moved_out(problem, self.bounds, loosening.by);
            let mut solver = Solver::new(&loose, dynamics, options.clone())?;
            loosening.status = solver.solve_from(Start::Commands(&solution.commands))?.status;
            if loosening.status == Status::Converged {
                break;
            }
        }
        Ok(loosening)
    }
}

/// `problem` with these bounds moved out on both sides.
fn moved_out(problem: &Problem, bounds: Bounds, by: f64) -> Problem {
    let mut loose = problem.clone();
    match bounds {
        Bounds::Command(entry) => {
            loose.command_lower[entry] -= by;
            loose.command_upper[entry] += by;
        }
        Bounds::State(index) => {
            let hard = |bound: &&mut StateBound| bound.index == index && bound.price == f64::INFINITY;
            for bound in loose.state_bounds.iter_mut().filter(hard) {
                bound.lower -= by;
                bound.upper += by;
            }
        }
    }
    loose
}

/// The next greater number of two significant digits.
fn two_digits_up(value: f64) -> f64 {
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    (value / unit).ceil() * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::Equality;
    use crate::trajopt::derivatives::{Toy, toy_problem};

    fn solve(problem: &Problem) -> Solution {
        let mut solver = Solver::new(problem, &Toy, Options::default()).unwrap();
        solver.solve().clone()
    }

    /// A command too weak to reach 0.9.
    fn weak(limit: f64) -> Problem {
        Problem {
            command_lower: vec![-limit],
            command_upper: vec![limit],
            ..toy_problem()
        }
    }

    #[test]
    fn what_would_help_is_named_and_does_help() {
        let problem = weak(0.2);
        let failed = solve(&problem);
        assert_eq!(failed.status, Status::ProbablyInfeasible);
        let found = Loosening::find(&problem, &Toy, &Options::default(), &failed).unwrap();
        let [loosening] = found[..] else {
            panic!("{found:?}")
        };
        assert_eq!(loosening.bounds, Bounds::Command(0));
        assert_eq!((loosening.first_knot, loosening.last_knot), (0, 4));
        assert_eq!(loosening.status, Status::Converged);
        assert_eq!(solve(&weak(0.2 + loosening.by)).status, Status::Converged);
        // And not much more than needed.
        assert_eq!(
            solve(&weak(0.2 + 0.5 * loosening.by)).status,
            Status::ProbablyInfeasible
        );
    }

    #[test]
    fn what_does_not_help_is_not_said_to() {
        // 0.9 and 0.8 at once.
        let mut problem = toy_problem();
        problem.equalities.push(Equality {
            value: 0.8,
            ..problem.equalities[0].clone()
        });
        let failed = solve(&problem);
        assert_eq!(failed.status, Status::ProbablyInfeasible);
        let found = Loosening::find(&problem, &Toy, &Options::default(), &failed).unwrap();
        assert!(
            found
                .iter()
                .all(|loosening| loosening.status != Status::Converged),
            "{found:?}"
        );
    }

    #[test]
    fn distances_are_rounded_up() {
        for (value, expected) in [(0.0512, 0.052), (0.05, 0.05), (123.0, 130.0), (9.96e-7, 1e-6)] {
            let found = two_digits_up(value);
            assert!((found - expected).abs() < 1e-9 * expected, "{found} for {value}");
        }
    }
}
