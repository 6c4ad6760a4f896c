//! A flight as the physical model reads it: commands, arm lengths, and the poses that can be believed.

use super::arm::ArmLength;
use super::error::PhysicalError;
use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::{OUTPUT_LEN, State};
use super::vector::{Attitude, Vector};
use crate::DT;
use crate::flight::{CLOCK_TOLERANCE_S, Configuration, Flight, Sample};

/// Shortest unbroken stretch that is worth simulating, rows.
const SHORTEST_ROWS: usize = 40;
/// Rows after the first that [`FlightData::start`] looks at.
pub const START_ROWS: usize = 2;

/// Bodies that move less than this over the start are at rest: their slopes would be noise, m.
const STILL_M: f64 = 2e-3;

/// What motion capture saw in one row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observed {
    /// The outputs `x ∈ R⁹`; zero where the body was not seen.
    pub outputs: [f64; OUTPUT_LEN],
    /// Entries 0..6 are real.
    pub quadrotor: bool,
    /// Entries 6..9 are real.
    pub end_effector: bool,
}

impl Observed {
    /// Whether both bodies were seen.
    pub fn complete(&self) -> bool {
        self.quadrotor && self.end_effector
    }
}

impl From<&Sample> for Observed {
    fn from(sample: &Sample) -> Self {
        let mut outputs = [0.0; OUTPUT_LEN];
        if let Some(pose) = sample.quadrotor {
            outputs[..3].copy_from_slice(&pose.position);
            outputs[3..6].copy_from_slice(&pose.attitude[1..]);
        }
        if let Some(tip) = sample.end_effector {
            outputs[6..].copy_from_slice(&tip);
        }
        Observed {
            outputs,
            quadrotor: sample.quadrotor.is_some(),
            end_effector: sample.end_effector.is_some(),
        }
    }
}

/// An evenly timed stretch of a flight that begins with a row where both bodies were seen.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightData {
    /// Name of the flight.
    pub name: String,
    /// Row of the flight at which the stretch begins.
    pub first_row: usize,
    /// Configuration of the arm per row.
    pub configurations: Vec<Configuration>,
    /// Arm length per row, and its rate until the next row.
    pub arms: Vec<ArmLength>,
    /// Command issued at each row, m.
    pub commands: Vec<[f64; 3]>,
    /// Every command came with its velocity, which the vehicle may have been given, too.
    pub commanded_velocity: bool,
    /// What was seen in each row.
    pub observed: Vec<Observed>,
    /// How much its rows count in a fit.
    pub weight: f64,
}

impl FlightData {
    /// The stretches of `flight` between its clock gaps, shortest ones left out. Poses are believed as they
    /// are: hygiene ([`crate::flight::clean`]) comes before.
    ///
    /// # Errors
    /// A number is not finite, or no stretch is long enough.
    pub fn stretches(flight: &Flight) -> Result<Vec<Self>, PhysicalError> {
        let samples = &flight.samples;
        if let Some(row) = samples.iter().position(|sample| !is_finite(sample)) {
            return Err(PhysicalError::NotFinite {
                flight: flight.name.clone(),
                row,
            });
        }
        let gap = |row: usize| (samples[row].t_s - samples[row - 1].t_s - DT).abs() > CLOCK_TOLERANCE_S;
        let mut edges: Vec<usize> = (1..samples.len()).filter(|&row| gap(row)).collect();
        edges.insert(0, 0);
        edges.push(samples.len());
        let stretches: Vec<Self> = edges
            .windows(2)
            .filter_map(|edge| Self::from_rows(flight, edge[0], edge[1]))
            .collect();
        if stretches.is_empty() {
            return Err(PhysicalError::TooShort {
                flight: flight.name.clone(),
                rows: samples.len(),
                needed: SHORTEST_ROWS,
            });
        }
        Ok(stretches)
    }

    fn from_rows(flight: &Flight, begin: usize, end: usize) -> Option<Self> {
        let seen = |row: &usize| Observed::from(&flight.samples[*row]).complete();
        let first_row = (begin..end).find(seen)?;
        let samples = &flight.samples[first_row..end];
        if samples.len() < SHORTEST_ROWS {
            return None;
        }
        let configurations: Vec<_> = samples.iter().map(|sample| sample.configuration).collect();
        Some(FlightData {
            name: flight.name.clone(),
            first_row,
            arms: arm_lengths(&configurations),
            configurations,
            commands: samples.iter().map(|sample| sample.command).collect(),
            commanded_velocity: samples.iter().all(|sample| sample.command_velocity.is_some()),
            observed: samples.iter().map(Observed::from).collect(),
            weight: 1.0,
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.commands.len()
    }

    /// The state at `row` as the poses there and in the next [`START_ROWS`] rows suggest it; at rest if
    /// nothing moves or one of those is missing. Rates are the slopes of parabolas: `ẋ₀ = (−3 x₀ + 4 x₁ − x₂) / 2Δt`.
    pub fn start<S: Scalar>(&self, row: usize, parameters: &Parameters<S>) -> State<S> {
        let window = &self.observed[row..(row + START_ROWS + 1).min(self.rows())];
        let known = window.len() == START_ROWS + 1 && window.iter().all(Observed::complete);
        let sent = |knots: usize| self.commands[row.saturating_sub(knots)];
        let start = |velocity, tip_velocity| {
            let (arm, outputs) = (self.arms[row], &window[0].outputs);
            let mut state = State::from_poses(parameters, arm, outputs, velocity, tip_velocity, sent(1));
            for (knots, command) in state.commands.iter_mut().enumerate() {
                *command = Vector::constant(sent(knots + 1));
            }
            state
        };
        let moved = |entry: usize| (window[START_ROWS].outputs[entry] - window[0].outputs[entry]).abs();
        if !known || [0, 1, 2, 6, 7, 8].into_iter().all(|entry| moved(entry) < STILL_M) {
            return start([0.0; 3], [0.0; 3]);
        }
        let x = [0, 1, 2].map(|later| &window[later].outputs);
        let slope = |entry: usize| {
            std::array::from_fn(|i| {
                let i = entry + i;
                (4.0 * x[1][i] - 3.0 * x[0][i] - x[2][i]) / (2.0 * DT)
            })
        };
        let mut state = start(slope(0), slope(6));
        // ω = 2 d/dt vec(q₀* ⊗ q), whose value at row 0 is zero.
        let turned = [1, 2].map(|later: usize| {
            let [_, _, _, a, b, c, ..] = *x[later];
            let attitude = Attitude::from_vector_part(Vector::constant([a, b, c]));
            state.rotation().half_rotation_to(&attitude)
        });
        state.body_rate = (turned[0].scale(4.0) - turned[1]).scale(1.0 / DT);
        state
    }
}

/// Arm lengths along a schedule of configurations, and their rates until the next knot.
pub fn arm_lengths(configurations: &[Configuration]) -> Vec<ArmLength> {
    let length = |knot: usize| configurations[knot.min(configurations.len() - 1)].length_m;
    (0..configurations.len())
        .map(|knot| ArmLength {
            length_m: length(knot),
            rate_m_s: (length(knot + 1) - length(knot)) / DT,
        })
        .collect()
}

fn is_finite(sample: &Sample) -> bool {
    let Configuration {
        length_m,
        pressure_kpa,
    } = sample.configuration;
    let poses = Observed::from(sample).outputs;
    let scalars = [sample.t_s, length_m, pressure_kpa];
    scalars
        .iter()
        .chain(&sample.command)
        .chain(&poses)
        .all(|value| value.is_finite())
}
