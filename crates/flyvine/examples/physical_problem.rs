//! A task on a physical bank as a problem file for other solvers, with flyvine's own solution and its time:
//!
//! ```text
//! cargo run --release -p flyvine --example physical_problem -- BANK.json TASK.toml [RUNS]
//! ```
//!
//! Prints one JSON object: the model's parameters, the problem (keys as in `bench/FORMAT.md`), and flyvine's commands,
//! states, cost and process-CPU times. `bench/physical.py` runs it beside CasADi and IPOPT.

#![allow(clippy::print_stdout)] // an example is a program

use flyvine::model::{Bank, Model};
use flyvine::task::{PlanOptions, Task, make_plan};
use flyvine::trajopt::{Options, Solver};
use rustix::time::{ClockId, clock_gettime};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let bank = Bank::read(arguments.next().ok_or("expected a bank")?.as_ref())?;
    let task = Task::read(arguments.next().ok_or("expected a task")?.as_ref())?;
    let runs: usize = arguments.next().map_or(Ok(5), |runs| runs.parse())?;

    let plan = make_plan(&task, &bank, &PlanOptions::default())?;
    let problem = plan.problem()?;
    let dynamics = bank.scheduled(&plan.configurations)?;
    let Model::Physical(model) = dynamics.at_knot(0) else {
        return Err("expected a bank of the physical family".into());
    };
    let mut solver = Solver::new(&problem, &dynamics, Options::default())?;
    let times: Vec<f64> = (0..runs.max(1))
        .map(|_| {
            let started = cpu_ms();
            solver.solve();
            cpu_ms() - started
        })
        .collect();
    let solution = solver.solution();
    println!(
        "{}",
        serde_json::json!({
            "name": task.name,
            "parameters": model.parameters,
            "length_m": model.arm.length_m,
            "N": problem.knots,
            "z0": problem.start,
            "zref": problem.state_reference,
            "uref": problem.command_reference,
            "Q": problem.state_weight,
            "R": problem.command_weight,
            "umin": problem.command_lower,
            "umax": problem.command_upper,
            "u_init": problem.command_guess,
            "u": solution.commands,
            "states": solution.states,
            "status": solution.status.name(),
            "cost": solution.cost,
            "iterations": solution.iterations,
            "factorizations": solution.factorizations,
            "solve_ms_all": times,
        })
    );
    Ok(())
}

fn cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}
