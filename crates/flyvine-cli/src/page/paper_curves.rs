//! The paper's measured curves that belong to an experiment, placed where and when the flight was.

use flyvine::flight::Corner;
use flyvine::report::paper::{self, Curve, SHORT_SWING_SHIFT_M, Signal};
use flyvine::report::{Experiment, ExperimentKind};
use serde::Serialize;

/// A measured path in space.
#[derive(Debug, PartialEq, Serialize)]
pub struct PaperPath {
    body: &'static str,
    points: Vec<[f64; 3]>,
}

/// One axis of a body over time.
#[derive(Debug, PartialEq, Serialize)]
pub struct PaperSeries {
    body: &'static str,
    axis: usize,
    times: Vec<f64>,
    values: Vec<f64>,
}

const BODIES: [(Signal, &str); 2] = [
    (Signal::Quadrotor, "quadrotor"),
    (Signal::EndEffector, "end_effector"),
];

/// Measured paths. The paper drew lemniscates from above and swings from the side: they lie at the height of the plan,
/// and in the plane y = 0.
pub fn paper_paths(experiment: &Experiment) -> Vec<PaperPath> {
    let corner = Corner::from_label(&experiment.label);
    BODIES
        .into_iter()
        .filter_map(|(signal, body)| {
            let points: Vec<[f64; 3]> = match (experiment.kind, corner, experiment.period_s) {
                (ExperimentKind::Lemniscate, Some(corner), Some(period_s)) => {
                    let planned = match signal {
                        Signal::Quadrotor => &experiment.predicted_quadrotor,
                        _ => &experiment.reference,
                    };
                    let z = planned.first()?[2];
                    let curve = paper::lemniscate_xy(period_s, corner, signal)?;
                    curve.iter().map(|&[x, y]| [x, y, z]).collect()
                }
                (ExperimentKind::Swing, Some(corner), _) => {
                    let raise = if corner.is_short() {
                        SHORT_SWING_SHIFT_M
                    } else {
                        0.0
                    };
                    let curve = paper::swing_xz(corner, signal)?;
                    curve.iter().map(|&[x, z]| [x, 0.0, z + raise]).collect()
                }
                (ExperimentKind::Deploy, ..) if is_papers_deployment(experiment) => deployed(signal)?,
                _ => return None,
            };
            Some(PaperPath { body, points })
        })
        .collect()
}

/// Measured curves over time: x of the swings, everything of the deployment.
pub fn paper_series(experiment: &Experiment) -> Vec<PaperSeries> {
    let corner = Corner::from_label(&experiment.label);
    let mut found = Vec::new();
    for (signal, body) in BODIES {
        for axis in 0..3 {
            let (curve, lead_s) = match (experiment.kind, corner) {
                (ExperimentKind::Swing, Some(corner)) if axis == 0 => (paper::swing_x(corner, signal), 0.0),
                (ExperimentKind::Deploy, _) if is_papers_deployment(experiment) => {
                    (paper::deploy(axis, signal), paper::DEPLOY_LEAD_S)
                }
                _ => (None, 0.0),
            };
            let Some(curve) = curve else { continue };
            found.push(PaperSeries {
                body,
                axis,
                times: curve.iter().map(|&[t, _]| t - lead_s).collect(),
                values: curve.iter().map(|&[_, value]| value).collect(),
            });
        }
    }
    found
}

fn is_papers_deployment(experiment: &Experiment) -> bool {
    experiment.kind == ExperimentKind::Deploy && experiment.period_s == Some(5.0)
}

/// The deployment's path: its axes were thinned apart, so two of them are interpolated at the times of the first.
fn deployed(signal: Signal) -> Option<Vec<[f64; 3]>> {
    let [x, y, z] = [0, 1, 2].map(|axis| paper::deploy(axis, signal));
    let (x, y, z) = (x?, y?, z?);
    Some(
        x.iter()
            .filter(|&&[t, _]| t >= paper::DEPLOY_LEAD_S)
            .map(|&[t, x]| [x, at(y, t), at(z, t)])
            .collect(),
    )
}

/// A curve's value at a time, held beyond its ends.
fn at(curve: &Curve, t: f64) -> f64 {
    let next = curve.partition_point(|&[found, _]| found < t);
    match (next.checked_sub(1).map(|i| curve[i]), curve.get(next)) {
        (Some([t0, v0]), Some(&[t1, v1])) if t1 > t0 => v0 + (t - t0) / (t1 - t0) * (v1 - v0),
        (Some([_, value]), _) | (None, Some(&[_, value])) => value,
        (None, None) => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_interpolated_and_held() {
        let curve = [[0.0, 1.0], [2.0, 3.0]];
        assert_eq!(
            [-1.0, 0.0, 0.5, 2.0, 9.0].map(|t| at(&curve, t)),
            [1.0, 1.0, 1.5, 3.0, 3.0]
        );
    }

    #[test]
    fn the_measured_deployment_is_a_path_in_the_room() {
        let path = deployed(Signal::EndEffector).unwrap();
        assert!(path.len() > 100, "{}", path.len());
        assert!(
            path.iter()
                .all(|[x, y, z]| x.abs() < 1.5 && y.abs() < 1.5 && (0.3..1.3).contains(z))
        );
    }
}
