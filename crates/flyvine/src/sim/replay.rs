//! Replays of recorded flights: the recorded commands flown on the simulated vehicle, and the distance
//! from what was measured.
//!
//! Of the paper's hardware flights ([`super::paper`]) a swing is known against time and a lemniscate only as a
//! path; of one's own recordings every row is known.

use super::SimulatedVehicle;
use super::paper::ReplayError;
use crate::DT;
use crate::flight::{Configuration, Flight};
use crate::link::{Setpoint, Vehicle, VehicleError};
use nalgebra::{Vector2, Vector3};

/// Where every vehicle hovers after a reset, m.
const START: [f64; 3] = [0.0, 0.0, crate::HOVER_HEIGHT_M];

/// Commands that were flown, and what was measured of the flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Short name, for tables.
    pub name: String,
    /// Configuration at each command.
    pub configurations: Vec<Configuration>,
    /// Commanded quadrotor positions, one every [`DT`], m.
    pub commands: Vec<[f64; 3]>,
    /// Velocities sent beside them, m/s; zero where there were positions alone.
    pub velocities: Vec<Option<[f64; 3]>>,
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

impl Recording {
    /// A recorded flight: its commands, configurations and poses, moved so that the quadrotor is first seen where
    /// a replay starts. The vehicle should hover there, for a replay starts at rest.
    pub fn from_flight(flight: &Flight) -> Result<Recording, ReplayError> {
        if flight.samples.len() < 2 {
            return Err(ReplayError::TooShort {
                name: flight.name.clone(),
                found: flight.samples.len(),
                expected: 2,
            });
        }
        let samples = &flight.samples;
        let first = samples.iter().find_map(|sample| sample.quadrotor);
        let start = Vector3::from(first.map_or(START, |pose| pose.position));
        let moved = |position: [f64; 3]| (Vector3::from(position) - start + Vector3::from(START)).into();
        Ok(Recording {
            name: flight.name.clone(),
            configurations: samples.iter().map(|sample| sample.configuration).collect(),
            commands: samples.iter().map(|sample| moved(sample.command)).collect(),
            velocities: samples.iter().map(|sample| sample.command_velocity).collect(),
            measured: Measured::Rows {
                quadrotor: samples
                    .iter()
                    .map(|s| s.quadrotor.map(|pose| moved(pose.position)))
                    .collect(),
                end_effector: samples.iter().map(|s| s.end_effector.map(moved)).collect(),
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
        for ((command, velocity), configuration) in self
            .commands
            .iter()
            .zip(&self.velocities)
            .zip(&self.configurations)
        {
            let setpoint = Setpoint {
                position: *command,
                velocity: *velocity,
            };
            vehicle.step(setpoint, *configuration)?;
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
