//! Replays of recorded flights: the recorded commands flown on the simulated vehicle, and the distance
//! from what was measured.
//!
//! The paper's figures are a test against hardware: the commands of its 4 swings and 8 lemniscates are public, and
//! the measured curves can be read from the figures. A swing's curves are known against time, its heights only
//! against x; a lemniscate's only as a path.

use super::SimulatedVehicle;
use crate::DT;
use crate::flight::{Configuration, Flight};
use crate::link::{Vehicle, VehicleError};
use nalgebra::{Vector2, Vector3};
use std::path::{Path, PathBuf};

/// Commands that were flown, and what was measured of the flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Short name, for tables.
    pub name: String,
    /// Configuration at each command.
    pub configurations: Vec<Configuration>,
    /// Commanded quadrotor positions, one every [`DT`], m.
    pub commands: Vec<[f64; 3]>,
    /// What is known of the response.
    pub measured: Measured,
}

/// Points `(t, value)` of a curve, s and m.
pub type Curve = Vec<(f64, f64)>;

/// The measured response to a [`Recording`]'s commands.
#[derive(Debug, Clone, PartialEq)]
pub enum Measured {
    /// Curves against the flight's time.
    Swing {
        /// Quadrotor x.
        quadrotor_x: Curve,
        /// End-effector x.
        end_effector_x: Curve,
        /// End-effector height minus quadrotor height.
        height: Curve,
    },
    /// Horizontal paths without time, flown after `after_s`.
    Path {
        /// The path is compared from here on, s.
        after_s: f64,
        /// Quadrotor path, m.
        quadrotor: Vec<[f64; 2]>,
        /// End-effector path, m.
        end_effector: Vec<[f64; 2]>,
    },
    /// Positions at every command, where motion capture had them.
    Rows {
        /// Quadrotor, m.
        quadrotor: Vec<Option<[f64; 3]>>,
        /// End effector, m.
        end_effector: Vec<Option<[f64; 3]>>,
    },
}

/// Positions of a replay, one row per command and one after the last.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Quadrotor, m.
    pub quadrotor: Vec<Vector3<f64>>,
    /// End effector, m.
    pub end_effector: Vec<Vector3<f64>>,
}

/// Differences of one signal from its measurement, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Which signal.
    pub signal: Signal,
    /// Simulated minus measured; for paths and rows the components of the difference, point after point.
    pub values: Vec<f64>,
    /// Number of components per point.
    pub components: usize,
}

/// A compared signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// Quadrotor x or path or position.
    Quadrotor,
    /// End-effector x or path or position.
    EndEffector,
    /// End-effector height minus quadrotor height.
    Height,
}

/// One line of the replay table, m. Swings: RMS of quadrotor x, end-effector x and height difference;
/// lemniscates: mean distance of the measured path from the simulated one.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayRow {
    /// The recording's name.
    pub name: String,
    /// Quadrotor.
    pub quadrotor_m: f64,
    /// End effector.
    pub end_effector_m: f64,
    /// End-effector height minus quadrotor height, swings only.
    pub height_m: Option<f64>,
}

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

/// The corners' names in the paper's figures, in the authors' command files, and their configurations.
const CORNERS: [(&str, &str, Configuration); 4] = [
    (
        "ES",
        "empty_short",
        Configuration {
            length_m: 0.7,
            pressure_kpa: 0.0,
        },
    ),
    (
        "IS",
        "0psi_short",
        Configuration {
            length_m: 0.7,
            pressure_kpa: 0.4,
        },
    ),
    (
        "EL",
        "empty_long",
        Configuration {
            length_m: 1.0,
            pressure_kpa: 0.0,
        },
    ),
    (
        "IL",
        "0psi_long",
        Configuration {
            length_m: 1.0,
            pressure_kpa: 0.4,
        },
    ),
];

/// The paper's 4 swings and 8 lemniscates: the authors' flown plans in `commands`, the measured curves in
/// `figures`.
pub fn paper_recordings(commands: &Path, figures: &Path) -> Result<Vec<Recording>, ReplayError> {
    let mut recordings = vec![];
    for (corner, plan, configuration) in CORNERS {
        let target = if configuration.length_m < 0.85 {
            "x1.5_z1.0"
        } else {
            "x1.5_z0.75"
        };
        let commands = read_commands(&commands.join(format!(
            "motion_plan_kick_2by2_NLtipz_{plan}_vine_{target}_T50.csv"
        )))?;
        let read = |name: &str| read_pairs(&figures.join(format!("kick_{corner}_{name}.csv")));
        // The figure's time zero is the plan's second row: the first is the hover command.
        let shift = |curve: Vec<[f64; 2]>| curve.into_iter().map(|[t, x]| (t + DT, x)).collect::<Curve>();
        let quadrotor_x = shift(read("quadrotor_x")?);
        let end_effector_x = shift(read("end_effector_x")?);
        let height = height_difference(
            &heights_against_time(&quadrotor_x, &read("quadrotor_xz")?),
            &heights_against_time(&end_effector_x, &read("end_effector_xz")?),
        );
        recordings.push(Recording {
            name: format!("swing {corner}"),
            configurations: vec![configuration; commands.len()],
            commands,
            measured: Measured::Swing {
                quadrotor_x,
                end_effector_x,
                height,
            },
        });
    }
    for (period, suffix, after_s) in [("10s", "10s_ramp1", 1.0), ("5s", "5s_ramp3", 3.0)] {
        for (corner, plan, configuration) in CORNERS {
            let commands = read_commands(
                &commands.join(format!("motion_plan_fig8_2by2_NLtipz_{plan}_vine_{suffix}.csv")),
            )?;
            let read =
                |name: &str| read_pairs(&figures.join(format!("lemniscate_{period}_{corner}_{name}_xy.csv")));
            recordings.push(Recording {
                name: format!("lemniscate {period} {corner}"),
                configurations: vec![configuration; commands.len()],
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

impl Recording {
    /// A recorded flight: its commands, configurations and poses.
    pub fn from_flight(flight: &Flight) -> Result<Recording, ReplayError> {
        if flight.samples.len() < 2 {
            return Err(ReplayError::TooShort {
                name: flight.name.clone(),
                found: flight.samples.len(),
                expected: 2,
            });
        }
        let samples = &flight.samples;
        Ok(Recording {
            name: flight.name.clone(),
            configurations: samples.iter().map(|sample| sample.configuration).collect(),
            commands: samples.iter().map(|sample| sample.command).collect(),
            measured: Measured::Rows {
                quadrotor: samples
                    .iter()
                    .map(|s| s.quadrotor.map(|pose| pose.position))
                    .collect(),
                end_effector: samples.iter().map(|s| s.end_effector).collect(),
            },
        })
    }

    /// Flies the commands on a vehicle with these (valid) parameters, without motion-capture noise.
    pub fn fly(&self, vehicle: &mut SimulatedVehicle) -> Result<Trajectory, VehicleError> {
        vehicle.reset(self.configurations[0], 0)?;
        let mut trajectory = Trajectory {
            quadrotor: vec![],
            end_effector: vec![],
        };
        let mut record = |vehicle: &SimulatedVehicle| {
            let (quadrotor, end_effector) = vehicle.positions();
            trajectory.quadrotor.push(quadrotor);
            trajectory.end_effector.push(end_effector);
        };
        record(vehicle);
        for (command, configuration) in self.commands.iter().zip(&self.configurations) {
            vehicle.step(*command, *configuration)?;
            record(vehicle);
        }
        Ok(trajectory)
    }

    /// How a replay differs from the measurement, signal by signal.
    pub fn differences(&self, trajectory: &Trajectory) -> Vec<Difference> {
        let curve = |signal, curve: &Curve, value: &dyn Fn(usize) -> f64| Difference {
            signal,
            components: 1,
            values: curve
                .iter()
                .map(|(t, measured)| {
                    value(((t / DT).round() as usize).min(trajectory.quadrotor.len() - 1)) - measured
                })
                .collect(),
        };
        match &self.measured {
            Measured::Swing {
                quadrotor_x,
                end_effector_x,
                height,
            } => vec![
                curve(Signal::Quadrotor, quadrotor_x, &|k| trajectory.quadrotor[k].x),
                curve(Signal::EndEffector, end_effector_x, &|k| {
                    trajectory.end_effector[k].x
                }),
                curve(Signal::Height, height, &|k| {
                    trajectory.end_effector[k].z - trajectory.quadrotor[k].z
                }),
            ],
            Measured::Path {
                after_s,
                quadrotor,
                end_effector,
            } => {
                let first = (after_s / DT).round() as usize;
                vec![
                    path_difference(Signal::Quadrotor, quadrotor, &trajectory.quadrotor[first..]),
                    path_difference(
                        Signal::EndEffector,
                        end_effector,
                        &trajectory.end_effector[first..],
                    ),
                ]
            }
            Measured::Rows {
                quadrotor,
                end_effector,
            } => vec![
                row_difference(Signal::Quadrotor, quadrotor, &trajectory.quadrotor),
                row_difference(Signal::EndEffector, end_effector, &trajectory.end_effector),
            ],
        }
    }
}

fn path_difference(signal: Signal, measured: &[[f64; 2]], path: &[Vector3<f64>]) -> Difference {
    let path: Vec<Vector2<f64>> = path.iter().map(|p| p.xy()).collect();
    let values = measured
        .iter()
        .flat_map(|point| {
            let point = Vector2::from(*point);
            let nearest = path
                .windows(2)
                .map(|ends| nearest_on_segment(&point, &ends[0], &ends[1]))
                .min_by(|a, b| (a - point).norm_squared().total_cmp(&(b - point).norm_squared()))
                .unwrap_or(path[0]);
            let difference = nearest - point;
            [difference.x, difference.y]
        })
        .collect();
    Difference {
        signal,
        values,
        components: 2,
    }
}

fn nearest_on_segment(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> Vector2<f64> {
    let direction = b - a;
    let length = direction.norm_squared();
    let fraction = if length > 0.0 {
        ((point - a).dot(&direction) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    a + fraction * direction
}

fn row_difference(signal: Signal, measured: &[Option<[f64; 3]>], rows: &[Vector3<f64>]) -> Difference {
    let values = measured
        .iter()
        .zip(rows)
        .filter_map(|(measured, row)| measured.map(|m| row - Vector3::from(m)))
        .flat_map(|d| [d.x, d.y, d.z])
        .collect();
    Difference {
        signal,
        values,
        components: 3,
    }
}

impl Difference {
    /// Root mean square distance, m.
    pub fn rms(&self) -> f64 {
        let points = (self.values.len() / self.components).max(1) as f64;
        (self.values.iter().map(|v| v * v).sum::<f64>() / points).sqrt()
    }

    /// Mean distance, m.
    pub fn mean(&self) -> f64 {
        let points = (self.values.len() / self.components).max(1) as f64;
        let distance = |point: &[f64]| point.iter().map(|v| v * v).sum::<f64>().sqrt();
        self.values.chunks(self.components).map(distance).sum::<f64>() / points
    }
}

/// Replays every recording and measures the differences. Recordings fly in parallel; the result does not depend
/// on the number of threads.
pub fn replay_table(
    vehicle: &SimulatedVehicle,
    recordings: &[Recording],
) -> Result<Vec<ReplayRow>, VehicleError> {
    use rayon::prelude::*;
    recordings
        .par_iter()
        .map(|recording| {
            let differences = recording.differences(&recording.fly(&mut vehicle.clone())?);
            let path = matches!(recording.measured, Measured::Path { .. });
            let value = |signal| {
                let difference = differences.iter().find(|difference| difference.signal == signal);
                difference.map(|d| if path { d.mean() } else { d.rms() })
            };
            Ok(ReplayRow {
                name: recording.name.clone(),
                quadrotor_m: value(Signal::Quadrotor).unwrap_or(f64::NAN),
                end_effector_m: value(Signal::EndEffector).unwrap_or(f64::NAN),
                height_m: value(Signal::Height),
            })
        })
        .collect()
}
