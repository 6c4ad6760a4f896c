//! A run: the folder with everything that one experiment used and made.
//!
//! ```text
//! run.json                         title, vehicle, controller, seed
//! training/*.csv, test/*.csv       recordings
//! bank.json, check.json, hygiene.json
//! experiments/NAME/plan.json, flight.csv, score.json; arm.json where the arm's shape is known
//! report.html, figures/*.svg       made from the files above, and only from them
//! ```

use std::path::{Path, PathBuf};

use flyvine::flight::{Flight, HygieneReport, Sample, read_flight};
use flyvine::model::{Bank, CheckReport};
use flyvine::report::{
    Experiment, ExperimentKind, Figure, Finding, FlightRollout, HorizonError, ModelDiagnostics, Results,
    RunSummary, SolverSummary, SwingTask, figures, html,
};
use flyvine::task::{Motion, Plan, read_plan};
use serde::de::DeserializeOwned;

use crate::arm_shape::ArmShapes;
use crate::flights::{configuration_label, load_flight};
use crate::outcome::{Blame, Failure, bad_input};
use crate::score::{score_flight, swing_target};

/// Reads everything a report shows.
pub fn read_results(folder: &Path) -> Result<Results, Failure> {
    let experiments = subfolders(&folder.join("experiments"))?;
    let check: Option<CheckReport> = read_json(&folder.join("check.json"))?;
    if experiments.is_empty() && check.is_none() {
        return bad_input(format!(
            "{} is not a run folder: found neither experiments/NAME/plan.json nor check.json",
            folder.display()
        ));
    }
    let summary: Option<RunSummary> = read_json(&folder.join("run.json"))?;
    let hygiene: Vec<HygieneReport> = read_json(&folder.join("hygiene.json"))?.unwrap_or_default();
    let bank = folder.join("bank.json");
    let models = if bank.exists() {
        model_diagnostics(&Bank::read(&bank).or_input()?)
    } else {
        Vec::new()
    };
    Ok(Results {
        summary: summary.unwrap_or_else(|| RunSummary {
            title: folder
                .file_name()
                .map_or("Run".to_owned(), |name| name.to_string_lossy().into_owned()),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            ..RunSummary::default()
        }),
        experiments: experiments
            .iter()
            .map(|folder| read_experiment(folder))
            .collect::<Result<_, _>>()?,
        training: csv_files(&folder.join("training"))?
            .iter()
            .map(|path| read_flight(path).or_input())
            .collect::<Result<_, _>>()?,
        rollouts: check.as_ref().map(rollouts).unwrap_or_default(),
        models,
        findings: hygiene
            .iter()
            .filter(|recording| !recording.findings.is_empty())
            .map(|recording| Finding {
                flight: recording.flight.clone(),
                what: recording.to_string(),
            })
            .collect(),
    })
}

/// Writes report.html and the figures; returns the page's path.
pub fn write_report(folder: &Path, results: &Results) -> Result<PathBuf, Failure> {
    for Figure { name, svg, .. } in figures(results) {
        flyvine::file::write_whole(
            &folder.join("figures").join(format!("{name}.svg")),
            svg.as_bytes(),
        )
        .or_internal()?;
    }
    let page = folder.join("report.html");
    flyvine::file::write_whole(&page, html(results).or_internal()?.as_bytes()).or_internal()?;
    Ok(page)
}

/// Where an experiment's files are.
pub fn experiment_folder(run: &Path, name: &str) -> PathBuf {
    run.join("experiments").join(name)
}

/// Writes the plan, the flight and the arm's shape of one experiment.
pub fn write_experiment(run: &Path, plan: &Plan, flight: &Flight, arm: &ArmShapes) -> Result<(), Failure> {
    let folder = experiment_folder(run, &plan.task.name);
    flyvine::task::write_plan(&folder.join("plan.json"), plan).or_internal()?;
    flyvine::flight::write_flight(&folder.join("flight.csv"), flight).or_internal()?;
    let arm = serde_json::to_vec(arm).or_internal()?;
    flyvine::file::write_whole(&folder.join("arm.json"), &arm).or_internal()
}

/// The experiments of a run folder, in reading order; an error where there are none.
pub fn read_experiments(folder: &Path) -> Result<Vec<Experiment>, Failure> {
    let experiments = subfolders(&folder.join("experiments"))?
        .iter()
        .map(|folder| read_experiment(folder))
        .collect::<Result<Vec<_>, _>>()?;
    if experiments.is_empty() {
        return bad_input(format!(
            "{} is not a run folder with flights: found no experiments/NAME/plan.json",
            folder.display()
        ));
    }
    let results = Results {
        experiments,
        ..Results::default()
    };
    Ok(results.experiments_in_order().into_iter().cloned().collect())
}

/// One experiment's plan, flight and arm.
pub fn read_experiment(folder: &Path) -> Result<Experiment, Failure> {
    let plan = read_plan(&folder.join("plan.json")).or_input()?;
    let (flight, _) = load_flight(&folder.join("flight.csv"))?;
    let arm: Option<ArmShapes> = read_json(&folder.join("arm.json"))?;
    plan_experiment(&plan, flight, arm.unwrap_or_default())
}

/// A flight of a plan, with the arm's shape in each row where it is known. A flight without rows is one that was not
/// flown yet.
pub fn plan_experiment(plan: &Plan, mut flight: Flight, mut arm: ArmShapes) -> Result<Experiment, Failure> {
    let rows = flight.samples.len();
    let remark = (rows != plan.knots() && rows > 0)
        .then(|| format!("{rows} rows for {} knots: aborted", plan.knots()));
    flight.samples.truncate(plan.knots());
    arm.truncate(flight.samples.len());
    let (kind, period_s) = match plan.task.motion() {
        Motion::Lemniscate(lemniscate) => (ExperimentKind::Lemniscate, Some(lemniscate.period_s)),
        Motion::Deploy(deploy) => (ExperimentKind::Deploy, Some(deploy.period_s)),
        Motion::Swing(_) => (ExperimentKind::Swing, None),
        Motion::Waypoints(_) => (ExperimentKind::Waypoints, None),
    };
    let swing = match plan.task.motion() {
        Motion::Swing(swing) => swing_target(plan).map(|target| SwingTask {
            target,
            quadrotor_x_max: Some(swing.quadrotor_limits_m[0]),
            quadrotor_z_max: Some(swing.quadrotor_limits_m[1]),
        }),
        _ => None,
    };
    let first = plan.configurations[0];
    let last = plan.configurations[plan.configurations.len() - 1];
    Ok(Experiment {
        name: plan.task.name.clone(),
        kind,
        label: configuration_label(first, (first != last).then_some(last)),
        period_s,
        reference: plan.reference.clone(),
        predicted_quadrotor: plan.predicted_quadrotor(),
        predicted_end_effector: plan.predicted_end_effector(),
        score: match rows {
            0 => None,
            _ => Some(score_flight(plan, &flight)?),
        },
        remark,
        flight,
        arm,
        swing,
        solver: SolverSummary {
            status: plan.solve.status.clone(),
            converged: plan.solve.converged,
            iterations: plan.solve.iterations,
            cost: plan.solve.cost,
            max_violation: plan.solve.max_violation,
        },
    })
}

/// A flight of which no plan is known.
pub fn flight_experiment(name: &str, flight: Flight) -> Experiment {
    let configuration = |sample: Option<&Sample>| sample.map(|sample| sample.configuration);
    let (first, last) = (
        configuration(flight.samples.first()),
        configuration(flight.samples.last()),
    );
    Experiment {
        name: name.to_owned(),
        kind: ExperimentKind::Waypoints,
        label: first.map_or(String::new(), |first| {
            configuration_label(first, last.filter(|last| *last != first))
        }),
        period_s: None,
        reference: Vec::new(),
        predicted_quadrotor: Vec::new(),
        predicted_end_effector: Vec::new(),
        score: None,
        remark: None,
        flight,
        arm: Vec::new(),
        swing: None,
        solver: SolverSummary {
            status: String::new(),
            converged: false,
            iterations: 0,
            cost: 0.0,
            max_violation: 0.0,
        },
    }
}

fn rollouts(check: &CheckReport) -> Vec<FlightRollout> {
    let horizon = |rollout: &flyvine::model::RolloutError| HorizonError {
        horizon_s: rollout.horizon_s,
        windows: rollout.windows,
        median_m: rollout.median_m,
        p95_m: rollout.p95_m,
        diverged_share: rollout.diverged_share,
    };
    check
        .flights
        .iter()
        .map(|flight| FlightRollout {
            path: flight.path.clone(),
            label: configuration_label(flight.configuration, flight.last_configuration),
            configuration: flight.configuration,
            rollout: flight.rollout.iter().map(horizon).collect(),
        })
        .collect()
}

fn model_diagnostics(bank: &Bank) -> Vec<ModelDiagnostics> {
    bank.models()
        .iter()
        .map(|model| ModelDiagnostics {
            label: configuration_label(model.configuration, None),
            configuration: model.configuration,
            spectral_radius: model.diagnostics.spectral_radius,
            condition_number: model.diagnostics.condition_number,
        })
        .collect()
}

/// A JSON file of the run, `None` where it is absent.
fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    let contents = std::fs::read(path).or_input()?;
    match serde_json::from_slice(&contents) {
        Ok(value) => Ok(Some(value)),
        Err(error) => bad_input(format!("{}: {error}", path.display())),
    }
}

/// Folders in `folder`, by name; none where it is absent.
fn subfolders(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|path| path.is_dir())
        .collect())
}

/// CSV files in `folder`, by name; none where it is absent.
fn csv_files(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|path| path.extension().is_some_and(|e| e == "csv"))
        .collect())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let listing = std::fs::read_dir(folder).or_input()?;
    let mut paths = listing
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .or_input()?;
    paths.sort();
    Ok(paths)
}
