//! The data of the 3-D replay: every experiment, compact, as JSON; in report.html and on the page of `flyvine view`.

use serde::Serialize;

use super::figures::{Palette, palette};
use super::results::{Experiment, ExperimentKind, ReportError, Results};
use crate::DT;

/// What `assets/player.js` reads.
#[derive(Serialize)]
struct Replay<'a> {
    dt: f64,
    experiments: Vec<ReplayTrack<'a>>,
}

/// One flight for a replay; serializes to a JSON object. Positions are integers of 0.1 mm, knot-major, three per row;
/// quaternions integers of 1e-4, `[w, x, y, z]`; all entries of a row that was not seen are null.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ReplayTrack<'a> {
    name: &'a str,
    title: String,
    kind: ExperimentKind,
    color: &'static str,
    quadrotor: Vec<Option<i64>>,
    attitude: Vec<Option<i64>>,
    tip: Vec<Option<i64>>,
    command: Vec<Option<i64>>,
    reference: Vec<Option<i64>>,
    predicted: Vec<Option<i64>>,
    /// Left out of report.html, which does not draw it.
    #[serde(skip_serializing_if = "Option::is_none")]
    predicted_quadrotor: Option<Vec<Option<i64>>>,
    /// Arm nodes of each row, base to tip.
    #[serde(skip_serializing_if = "Option::is_none")]
    arm: Option<Vec<Vec<Option<i64>>>>,
    /// `[length m, pressure kPa]`: one per row, or a single one for all.
    configurations: Vec<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target_knot: Option<usize>,
    /// Largest quadrotor x and z, m.
    limits: [Option<f64>; 2],
}

/// The replay's JSON.
pub(super) fn replay_json(experiments: &[&Experiment], palette: &Palette) -> Result<String, ReportError> {
    let experiments = experiments
        .iter()
        .map(|experiment| {
            experiment.check_shapes()?;
            Ok(track(experiment, palette))
        })
        .collect::<Result<_, _>>()?;
    serde_json::to_string(&Replay { dt: DT, experiments }).map_err(|e| ReportError::Json {
        reason: e.to_string(),
    })
}

/// Every experiment as a track, in reading order, with the predicted quadrotor positions. An experiment without reference
/// and prediction is a flight without a plan, one without rows a plan that was not flown yet.
pub fn replay_tracks(results: &Results) -> Result<Vec<(&Experiment, ReplayTrack<'_>)>, ReportError> {
    let palette = palette(results);
    results
        .experiments_in_order()
        .into_iter()
        .map(|experiment| {
            if !experiment.flight.samples.is_empty() {
                experiment.check_shapes()?;
            }
            let track = ReplayTrack {
                predicted_quadrotor: Some(integers(experiment.predicted_quadrotor.iter().copied().map(Some))),
                ..track(experiment, &palette)
            };
            Ok((experiment, track))
        })
        .collect()
}

fn track<'a>(experiment: &'a Experiment, palette: &Palette) -> ReplayTrack<'a> {
    let samples = &experiment.flight.samples;
    let arm = &experiment.arm;
    let mut configurations: Vec<[f64; 2]> = samples
        .iter()
        .map(|s| [s.configuration.length_m, s.configuration.pressure_kpa])
        .collect();
    if configurations.windows(2).all(|pair| pair[0] == pair[1]) {
        configurations.truncate(1);
    }
    for [length, pressure] in &mut configurations {
        (*length, *pressure) = (round(*length), round(*pressure));
    }
    ReplayTrack {
        name: &experiment.name,
        title: experiment.title(),
        kind: experiment.kind,
        color: palette.color(&experiment.label),
        quadrotor: integers(samples.iter().map(|s| s.quadrotor.map(|pose| pose.position))),
        attitude: integers(samples.iter().map(|s| s.quadrotor.map(|pose| pose.attitude))),
        tip: integers(samples.iter().map(|s| s.end_effector)),
        command: integers(samples.iter().map(|s| Some(s.command))),
        reference: integers(experiment.reference.iter().copied().map(Some)),
        predicted: integers(experiment.predicted_end_effector.iter().copied().map(Some)),
        predicted_quadrotor: None,
        arm: (!arm.is_empty()).then(|| {
            arm.iter()
                .map(|nodes| integers(nodes.iter().copied().map(Some)))
                .collect()
        }),
        configurations,
        target: experiment.swing.map(|s| s.target.position),
        target_knot: experiment.swing.map(|s| s.target.knot),
        limits: experiment
            .swing
            .map_or([None; 2], |s| [s.quadrotor_x_max, s.quadrotor_z_max]),
    }
}

/// Values in units of 1e-4; null for rows that were not seen or are not finite.
fn integers<const N: usize>(rows: impl Iterator<Item = Option<[f64; N]>>) -> Vec<Option<i64>> {
    rows.flat_map(|row| {
        let row = row.filter(|values| values.iter().all(|v| v.is_finite()));
        (0..N).map(move |i| row.map(|values| (values[i] * 1e4).round() as i64))
    })
    .collect()
}

fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
