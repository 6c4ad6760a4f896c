//! `flyvine learn`: plan, fly, refit, and again.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::DT;
use flyvine::control::{End, Flying, fly_plan};
use flyvine::file::sha256_hex;
use flyvine::flight::{Flight, HygieneOptions, clean, write_flight};
use flyvine::model::{Bank, InputFile, Learner, Lesson};
use flyvine::report::Score;
use flyvine::run::{experiment_folder, score_flight};
use flyvine::task::{Motion, Plan, PlanOptions, Task, make_corrected_plan, write_plan};
use serde::Serialize;

use crate::console::{centimetres, print, print_json, say, table};
use crate::fit::write_json;
use crate::flights::load_flights;
use crate::fly::{OpenVehicle, open_vehicle, shortfall};
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Learn a task by flying it: plan, fly open loop, refit the model to all data, plan again.
///
/// Every refit sees the recordings that the bank was fitted on and, weighted, the flights of the task so far, within a
/// trust region about the parameters. How much the new flights may weigh is decided on recordings that are held out: a
/// refit that predicts them worse is not accepted. What the model still misses, knot by knot, the next plan makes up
/// for; after a flight that was worse than the best so far, it goes half as far from the best one's plan. The best
/// flight's plan is kept as RUN_DIR/plan.json. Needs a bank of the physical family and a task of one configuration.
///
///   flyvine learn examples/tasks/swing_ES.toml --bank bank.json --vehicle sim --rounds 3 --out run
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct LearnArguments {
    /// The task.
    #[arg(value_name = "TASK.toml")]
    task: PathBuf,
    /// The models to begin with.
    #[arg(long, value_name = "BANK.json")]
    bank: PathBuf,
    /// What to fly on (see `flyvine fly`).
    #[arg(long, value_name = "VEHICLE")]
    vehicle: String,
    /// Refits; one more flight than that is flown.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Folder for plans, flights, scores and banks.
    #[arg(long, value_name = "RUN_DIR")]
    out: PathBuf,
    /// The recordings that the bank was fitted on, if they are no longer where they were.
    #[arg(long, value_name = "FLIGHT", num_args = 1..)]
    recordings: Vec<PathBuf>,
    /// Seed of the vehicle's noise in the first flight.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// One flight, and what was learnt from it.
#[derive(Serialize)]
struct Round {
    converged: bool,
    aborted: bool,
    /// What is to become small, m ([`miss_m`]); absent where the end effector was not seen.
    miss_m: Option<f64>,
    score: Score,
    /// `None` after the last flight.
    lesson: Option<Lesson>,
}

/// All flights.
#[derive(Serialize)]
struct Learnt {
    /// The flight whose plan was kept; `None`: none was flown to its end.
    best_round: Option<usize>,
    rounds: Vec<Round>,
}

/// Runs `flyvine learn`.
pub fn run(arguments: &LearnArguments) -> CommandResult {
    let task = Task::read(&arguments.task).or_input()?;
    let bank = Bank::read(&arguments.bank).or_input()?;
    let configurations = task.reference().configurations;
    let configuration = configurations[0];
    if configurations.iter().any(|other| *other != configuration) {
        return bad_input(format!(
            "{}: the arm's configuration changes during this task; expected one configuration to learn at",
            arguments.task.display()
        ));
    }
    let recordings = load_flights(&recordings(arguments, &bank)?)?;
    let mut learner = Learner::new(&bank, configuration, &recordings).or_input()?;
    say(&format!(
        "learning {} from {} recordings at its configuration",
        task.name,
        learner.recordings()
    ));
    let mut rounds = Vec::new();
    let mut best: Option<(usize, f64, Plan)> = None;
    for number in 0..=arguments.rounds {
        let folder = experiment_folder(&arguments.out, &format!("{}_round_{number}", task.name));
        let bank_path = arguments.out.join(format!("bank_round_{number}.json"));
        learner.bank().write(&bank_path).or_internal()?;
        let (mut round, plan, flight) = fly_round(arguments, &task, &learner, &bank_path, &folder, number)?;
        if round.score.rows_missing > 0 {
            say("warning: end-effector poses are missing from this flight");
        }
        let aborted = round.aborted;
        let miss_m = round.miss_m.unwrap_or(f64::INFINITY);
        if !aborted && best.as_ref().is_none_or(|(_, least, _)| miss_m < *least) {
            best = Some((number, miss_m, plan));
        }
        if number < arguments.rounds && !aborted {
            say(&format!(
                "round {number}: {}; refitting …",
                describe(&round.score)
            ));
            round.lesson = Some(learner.learn(flight, miss_m).or_input()?);
        }
        rounds.push(round);
        if aborted {
            say("warning: nothing is learnt from an aborted flight, and nothing more is flown");
            break;
        }
    }
    let learnt = Learnt {
        best_round: best.as_ref().map(|(number, ..)| *number),
        rounds,
    };
    write_json(&arguments.out.join("learn.json"), &learnt)?;
    if arguments.json {
        print_json(&learnt)?;
    } else {
        print(&round_table(&learnt.rounds))?;
    }
    let Some((number, _, plan)) = best else {
        say("warning: no flight was flown to its end");
        return Ok(Outcome::Untrusted);
    };
    let path = arguments.out.join("plan.json");
    write_plan(&path, &plan).or_internal()?;
    say(&format!(
        "flight {number} was the best: wrote its plan, {}",
        path.display()
    ));
    let best = &learnt.rounds[number];
    if !best.converged {
        say("warning: the best flight's plan did not converge");
    }
    let aborted = learnt.rounds.iter().any(|round| round.aborted);
    Ok(if best.converged && !aborted {
        Outcome::Done
    } else {
        Outcome::Untrusted
    })
}

/// Where the bank's recordings are: as given, or where the fit found them if they are still the same.
fn recordings(arguments: &LearnArguments, bank: &Bank) -> Result<Vec<PathBuf>, Failure> {
    if !arguments.recordings.is_empty() {
        return Ok(arguments.recordings.clone());
    }
    let mut paths = Vec::new();
    for input in &bank.provenance().inputs {
        let path = PathBuf::from(&input.path);
        match InputFile::of(&path) {
            Ok(found) if found.sha256 == input.sha256 => paths.push(path),
            Ok(_) => {
                return bad_input(format!(
                    "{}: is not what the bank was fitted on; give the recordings with --recordings",
                    input.path
                ));
            }
            Err(error) => {
                return bad_input(format!("{error}; give the bank's recordings with --recordings"));
            }
        }
    }
    Ok(paths)
}

/// Plans, flies and scores once; everything goes into `folder`.
fn fly_round(
    arguments: &LearnArguments,
    task: &Task,
    learner: &Learner,
    bank_path: &Path,
    folder: &Path,
    number: usize,
) -> Result<(Round, Plan, Flight), Failure> {
    let hash = |path: &Path| Ok::<_, Failure>(sha256_hex(&std::fs::read(path).or_input()?));
    let options = PlanOptions {
        task_sha256: hash(&arguments.task)?,
        bank_sha256: hash(bank_path)?,
        ..PlanOptions::default()
    };
    say(&format!("round {number}: planning {} …", task.name));
    let plan = make_corrected_plan(task, learner.bank(), learner.model_error_m(), &options).or_input()?;
    write_plan(&folder.join("plan.json"), &plan).or_internal()?;
    if let Some(shortfall) = shortfall(&plan) {
        say(&format!(
            "round {number}: warning: the plan {shortfall}, flown all the same"
        ));
    }
    let OpenVehicle {
        mut vehicle, limits, ..
    } = open_vehicle(&arguments.vehicle)?;
    let seed = arguments.seed + number as u64;
    let outcome = fly_plan(
        &plan,
        &Flying::default(),
        limits,
        vehicle.as_mut(),
        seed,
        &mut |_, _| ControlFlow::Continue(()),
    )
    .or_input()?;
    if let End::Aborted { t_s, cause } = &outcome.end {
        say(&format!("round {number}: flight aborted at {t_s:.2} s: {cause}"));
    }
    if let Err(error) = vehicle.close() {
        say(&format!(
            "warning: the vehicle did not end in good order: {error}"
        ));
    }
    let mut flight = outcome.flight;
    flight.name = format!("{}_round_{number}", task.name);
    write_flight(&folder.join("flight.csv"), &flight).or_internal()?;
    // Behind an abort the position was held for a while.
    flight.samples.truncate(plan.knots());
    clean(&mut flight, &HygieneOptions::default());
    let score = score_flight(&plan, &flight).or_input()?;
    write_json(&folder.join("score.json"), &score)?;
    let round = Round {
        converged: plan.solve.converged,
        aborted: matches!(outcome.end, End::Aborted { .. }),
        miss_m: miss_m(task, &score),
        score,
        lesson: None,
    };
    Ok((round, plan, flight))
}

/// What is to become small, m: of a swing, how far it missed its target and by how much its last step towards it was off;
/// of any other task, the mean distance from the reference. `None` where the end effector was not seen.
fn miss_m(task: &Task, score: &Score) -> Option<f64> {
    match task.motion() {
        Motion::Swing(swing) => {
            let [vx, vz] = score.target_velocity_m_s?;
            let [dx, dz] = swing.approach_m;
            Some(score.target_miss_m? + (vx * DT - dx).hypot(vz * DT - dz))
        }
        _ => Some(score.ee_vs_reference.mean_m),
    }
}

/// A score in a few words.
fn describe(score: &Score) -> String {
    match (score.target_miss_m, score.target_velocity_m_s) {
        (Some(miss), Some([vx, vz])) => format!(
            "target missed by {} cm at ({vx:.2}, {vz:.2}) m/s",
            centimetres(miss)
        ),
        _ => format!(
            "{} cm from the reference",
            centimetres(score.ee_vs_reference.mean_m)
        ),
    }
}

fn round_table(rounds: &[Round]) -> String {
    let rows = rounds.iter().enumerate().map(|(number, round)| {
        let score = &round.score;
        let error = |error: Option<flyvine::model::HeldOutError>| {
            error.map_or("–".to_owned(), |error| centimetres(error.mean_m))
        };
        let (before, after, weight) =
            round
                .lesson
                .as_ref()
                .map_or(("–".to_owned(), "–".to_owned(), "–".to_owned()), |lesson| {
                    (
                        error(lesson.before),
                        error(lesson.trials.last().and_then(|trial| trial.held_out)),
                        lesson
                            .accepted
                            .map_or("refused".to_owned(), |weight| weight.to_string()),
                    )
                });
        vec![
            format!(
                "{number}{}",
                if round.converged {
                    ""
                } else {
                    " (plan not converged)"
                }
            ),
            score.target_miss_m.map_or("–".to_owned(), centimetres),
            score
                .target_velocity_m_s
                .map_or("–".to_owned(), |[vx, vz]| format!("{vx:.2}, {vz:.2}")),
            centimetres(score.ee_vs_reference.mean_m),
            centimetres(score.ee_vs_prediction.mean_m),
            before,
            after,
            weight,
        ]
    });
    let header = [
        "flight",
        "target miss, cm",
        "velocity, m/s",
        "to reference, cm",
        "to prediction, cm",
        "held-out before, cm",
        "held-out after, cm",
        "weight",
    ];
    table(&header, rows)
}
