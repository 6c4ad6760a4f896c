//! One solve of a task's problem, and its summary in words.

use super::constraints::Constraints;
use super::plan::{PlanOptions, Sensitivity, SolveSummary};
use super::planning::mean_error_m;
use super::{Reference, Task};
use crate::trajopt::{
    Bounds, ConstraintSource, Dynamics, Loosening, Options, Problem, ProblemError, Solution, Solver, Status,
    Violation, WithCommandChange,
};

const AXES: [&str; 3] = ["cmd_x", "cmd_y", "cmd_z"];

/// Names of the entries of state and command.
#[derive(Debug, Clone)]
pub(super) struct Names {
    /// The state's.
    pub state: Vec<String>,
    /// The command's.
    pub command: Vec<String>,
}

impl Names {
    /// The command moves the quadrotor, and nothing else.
    pub fn positions(state: Vec<String>) -> Self {
        Self {
            state,
            command: AXES.map(str::to_owned).to_vec(),
        }
    }
}

/// The solution, and if there is none, what it would take.
fn solve<D: Dynamics + ?Sized>(
    problem: &Problem,
    dynamics: &D,
    options: &Options,
) -> Result<(Solution, Vec<Loosening>), ProblemError> {
    let mut solver = Solver::new(problem, dynamics, options.clone())?;
    let solution = solver.solve().clone();
    let loosenings = match solution.status {
        Status::ProbablyInfeasible => Loosening::find(problem, dynamics, options, &solution)?,
        _ => Vec::new(),
    };
    Ok((solution, loosenings))
}

/// A problem, posed with what changes of the command cost if the task says so, and solved.
pub(super) struct Optimized {
    /// As posed, with all that joins the state.
    pub problem: Problem,
    pub solution: Solution,
    /// The states without what cost on changes joins (N × n).
    pub states: Vec<f64>,
    /// Where constraints are violated for all that the solver could do: bounds that would have to move.
    loosenings: Vec<Loosening>,
    /// Names in the problem.
    names: Names,
}

impl Optimized {
    /// Solves `problem` on `dynamics`, whose entries of state and command have these `names`, with the task's cost on
    /// changes of the command and its constraints.
    pub fn new(
        task: &Task,
        problem: &Problem,
        dynamics: &dyn Dynamics,
        names: &Names,
        constraints: &Constraints,
        options: &PlanOptions,
    ) -> Result<Self, ProblemError> {
        if constraints.is_empty() {
            return Self::with_change(task, problem, dynamics, names, options);
        }
        let watched = constraints.watch(dynamics);
        let posed = constraints.pose(&watched, problem);
        let joined = Names {
            state: constraints.names(&watched, &names.state),
            command: names.command.clone(),
        };
        let optimized = Self::with_change(task, &posed, &watched, &joined, options)?;
        Ok(Self {
            states: watched.own_states(&optimized.states),
            ..optimized
        })
    }

    /// The same without constraints.
    pub fn with_change(
        task: &Task,
        problem: &Problem,
        dynamics: &dyn Dynamics,
        names: &Names,
        options: &PlanOptions,
    ) -> Result<Self, ProblemError> {
        let Some(change) = task.command_change else {
            let (solution, loosenings) = solve(problem, dynamics, &options.solver)?;
            return Ok(Self {
                problem: problem.clone(),
                states: solution.states.clone(),
                solution,
                loosenings,
                names: names.clone(),
            });
        };
        let joined = WithCommandChange::new(dynamics);
        // At rest the command is where the quadrotor is, and nothing grows.
        let mut before = problem.start[..AXES.len()].to_vec();
        before.resize(problem.command_len(), 0.0);
        let largest = change.max_m.unwrap_or(f64::INFINITY);
        let problem = joined.pose(problem, &before, change.weight, largest);
        let (solution, loosenings) = solve(&problem, &joined, &options.solver)?;
        Ok(Self {
            states: joined.own_states(&solution.states),
            names: Names {
                state: joined.names(&names.state, &names.command),
                command: names.command.clone(),
            },
            problem,
            solution,
            loosenings,
        })
    }

    /// How the solve ended; `motion` is what the plan shows.
    pub fn summarize(&self, motion: &Solution, reference: &Reference, options: &PlanOptions) -> SolveSummary {
        let Self {
            problem,
            solution,
            names,
            ..
        } = self;
        let constraint = |source: ConstraintSource, index: usize| {
            let signal = &names.state[index];
            match source {
                ConstraintSource::Equality(i) => format!("{signal} = {}", problem.equalities[i].value),
                ConstraintSource::StateBound(i) => {
                    let bound = &problem.state_bounds[i];
                    format!("{signal} in [{}, {}]", bound.lower, bound.upper)
                }
            }
        };
        let words = |violation: &Violation| {
            let Violation {
                source,
                index,
                first_knot,
                last_knot,
                worst_knot,
                violation,
            } = *violation;
            let mut knots = knots(first_knot, last_knot);
            if first_knot < last_knot {
                knots += &format!(", most at {worst_knot}");
            }
            let constraint = constraint(source, index);
            format!("{constraint} at {knots}: off by {violation:.3e}; relaxed by that, it would hold")
        };
        let loosened = |loosening: &Loosening| {
            let name = match loosening.bounds {
                Bounds::Command(entry) => &names.command[entry],
                Bounds::State(index) => &names.state[index],
            };
            let knots = knots(loosening.first_knot, loosening.last_knot);
            let outcome = match loosening.status {
                Status::Converged => "the task is solved",
                _ => "it still is not",
            };
            let by = loosening.by;
            format!("{name} is at its bounds at {knots}; with these alone moved out by {by:.1e} {outcome}")
        };
        let on_states = solution.multipliers.iter().map(|active| Sensitivity {
            constraint: constraint(active.source, active.index),
            knot: active.knot,
            multiplier: active.multiplier,
        });
        let command_len = problem.command_len();
        let on_commands = solution
            .command_multipliers
            .iter()
            .enumerate()
            .map(|(i, &multiplier)| {
                let side = if multiplier > 0.0 { "upper" } else { "lower" };
                Sensitivity {
                    constraint: format!("{} at its {side} bound", names.command[i % command_len]),
                    knot: i / command_len,
                    multiplier,
                }
            });
        let active = |sensitivity: &Sensitivity| sensitivity.multiplier != 0.0;
        let sensitivities = on_states.chain(on_commands).filter(active).collect();
        let violated = solution.diagnosis(options.solver.violation_tolerance);
        SolveSummary {
            status: solution.status.name().to_owned(),
            converged: solution.status == Status::Converged,
            cost: solution.cost,
            max_violation: solution.max_violation,
            stationarity: solution.stationarity,
            iterations: solution.iterations,
            violated: violated.iter().map(words).collect(),
            loosened: self.loosenings.iter().map(loosened).collect(),
            predicted_error_m: mean_error_m(reference, &motion.states),
            sensitivities,
        }
    }
}

fn knots(first: usize, last: usize) -> String {
    if first == last {
        format!("knot {first}")
    } else {
        format!("knots {first} to {last}")
    }
}
