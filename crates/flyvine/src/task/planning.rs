//! From a task and a bank, or an ensemble of banks, to a plan.

use super::constraints::Constraints;
use super::growth;
use super::plan::{
    CommandReferenceSummary, MemberPrediction, PLAN_SCHEMA_VERSION, Plan, PlanError, PlanOptions, Provenance,
    SCHEMA,
};
use super::problem::make_up_for;
use super::solve::{Names, Optimized};
use super::{CommandReference, Motion, Reference, Task, TaskError, pose_problem};
use crate::flight::{Configuration, SIGNALS};
use crate::link::Feedforward;
use crate::model::{Bank, Model, ModelError, ScheduledModel};
use crate::trajopt::{
    Dynamics, Ensemble, EnsembleError, Problem, ProblemError, Solution, Solver, WithOutputs,
};

/// Cost per metre of an ensemble's mean distance from a swing's target, where the task names no price.
const TARGET_PRICE: f64 = 3000.0;

/// Plans `task` on `bank`, for flights that are sent positions only ([`Bank::sent_positions_only`]) unless the task's
/// [`feedforward`](Task::feedforward) says otherwise.
///
/// # Errors
/// The bank does not cover the task's configurations, it was fitted to flights that were not sent the velocities which the
/// task's are, or the problem is malformed. A solve that does not
/// converge is reported in [`Plan::solve`], with the best commands found.
pub fn make_plan(task: &Task, bank: &Bank, options: &PlanOptions) -> Result<Plan, PlanError> {
    make_corrected_plan(task, bank, &[], options)
}

/// Plans `task` on `bank` and makes up for what the end effector was off the model's prediction at every knot of an
/// earlier flight, `model_error_m` (N × 3; empty: nothing is known). References, demands and bounds on the end effector
/// are met by prediction plus error ("modifier adaptation": Marchetti, Chachuat & Bonvin 2009, J. Process Control 19);
/// obstacles and the supported region are the model's own.
///
/// # Errors
/// As [`make_plan`]; an error that is not finite, or not of N knots.
pub fn make_corrected_plan(
    task: &Task,
    bank: &Bank,
    model_error_m: &[[f64; 3]],
    options: &PlanOptions,
) -> Result<Plan, PlanError> {
    let finite = model_error_m.iter().flatten().all(|value| value.is_finite());
    if !finite || !(model_error_m.is_empty() || model_error_m.len() == task.knots()) {
        let found = format!(
            "{} rows{}",
            model_error_m.len(),
            if finite { "" } else { ", not all finite" }
        );
        let expected = "none, or a finite x, y and z for every knot";
        return Err(TaskError::value(&task.name, "model_error_m", found, expected).into());
    }
    let malformed = |source| PlanError::Problem {
        task: task.name.clone(),
        source,
    };
    let bank = &as_flown(task, bank)?;
    let reference = task.reference();
    let model = OnBank::new(task, &reference, bank)?;
    let command_reference = model.command_reference(task, &reference);
    let problem = model.problem(task, &reference, &command_reference, model_error_m);
    let constraints = constraints(task, &reference.configurations, bank, &model.start)?;
    let names = Names::positions(model.names());
    let Some(growth) = &task.growth else {
        let optimized = Optimized::new(task, &problem, &model.dynamics, &names, &constraints, options);
        let optimized = optimized.map_err(malformed)?;
        let mut regulator;
        let motion = if optimized.problem == problem {
            &optimized.solution
        } else {
            regulator = Solver::new(&problem, &model.dynamics, options.solver.clone()).map_err(malformed)?;
            regulator
                .regulate(&optimized.solution.commands)
                .map_err(malformed)?
        };
        let plan = plan(
            task,
            bank,
            &reference,
            &command_reference,
            &optimized,
            motion,
            options,
        );
        return Ok(plan.making_up_for(model_error_m));
    };

    if !task.feedforward.is_none() && matches!(bank.models()[0].model, Model::Lag(_)) {
        let expected = "a bank of the physical family, where configurations are chosen ([growth])";
        return Err(TaskError::value(&task.name, "feedforward", "a bank of the lag family", expected).into());
    }
    let (growing, posed) = growth.pose(task, bank, &problem);
    let [length, pressure] = growth::PARAMETERS.map(str::to_owned);
    let rates = [&length, &pressure].map(|parameter| format!("change of {parameter}"));
    let names = Names {
        state: growing.names(&names.state, &[length, pressure]),
        command: [names.command, rates.to_vec()].concat(),
    };
    let optimized =
        Optimized::new(task, &posed, &growing, &names, &constraints, options).map_err(malformed)?;
    // What is flown is the motion of the bank along the configurations that were chosen.
    let reference = Reference {
        configurations: growth.configurations(bank, &growing, &optimized.states),
        ..reference
    };
    let along = OnBank::new(task, &reference, bank)?;
    let commands: Vec<f64> = optimized
        .solution
        .commands
        .chunks_exact(posed.command_len())
        .flat_map(|command| command[..problem.command_len()].to_vec())
        .collect();
    let mut regulator = Solver::new(&problem, &along.dynamics, options.solver.clone()).map_err(malformed)?;
    let motion = regulator.regulate(&commands).map_err(malformed)?;
    let plan = plan(
        task,
        bank,
        &reference,
        &command_reference,
        &optimized,
        motion,
        options,
    );
    Ok(plan.making_up_for(model_error_m))
}

/// Plans `task` on several banks at once: one command, every bank's own motion.
///
/// Minimized is the mean of the members' costs; every member keeps the bounds on states and outputs. What the task
/// demands exactly (a swing's target, exact waypoints) no command can give all members: their mean distance from it
/// costs the task's target price, or 3000 per metre. States and gains of the plan are those on the first bank.
///
/// # Errors
/// As [`make_plan`], and banks whose models differ in size.
pub fn make_ensemble_plan(task: &Task, banks: &[Bank], options: &PlanOptions) -> Result<Plan, PlanError> {
    let reference = task.reference();
    let no_ensemble = |source| PlanError::Ensemble {
        task: task.name.clone(),
        source,
    };
    let malformed = |source: ProblemError| PlanError::Problem {
        task: task.name.clone(),
        source,
    };
    let banks: Vec<Bank> = banks
        .iter()
        .map(|bank| as_flown(task, bank))
        .collect::<Result<_, _>>()?;
    let first_bank = banks.first().ok_or(EnsembleError::Empty).map_err(no_ensemble)?;
    let models: Vec<OnBank> = banks
        .iter()
        .map(|bank| OnBank::new(task, &reference, bank))
        .collect::<Result<_, _>>()?;
    let command_reference = models[0].command_reference(task, &reference);
    let problems: Vec<Problem> = models
        .iter()
        .map(|model| model.problem(task, &reference, &command_reference, &[]))
        .collect();
    if task.growth.is_some() {
        let expected = "one bank: for an ensemble, give the configurations ([deploy])";
        return Err(TaskError::value(&task.name, "growth", "an ensemble of banks", expected).into());
    }
    let constraints = constraints(task, &reference.configurations, first_bank, &models[0].start)?;
    let watched: Vec<WithOutputs<&ScheduledModel>> = models
        .iter()
        .map(|model| constraints.watch(&model.dynamics))
        .collect();
    let posed: Vec<Problem> = watched
        .iter()
        .zip(&problems)
        .map(|(watched, problem)| constraints.pose(watched, problem))
        .collect();
    let member_names: Vec<Vec<String>> = watched
        .iter()
        .zip(&models)
        .map(|(watched, model)| constraints.names(watched, &model.names()))
        .collect();
    let ensemble = Ensemble::new(watched.iter().collect()).map_err(no_ensemble)?;
    let price = match task.motion() {
        Motion::Swing(swing) => swing.target_price.unwrap_or(TARGET_PRICE),
        _ => TARGET_PRICE,
    };
    let problem = ensemble.pose(&posed, price).map_err(no_ensemble)?;
    let names: Vec<String> = (0..problem.start.len())
        .map(|index| {
            let (member, index) = ensemble.locate(index);
            format!("member {member}: {}", member_names[member][index])
        })
        .collect();
    let names = Names::positions(names);
    let optimized = Optimized::with_change(task, &problem, &ensemble, &names, options).map_err(malformed)?;

    let mut first =
        Solver::new(&problems[0], &models[0].dynamics, options.solver.clone()).map_err(malformed)?;
    let regulated = first.regulate(&optimized.solution.commands).map_err(malformed)?;
    let mut plan = plan(
        task,
        first_bank,
        &reference,
        &command_reference,
        &optimized,
        regulated,
        options,
    );
    plan.ensemble = (0..banks.len())
        .map(|member| {
            let states = ensemble.member_states(member, &optimized.states);
            let states = watched[member].own_states(&states);
            predict(task, &reference, &problems[member], &states)
        })
        .collect();
    Ok(plan)
}

/// `bank` for flights that are sent what `task` says.
fn as_flown(task: &Task, bank: &Bank) -> Result<Bank, PlanError> {
    match task.feedforward {
        Feedforward::None => Ok(bank.sent_positions_only()),
        Feedforward::Velocity if bank.feedforward() == Feedforward::Velocity => Ok(bank.clone()),
        Feedforward::Velocity => Err(PlanError::NoFeedforward {
            task: task.name.clone(),
        }),
    }
}

/// What `task` demands of the whole motion from `start` on; the supported region is that of `bank`.
fn constraints(
    task: &Task,
    configurations: &[Configuration],
    bank: &Bank,
    start: &[f64],
) -> Result<Constraints, PlanError> {
    if task.support.is_some() && bank.support().is_none() {
        return Err(PlanError::NoSupport {
            task: task.name.clone(),
        });
    }
    let constraints = Constraints::new(task, configurations, bank.support());
    match constraints.violated_at(start) {
        None => Ok(constraints),
        Some((name, metres)) => {
            let found = format!("{name} at the start, margin taken off: {metres:.3} m");
            let expected = "quadrotor and arm clear of every obstacle where the motion starts";
            Err(TaskError::value(&task.name, "obstacles", found, expected).into())
        }
    }
}

impl Plan {
    /// The model that the plan was made on (the first bank's, if it was made for several), along its configurations.
    ///
    /// # Errors
    /// The bank does not cover the plan's configurations.
    pub fn model(&self) -> Result<ScheduledModel, ModelError> {
        let model = self.bank.scheduled(&self.configurations)?;
        Ok(model.with_feedforward(self.task.feedforward))
    }

    /// The optimal-control problem that the plan solves (on its first bank, if it was made for several).
    ///
    /// # Errors
    /// The bank does not cover the plan's configurations.
    pub fn problem(&self) -> Result<Problem, PlanError> {
        let reference = Reference {
            configurations: self.configurations.clone(),
            ..self.task.reference()
        };
        let model = OnBank::new(&self.task, &reference, &self.bank)?;
        let command_reference = model.command_reference(&self.task, &reference);
        Ok(model.problem(&self.task, &reference, &command_reference, &self.model_error_m))
    }

    /// The same plan, which was posed to make up for the model's error.
    fn making_up_for(mut self, model_error_m: &[[f64; 3]]) -> Self {
        if !model_error_m.is_empty() {
            self.model_error_m = model_error_m.to_vec();
            self.solve.predicted_error_m = mean_distance_m(&self.predicted_end_effector(), &self.reference);
        }
        self
    }

    /// What the plan's task demands of the whole motion.
    pub(crate) fn constraints(&self) -> Result<Constraints, PlanError> {
        constraints(&self.task, &self.configurations, &self.bank, &self.states[0])
    }
}

/// A bank along a task's configurations, and where it starts.
struct OnBank {
    dynamics: ScheduledModel,
    start: Vec<f64>,
}

impl OnBank {
    fn new(task: &Task, reference: &Reference, bank: &Bank) -> Result<Self, PlanError> {
        let dynamics = bank
            .scheduled(&reference.configurations)
            .map_err(|source| PlanError::Model {
                task: task.name.clone(),
                source,
            })?
            .with_feedforward(task.feedforward);
        if dynamics.command_len() != 3 {
            return Err(PlanError::Inputs {
                task: task.name.clone(),
                found: dynamics.command_len(),
            });
        }
        let start = dynamics.rest_state(task.configuration);
        Ok(Self { dynamics, start })
    }

    /// A name for every entry of the model's state.
    fn names(&self) -> Vec<String> {
        let signals = self.dynamics.at_knot(0).lags() * SIGNALS.len();
        (0..self.start.len())
            .map(|index| match index {
                _ if index < SIGNALS.len() => SIGNALS[index].to_owned(),
                _ if index < signals => format!("{} before", SIGNALS[index % SIGNALS.len()]),
                _ => "hidden state".to_owned(),
            })
            .collect()
    }

    fn command_reference(&self, task: &Task, reference: &Reference) -> CommandReference {
        CommandReference::build(task, reference, &self.dynamics, &self.start)
    }

    fn problem(
        &self,
        task: &Task,
        reference: &Reference,
        command_reference: &CommandReference,
        model_error_m: &[[f64; 3]],
    ) -> Problem {
        let lags = self.dynamics.at_knot(0).lags();
        let mut problem = pose_problem(task, reference, &command_reference.commands, &self.start, lags);
        if !model_error_m.is_empty() {
            make_up_for(&mut problem, model_error_m, lags);
        }
        problem
    }
}

/// The plan that flies `motion`, which `optimized` found.
fn plan(
    task: &Task,
    bank: &Bank,
    reference: &Reference,
    command_reference: &CommandReference,
    optimized: &Optimized,
    motion: &Solution,
    options: &PlanOptions,
) -> Plan {
    let state_len = motion.states.len() / reference.end_effector.len();
    let rows = |flat: &[f64], width: usize| flat.chunks_exact(width).map(<[f64]>::to_vec).collect::<Vec<_>>();
    Plan {
        schema: SCHEMA.to_owned(),
        schema_version: PLAN_SCHEMA_VERSION,
        task: task.clone(),
        commands: motion
            .commands
            .chunks_exact(3)
            .map(|u| [u[0], u[1], u[2]])
            .collect(),
        states: rows(&motion.states, state_len),
        gains: rows(&motion.gains, 3 * state_len),
        command_reference: CommandReferenceSummary {
            shaping: command_reference.shaping,
            searched: command_reference.shaping.is_some() && task.command_reference.is_none(),
            rollout_error_m: Some(command_reference.rollout_error_m).filter(|error| error.is_finite()),
        },
        solve: optimized.summarize(motion, reference, options),
        provenance: Provenance {
            tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).to_owned(),
            task_sha256: options.task_sha256.clone(),
            bank_sha256: options.bank_sha256.clone(),
        },
        configurations: reference.configurations.clone(),
        reference: reference.end_effector.clone(),
        bank: bank.clone(),
        model_error_m: Vec::new(),
        ensemble: Vec::new(),
    }
}

/// Mean distance from end effector to reference over flat states (N × n), m.
pub(super) fn mean_error_m(reference: &Reference, states: &[f64]) -> f64 {
    let knots = reference.end_effector.len();
    let tips: Vec<[f64; 3]> = states
        .chunks_exact(states.len() / knots)
        .map(|state| [state[6], state[7], state[8]])
        .collect();
    mean_distance_m(&tips, &reference.end_effector)
}

fn mean_distance_m(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let distance = |(a, b): (&[f64; 3], &[f64; 3])| {
        let squares = (0..3).map(|axis| (a[axis] - b[axis]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    a.iter().zip(b).map(distance).sum::<f64>() / a.len() as f64
}

fn predict(task: &Task, reference: &Reference, problem: &Problem, states: &[f64]) -> MemberPrediction {
    let state_len = problem.start.len();
    let target_miss_m = match task.motion() {
        Motion::Swing(swing) => {
            let state = &states[swing.target_knot() * state_len..][..state_len];
            Some((state[6] - swing.target_m[0]).hypot(state[8] - swing.target_m[1]))
        }
        _ => None,
    };
    let violations = problem.state_bounds.iter().flat_map(|bound| {
        (bound.first_knot..=bound.last_knot).map(|knot| {
            let value = states[knot * state_len + bound.index];
            (value - bound.upper).max(bound.lower - value)
        })
    });
    MemberPrediction {
        target_miss_m,
        predicted_error_m: mean_error_m(reference, states),
        max_violation: violations.fold(0.0, f64::max),
    }
}
