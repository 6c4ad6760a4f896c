//! `flyvine plan`: a task and a bank in, a plan out.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::file::sha256_hex;
use flyvine::task::{Plan, PlanOptions, Task, make_ensemble_plan, make_plan, write_plan};

use crate::console::{centimetres, print, print_json, say};
use crate::flights::read_bank;
use crate::outcome::{Blame, CommandResult, Failure, Outcome};

/// Plan a task on a bank: the commands that make the end effector go where the task says.
///
/// The result carries its task, its bank, the predicted motion and time-varying feedback gains. Exit code 3 if the
/// solver did not converge or the bank was extrapolated; the best commands found are written all the same.
///
/// Several banks are an ensemble (fits of other flights, say): one command is planned for all of them, the mean of
/// their costs is minimized, and every one keeps the state bounds. Of a swing's target it minimizes their mean distance.
///
///   flyvine plan examples/tasks/swing_ES.toml --bank bank.json --out plan.json
///   flyvine plan examples/tasks/swing_ES.toml --bank a.json --bank b.json --bank c.json --out plan.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct PlanArguments {
    /// The task (see examples/tasks).
    #[arg(value_name = "TASK.toml")]
    task: PathBuf,
    /// The models to plan on; several are an ensemble, whose first is what the plan's gains and score refer to.
    #[arg(long = "bank", value_name = "BANK.json", required = true)]
    banks: Vec<PathBuf>,
    /// Where to write the plan.
    #[arg(long, value_name = "PLAN.json")]
    out: PathBuf,
    /// Also plan outside the configurations of the bank.
    #[arg(long)]
    extrapolate: bool,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine plan`.
pub fn run(arguments: &PlanArguments) -> CommandResult {
    let task = Task::read(&arguments.task).or_input()?;
    let mut banks = Vec::new();
    let mut hashes = Vec::new();
    for path in &arguments.banks {
        banks.push(read_bank(path, arguments.extrapolate)?);
        hashes.push(hash(path)?);
    }
    let options = PlanOptions {
        task_sha256: hash(&arguments.task)?,
        bank_sha256: hashes.join(" "),
        ..PlanOptions::default()
    };
    say(&format!("planning {} …", task.name));
    let plan = match banks.as_slice() {
        [bank] => make_plan(&task, bank, &options),
        banks => make_ensemble_plan(&task, banks, &options),
    }
    .or_input()?;
    write_plan(&arguments.out, &plan).or_internal()?;
    if arguments.json {
        print_json(
            &serde_json::json!({ "command_reference": plan.command_reference, "solve": plan.solve, "ensemble": plan.ensemble }),
        )?;
    } else {
        print(&describe(&plan))?;
    }
    say(&format!("wrote {}", arguments.out.display()));
    let extrapolated = plan
        .configurations
        .iter()
        .any(|configuration| banks.iter().any(|bank| !bank.covers(*configuration)));
    if extrapolated {
        say("warning: the bank was extrapolated: do not trust this plan");
    }
    Ok(if plan.solve.converged && !extrapolated {
        Outcome::Done
    } else {
        Outcome::Untrusted
    })
}

fn hash(path: &Path) -> Result<String, Failure> {
    Ok(sha256_hex(&std::fs::read(path).or_input()?))
}

/// What a person wants to know about a plan.
pub fn describe(plan: &Plan) -> String {
    let solve = &plan.solve;
    let mut text = format!(
        "{}: {} after {} iterations, cost {:.5}, violation {:.1e}, stationarity {:.1e}\n\
         predicted end effector: {} cm mean distance to the reference",
        plan.task.name,
        solve.status,
        solve.iterations,
        solve.cost,
        solve.max_violation,
        solve.stationarity,
        centimetres(solve.predicted_error_m)
    );
    let reference = &plan.command_reference;
    if let Some(shaping) = reference.shaping {
        text += &format!(
            "\ncommand reference: {} by {} knots, scaled by {:.3} (x) and {:.3} (y); alone it misses by {} cm",
            if reference.searched {
                "found, ahead"
            } else {
                "given, ahead"
            },
            shaping.shift_knots,
            shaping.scale[0],
            shaping.scale[1],
            centimetres(reference.rollout_error_m.unwrap_or(f64::NAN))
        );
    }
    for (member, prediction) in plan.ensemble.iter().enumerate() {
        text += &format!(
            "\nmember {member}: {} cm mean distance to the reference",
            centimetres(prediction.predicted_error_m)
        );
        if let Some(miss) = prediction.target_miss_m {
            text += &format!(", misses the target by {} cm", centimetres(miss));
        }
    }
    for constraint in &solve.violated {
        text += &format!("\nviolated: {constraint}");
    }
    for loosening in &solve.loosened {
        text += &format!("\nloosened: {loosening}");
    }
    text
}
