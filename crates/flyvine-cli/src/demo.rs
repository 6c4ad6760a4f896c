//! `flyvine demo`: the paper's whole experiment on the built-in vehicle.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::control::supervisor::{Limits, Room};
use flyvine::control::{End, Flying, OpenLoop, Trajectory, fly, fly_plan};
use flyvine::flight::{Corner, Flight, HygieneOptions, clean, write_flight};
use flyvine::link::Feedforward;
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{Bank, FamilyOptions, FitOptions, check, rest_state};
use flyvine::report::paper::{PublishedError, published_error};
use flyvine::report::{Experiment, ExperimentKind, Results, RunSummary, Score};
use flyvine::run::{experiment_folder, read_results, write_experiment, write_report};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{
    CommandChange, Plan, PlanOptions, Task, TaskError, TrainingFlight, make_plan, test_flight,
    training_flights,
};
use indicatif::ProgressBar;
use rayon::prelude::*;

use crate::arm_shape::WatchedVehicle;
use crate::check::check_table;
use crate::console::{centimetres, print, progress, say, table};
use crate::fit::{FamilyChoice, say_outcome, write_json};
use crate::fit_progress;
use crate::flights::say_findings;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// The tasks of the paper, as shipped in examples/tasks.
const TASKS: [&str; 13] = [
    include_str!("../../../examples/tasks/lemniscate_10s_ES.toml"),
    include_str!("../../../examples/tasks/lemniscate_10s_IS.toml"),
    include_str!("../../../examples/tasks/lemniscate_10s_EL.toml"),
    include_str!("../../../examples/tasks/lemniscate_10s_IL.toml"),
    include_str!("../../../examples/tasks/lemniscate_5s_ES.toml"),
    include_str!("../../../examples/tasks/lemniscate_5s_IS.toml"),
    include_str!("../../../examples/tasks/lemniscate_5s_EL.toml"),
    include_str!("../../../examples/tasks/lemniscate_5s_IL.toml"),
    include_str!("../../../examples/tasks/swing_ES.toml"),
    include_str!("../../../examples/tasks/swing_IS.toml"),
    include_str!("../../../examples/tasks/swing_EL.toml"),
    include_str!("../../../examples/tasks/swing_IL.toml"),
    include_str!("../../../examples/tasks/deploy_5s.toml"),
];

/// What keeps commands smooth whose velocities are sent.
const VELOCITY_CHANGE: CommandChange = CommandChange {
    weight: 30.0,
    max_m: None,
};

/// Do the paper's experiment on the built-in vehicle: train, fit, check, plan all 13 motions, fly them open loop, score
/// them and write a report. Needs nothing, opens nothing, takes seconds on two cores with the paper's models
/// (`--family lag`) and a minute or two with the physical ones.
#[derive(Args)]
pub struct DemoArguments {
    /// Run folder to write; it must not exist or be empty.
    #[arg(long, value_name = "DIR", default_value = "run-demo")]
    out: PathBuf,
    /// Seed of everything random: the same seed makes the same files, bit for bit.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Family of the models that everything is planned on: `lag` is the paper's, `physical` predicts better.
    #[arg(long, value_enum, default_value_t = FamilyChoice::Lag)]
    family: FamilyChoice,
    /// Send velocities beside positions, in training and in flight: the vehicle's velocity loop is fed forward. Training commands
    /// are smoothed, and changes of commands have a price.
    #[arg(long)]
    feedforward: bool,
}

/// Runs `flyvine demo`.
pub fn run(arguments: &DemoArguments) -> CommandResult {
    let folder = arguments.out.as_path();
    if folder.exists() && std::fs::read_dir(folder).or_input()?.next().is_some() {
        return bad_input(format!(
            "--out {}: the folder is not empty; nothing is overwritten",
            folder.display()
        ));
    }
    let seed = arguments.seed;
    let feedforward = match arguments.feedforward {
        true => Feedforward::Velocity,
        false => Feedforward::None,
    };
    let recordings = fly_training(folder, seed, feedforward)?;
    let (bank, mut outcome) = identify(folder, &recordings, arguments.family)?;
    let plans = plan_tasks(&bank, feedforward)?;
    fly_plans(folder, &plans, seed)?;

    let summary = RunSummary {
        title: "Flying vine: the paper's experiment on the simulated vehicle".to_owned(),
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        vehicle: "built-in simulated vehicle".to_owned(),
        controller: "open loop".to_owned(),
        seed: Some(seed),
        ..RunSummary::default()
    };
    write_json(&folder.join("run.json"), &summary)?;
    say("writing the report …");
    let results = read_results(folder, &mut say_findings).or_internal()?;
    for experiment in &results.experiments {
        if let Some(score) = &experiment.score {
            write_json(
                &experiment_folder(folder, &experiment.name).join("score.json"),
                score,
            )?;
        }
    }
    let page = write_report(folder, &results).or_internal()?;
    print(&score_table(&results))?;
    print(&format!("report: {}", page.display()))?;
    let flown = |score: &Score| score.knots_not_flown == 0;
    let trusted =
        |experiment: &Experiment| experiment.solver.converged && experiment.score.as_ref().is_some_and(flown);
    if !results.experiments.iter().all(trusted) {
        outcome = Outcome::Untrusted;
    }
    Ok(outcome)
}

/// Training and test flights at the four corners.
struct Recordings {
    training: Vec<Flight>,
    test: Vec<Flight>,
}

fn fly_training(folder: &Path, seed: u64, feedforward: Feedforward) -> Result<Recordings, Failure> {
    let jobs: Vec<(Corner, TrainingFlight)> = Corner::ALL
        .into_iter()
        .flat_map(|corner| {
            let flights = training_flights(seed).into_iter().chain([test_flight(seed)]);
            flights.map(move |flight| match feedforward {
                Feedforward::None => (corner, flight),
                Feedforward::Velocity => (corner, flight.smoothed()),
            })
        })
        .collect();
    let bar = progress(jobs.len() as u64, "training");
    let flights = in_parallel(&jobs, &bar, |index, (corner, training)| {
        let seed = seed.wrapping_add(1000 + index as u64);
        let mut flight = fly_commands(training, *corner, feedforward, seed)?;
        flight.name = format!("{}_{}", corner.label(), training.name);
        Ok(flight)
    })?;
    let mut recordings = Recordings {
        training: Vec::new(),
        test: Vec::new(),
    };
    let mut hygiene = Vec::new();
    for (mut flight, (_, training)) in flights.into_iter().zip(&jobs) {
        let is_test = training.name == "test_mixed";
        let place = if is_test { "test" } else { "training" };
        write_flight(&folder.join(place).join(format!("{}.csv", flight.name)), &flight).or_internal()?;
        hygiene.push(clean(&mut flight, &HygieneOptions::default()));
        if is_test {
            &mut recordings.test
        } else {
            &mut recordings.training
        }
        .push(flight);
    }
    write_json(&folder.join("hygiene.json"), &hygiene)?;
    Ok(recordings)
}

/// Flies bare commands on the built-in vehicle.
fn fly_commands(
    training: &TrainingFlight,
    corner: Corner,
    feedforward: Feedforward,
    seed: u64,
) -> Result<Flight, Failure> {
    let configuration = corner.configuration();
    let knots = training.commands.len() + 1;
    let unbounded = f64::INFINITY;
    let trajectory = Trajectory::new(
        training.commands.clone(),
        vec![rest_state(configuration, 1); knots],
        Vec::new(),
        vec![configuration; knots],
        [-unbounded; 3],
        [unbounded; 3],
    )
    .or_internal()?
    .with_feedforward(feedforward);
    // Training shows the model more than the tasks need, and the limp arm stretches in violent swings.
    let room = Room {
        x_m: [-2.5, 2.5],
        y_m: [-2.5, 2.5],
        ..Room::default()
    };
    let limits = Limits {
        room,
        reach_margin_m: 0.3,
        ..Limits::default()
    };
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).or_internal()?;
    let outcome = fly(
        &trajectory,
        &mut OpenLoop::new(&trajectory),
        limits,
        &mut vehicle,
        seed,
        &mut |_, _| ControlFlow::Continue(()),
    )
    .or_internal()?;
    if let End::Aborted { t_s, cause } = outcome.end {
        say(&format!(
            "warning: training flight {} was aborted at {t_s:.2} s: {cause}",
            training.name
        ));
    }
    Ok(outcome.flight)
}

fn identify(
    folder: &Path,
    recordings: &Recordings,
    family: FamilyChoice,
) -> Result<(Bank, Outcome), Failure> {
    let options = FamilyOptions {
        families: family.families(),
        lag: FitOptions::default(),
        physical: PhysicalFitOptions::default(),
    };
    say("fitting four models …");
    let (bank, report) = fit_progress::fit(&recordings.training, &options)?;
    let noise = fit_progress::identify(&bank, &recordings.training)?;
    let bank = bank.with_noise(noise.map(|noise| noise.levels)).or_internal()?;
    bank.write(&folder.join("bank.json")).or_internal()?;
    write_json(&folder.join("fit.json"), &report)?;
    let checked = check(&bank, &recordings.test).or_internal()?;
    write_json(&folder.join("check.json"), &checked)?;
    print(&check_table(&checked))?;
    Ok((bank, say_outcome(&report)))
}

fn plan_tasks(bank: &Bank, feedforward: Feedforward) -> Result<Vec<Plan>, Failure> {
    let tasks = TASKS
        .iter()
        .map(|text| {
            let mut task = Task::parse(text, "shipped task")?;
            if !feedforward.is_none() {
                task.feedforward = feedforward;
                task.command_change.get_or_insert(VELOCITY_CHANGE);
            }
            Ok(task)
        })
        .collect::<Result<Vec<_>, TaskError>>()
        .or_internal()?;
    let bar = progress(tasks.len() as u64, "planning");
    in_parallel(&tasks, &bar, |_, task| {
        make_plan(task, bank, &PlanOptions::default()).or_internal()
    })
}

/// Flies every plan and writes its experiment.
fn fly_plans(folder: &Path, plans: &[Plan], seed: u64) -> Result<(), Failure> {
    let bar = progress(plans.len() as u64, "flying");
    in_parallel(plans, &bar, |index, plan| {
        let vehicle = SimulatedVehicle::new(VehicleParameters::default()).or_internal()?;
        let mut vehicle = WatchedVehicle::new(vehicle);
        let seed = seed.wrapping_add(2000 + index as u64);
        let outcome = fly_plan(
            plan,
            &Flying::default(),
            Limits::default(),
            &mut vehicle,
            seed,
            &mut |_, _| ControlFlow::Continue(()),
        )
        .or_internal()?;
        let arm = vehicle.into_shapes(outcome.flight.samples.len());
        write_experiment(folder, plan, &outcome.flight, &arm).or_internal()?;
        if let End::Aborted { t_s, cause } = outcome.end {
            say(&format!(
                "warning: {} was aborted at {t_s:.2} s: {cause}",
                plan.task.name
            ));
        }
        Ok(())
    })?;
    Ok(())
}

/// Runs `job` on every item on all cores; results keep the items' order.
fn in_parallel<T: Sync, R: Send>(
    items: &[T],
    bar: &ProgressBar,
    job: impl Fn(usize, &T) -> Result<R, Failure> + Sync,
) -> Result<Vec<R>, Failure> {
    let results = items
        .par_iter()
        .enumerate()
        .map(|(index, item)| {
            let result = job(index, item);
            bar.inc(1);
            result
        })
        .collect();
    bar.finish_and_clear();
    results
}

/// Ours beside the paper's published numbers.
fn score_table(results: &Results) -> String {
    let rows = results.experiments_in_order().into_iter().map(|experiment| {
        let column = |value: fn(&Score) -> f64| {
            let score = experiment.score.as_ref();
            score.map_or("aborted".to_owned(), |score| centimetres(value(score)))
        };
        let miss = experiment.score.as_ref().and_then(|score| score.target_miss_m);
        let published =
            published_error(experiment).map_or("–".to_owned(), |PublishedError { low_m, high_m }| {
                let compared = match experiment.kind {
                    ExperimentKind::Lemniscate | ExperimentKind::Waypoints => "reference",
                    ExperimentKind::Swing | ExperimentKind::Deploy => "prediction",
                };
                let range = if low_m == high_m {
                    format!("{:.0}", 100.0 * low_m)
                } else {
                    format!("{:.0}–{:.0}", 100.0 * low_m, 100.0 * high_m)
                };
                format!("{range} ({compared})")
            });
        vec![
            experiment.name.clone(),
            experiment.solver.status.clone(),
            column(|score| score.ee_vs_reference.mean_m),
            column(|score| score.ee_vs_prediction.mean_m),
            miss.map_or(String::new(), centimetres),
            published,
        ]
    });
    let header = [
        "mean EE error, cm",
        "plan",
        "to reference",
        "to prediction",
        "target miss",
        "paper, hardware",
    ];
    table(&header, rows)
}
