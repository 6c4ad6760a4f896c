//! The paper's 4 swings and 8 lemniscates as [`Recording`]s: the authors' public command files, and the curves
//! measured on hardware as drawn in the figures.
//!
//! A swing is drawn twice, as x(t) and as a path (x, z), thinned differently: its heights have no time stamps and
//! are dated through x.

use super::replay::{Curve, Measured, Recording};
use crate::DT;
use crate::flight::Corner;
use std::path::{Path, PathBuf};

/// Why recordings could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// A file is missing or unreadable.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        source: csv::Error,
    },
    /// A flight without enough rows.
    #[error("{name}: {found} rows, expected at least {expected}")]
    TooShort {
        /// The recording.
        name: String,
        /// Rows found.
        found: usize,
        /// Rows expected.
        expected: usize,
    },
}

/// A corner's name in the authors' command files.
fn plan_name(corner: Corner) -> &'static str {
    match corner {
        Corner::Es => "empty_short",
        Corner::Is => "0psi_short",
        Corner::El => "empty_long",
        Corner::Il => "0psi_long",
    }
}

/// The paper's 4 swings and 8 lemniscates: the authors' flown plans in `commands`, the measured curves in
/// `figures`.
pub fn recordings(commands: &Path, figures: &Path) -> Result<Vec<Recording>, ReplayError> {
    let mut recordings = vec![];
    for corner in Corner::ALL {
        let (plan, label) = (plan_name(corner), corner.label());
        let target = if corner.is_short() {
            "x1.5_z1.0"
        } else {
            "x1.5_z0.75"
        };
        let commands = read_commands(&commands.join(format!(
            "motion_plan_kick_2by2_NLtipz_{plan}_vine_{target}_T50.csv"
        )))?;
        let read = |name: &str| read_pairs(&figures.join(format!("kick_{label}_{name}.csv")));
        // The figure's time zero is the plan's second row: the first is the hover command.
        let shift = |curve: Vec<[f64; 2]>| curve.into_iter().map(|[t, x]| (t + DT, x)).collect::<Curve>();
        let quadrotor_x = shift(read("quadrotor_x")?);
        let end_effector_x = shift(read("end_effector_x")?);
        let height = height_difference(
            &heights_against_time(&quadrotor_x, &read("quadrotor_xz")?),
            &heights_against_time(&end_effector_x, &read("end_effector_xz")?),
        );
        recordings.push(Recording {
            name: format!("swing {label}"),
            configurations: vec![corner.configuration(); commands.len()],
            velocities: vec![None; commands.len()],
            commands,
            measured: Measured::Swing {
                quadrotor_x,
                end_effector_x,
                height,
            },
        });
    }
    for (period, suffix, after_s) in [("10s", "10s_ramp1", 1.0), ("5s", "5s_ramp3", 3.0)] {
        for corner in Corner::ALL {
            let (plan, label) = (plan_name(corner), corner.label());
            let commands = read_commands(
                &commands.join(format!("motion_plan_fig8_2by2_NLtipz_{plan}_vine_{suffix}.csv")),
            )?;
            let read =
                |name: &str| read_pairs(&figures.join(format!("lemniscate_{period}_{label}_{name}_xy.csv")));
            recordings.push(Recording {
                name: format!("lemniscate {period} {label}"),
                configurations: vec![corner.configuration(); commands.len()],
                velocities: vec![None; commands.len()],
                commands,
                measured: Measured::Path {
                    after_s,
                    quadrotor: read("quadrotor")?,
                    end_effector: read("end_effector")?,
                },
            });
        }
    }
    Ok(recordings)
}

fn read_rows<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Vec<T>, ReplayError> {
    let fail = |source| ReplayError::Read {
        path: path.to_owned(),
        source,
    };
    let mut reader = csv::Reader::from_path(path).map_err(fail)?;
    reader.deserialize().collect::<Result<_, _>>().map_err(fail)
}

fn read_pairs(path: &Path) -> Result<Vec<[f64; 2]>, ReplayError> {
    read_rows(path)
}

fn read_commands(path: &Path) -> Result<Vec<[f64; 3]>, ReplayError> {
    Ok(read_rows::<[f64; 4]>(path)?
        .into_iter()
        .map(|[_, x, y, z]| [x, y, z])
        .collect())
}

/// Times of the points of a path `(x, z)` drawn beside the curve `x(t)` of the same samples: points that both
/// drawings kept are found by their x; the others lie at the sample between their neighbours where `x(t)` comes
/// closest.
fn heights_against_time(curve: &Curve, path: &[[f64; 2]]) -> Curve {
    let same = |a: f64, b: f64| (a - b).abs() < 1e-9;
    let mut times: Vec<Option<f64>> = vec![];
    let mut from = 0;
    for [x, _] in path {
        let found = curve[from..].iter().position(|(_, value)| same(*value, *x));
        if let Some(offset) = found {
            from += offset + 1;
        }
        times.push(found.map(|_| curve[from - 1].0));
    }
    let last = curve.last().map_or(0.0, |(t, _)| *t);
    for i in 0..path.len() {
        if times[i].is_none() {
            let before = times[..i].iter().rev().flatten().next().copied().unwrap_or(0.0);
            let after = times[i..].iter().flatten().next().copied().unwrap_or(last + DT);
            let samples = ((after - before) / DT).round() as usize;
            let distance = |t: f64| interpolate(curve, t).map_or(f64::INFINITY, |x| (x - path[i][0]).abs());
            times[i] = (1..samples)
                .map(|k| before + k as f64 * DT)
                .min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        }
    }
    times
        .iter()
        .zip(path)
        .filter_map(|(t, [_, z])| t.map(|t| (t, *z)))
        .collect()
}

/// End-effector height minus quadrotor height, at the end effector's points that the quadrotor's curve covers.
fn height_difference(quadrotor: &Curve, end_effector: &Curve) -> Curve {
    end_effector
        .iter()
        .filter_map(|(t, z)| interpolate(quadrotor, *t).map(|q| (*t, z - q)))
        .collect()
}

/// Linear interpolation in a curve; `None` outside it.
fn interpolate(curve: &Curve, t: f64) -> Option<f64> {
    let after = curve.iter().position(|(time, _)| *time >= t - 1e-9)?;
    let (t1, x1) = curve[after];
    if after == 0 {
        return ((t1 - t).abs() < 1e-6).then_some(x1);
    }
    let (t0, x0) = curve[after - 1];
    Some(x0 + (x1 - x0) * ((t - t0) / (t1 - t0)).min(1.0))
}
