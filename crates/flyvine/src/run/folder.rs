//! Reading and writing a run folder.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::{RunError, score_flight, swing_target};
use crate::file::write_whole;
use crate::flight::{
    Configuration, Corner, Flight, HygieneOptions, HygieneReport, Sample, clean, read_control_steps,
    read_flight, write_flight,
};
use crate::model::{Bank, CheckReport, RolloutError};
use crate::report::{
    Experiment, ExperimentKind, Figure, Finding, FlightRollout, HorizonError, ModelDiagnostics, Results,
    RunSummary, SolverSummary, SwingTask, figures, html,
};
use crate::task::{Motion, Plan, read_plan, write_plan};

/// Arm nodes of each row, quadrotor end first, m.
pub type ArmShapes = Vec<Vec<[f64; 3]>>;

/// Reads everything a report shows. Flights are cleaned; `found` is told what that found, flight by flight.
///
/// # Errors
/// No run folder, or a file in it that cannot be read.
pub fn read_results(
    folder: &Path,
    found: &mut dyn FnMut(&Path, &HygieneReport),
) -> Result<Results, RunError> {
    let experiments = subfolders(&folder.join("experiments"))?;
    let check: Option<CheckReport> = read_json(&folder.join("check.json"))?;
    if experiments.is_empty() && check.is_none() {
        return Err(RunError::NotARun {
            folder: folder.to_owned(),
        });
    }
    let summary: Option<RunSummary> = read_json(&folder.join("run.json"))?;
    let hygiene: Vec<HygieneReport> = read_json(&folder.join("hygiene.json"))?.unwrap_or_default();
    let bank = folder.join("bank.json");
    let models = if bank.exists() {
        model_diagnostics(&Bank::read(&bank)?)
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
            .map(|folder| read_experiment(folder, found))
            .collect::<Result<_, _>>()?,
        training: csv_files(&folder.join("training"))?
            .iter()
            .map(|path| Ok(read_flight(path)?))
            .collect::<Result<_, RunError>>()?,
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
///
/// # Errors
/// Results that contradict themselves; a file that cannot be written.
pub fn write_report(folder: &Path, results: &Results) -> Result<PathBuf, RunError> {
    for Figure { name, svg, .. } in figures(results) {
        write(
            &folder.join("figures").join(format!("{name}.svg")),
            svg.as_bytes(),
        )?;
    }
    let page = folder.join("report.html");
    write(&page, html(results)?.as_bytes())?;
    Ok(page)
}

fn write(path: &Path, contents: &[u8]) -> Result<(), RunError> {
    write_whole(path, contents).map_err(|source| RunError::File {
        path: path.to_owned(),
        source,
    })
}

/// Where an experiment's files are.
pub fn experiment_folder(run: &Path, name: &str) -> PathBuf {
    run.join("experiments").join(name)
}

/// Writes the plan, the flight and the arm's shape of one experiment.
///
/// # Errors
/// A file that cannot be written.
pub fn write_experiment(run: &Path, plan: &Plan, flight: &Flight, arm: &ArmShapes) -> Result<(), RunError> {
    let folder = experiment_folder(run, &plan.task.name);
    write_plan(&folder.join("plan.json"), plan)?;
    write_flight(&folder.join("flight.csv"), flight)?;
    let path = folder.join("arm.json");
    let arm = serde_json::to_vec(arm).map_err(|source| RunError::Json {
        path: path.clone(),
        source,
    })?;
    write(&path, &arm)
}

/// The experiments of a run folder, in reading order.
///
/// # Errors
/// A folder without flights, or a file in it that cannot be read.
pub fn read_experiments(
    folder: &Path,
    found: &mut dyn FnMut(&Path, &HygieneReport),
) -> Result<Vec<Experiment>, RunError> {
    let experiments = subfolders(&folder.join("experiments"))?
        .iter()
        .map(|folder| read_experiment(folder, found))
        .collect::<Result<Vec<_>, _>>()?;
    if experiments.is_empty() {
        return Err(RunError::NoFlights {
            folder: folder.to_owned(),
        });
    }
    let results = Results {
        experiments,
        ..Results::default()
    };
    Ok(results.experiments_in_order().into_iter().cloned().collect())
}

/// One experiment's plan, flight and arm.
///
/// # Errors
/// A file that cannot be read.
pub fn read_experiment(
    folder: &Path,
    found: &mut dyn FnMut(&Path, &HygieneReport),
) -> Result<Experiment, RunError> {
    let plan = read_plan(&folder.join("plan.json"))?;
    let path = folder.join("flight.csv");
    let mut flight = read_flight(&path)?;
    found(&path, &clean(&mut flight, &HygieneOptions::default()));
    let arm: Option<ArmShapes> = read_json(&folder.join("arm.json"))?;
    let steps = read_control_steps(&path)?;
    Ok(Experiment {
        last_step: steps.last().map(|step| step.report),
        ..plan_experiment(&plan, flight, arm.unwrap_or_default())?
    })
}

/// A flight of a plan, with the arm's shape in each row where it is known. A flight without rows is one that was not
/// flown yet.
///
/// # Errors
/// The flight is not one of the plan.
pub fn plan_experiment(plan: &Plan, mut flight: Flight, mut arm: ArmShapes) -> Result<Experiment, RunError> {
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
        last_step: None,
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
        last_step: None,
    }
}

fn rollouts(check: &CheckReport) -> Vec<FlightRollout> {
    let horizon = |rollout: &RolloutError| HorizonError {
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
fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, RunError> {
    if !path.exists() {
        return Ok(None);
    }
    let contents = std::fs::read(path).map_err(|source| RunError::File {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_slice(&contents)
        .map(Some)
        .map_err(|source| RunError::Json {
            path: path.to_owned(),
            source,
        })
}

/// Folders in `folder`, by name; none where it is absent.
fn subfolders(folder: &Path) -> Result<Vec<PathBuf>, RunError> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|path| path.is_dir())
        .collect())
}

/// CSV files in `folder`, by name; none where it is absent.
fn csv_files(folder: &Path) -> Result<Vec<PathBuf>, RunError> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|path| path.extension().is_some_and(|e| e == "csv"))
        .collect())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, RunError> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let list = || {
        std::fs::read_dir(folder)?
            .map(|entry| Ok(entry?.path()))
            .collect::<std::io::Result<Vec<_>>>()
    };
    let mut paths = list().map_err(|source| RunError::File {
        path: folder.to_owned(),
        source,
    })?;
    paths.sort();
    Ok(paths)
}

/// `ES`, `IS`, `EL`, `IL` at the paper's corners, otherwise length and pressure; an arrow where it changes.
pub fn configuration_label(first: Configuration, last: Option<Configuration>) -> String {
    let one = |configuration: Configuration| match Corner::from_configuration(configuration) {
        Some(corner) => corner.label().to_owned(),
        None => format!(
            "{:.3} m {:.2} kPa",
            configuration.length_m, configuration.pressure_kpa
        ),
    };
    last.map_or_else(|| one(first), |last| format!("{} → {}", one(first), one(last)))
}
