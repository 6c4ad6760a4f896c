//! Are the clocks right? Transport offsets and drifts of every flight's streams, estimated at the end of a fit.
//!
//! A stream that is late by τ shows `x(t − τ)`, so its predicted pose has the sensitivity −v to τ, and −v (t − t̄) to
//! a drift of its clock. One Gauss–Newton step over the model's parameters and the offsets of all flights together,
//!
//! ```text
//! [ H_θθ  H_θτ ] [ δθ ]     [ g_θ ]
//! [ H_τθ  H_ττ ] [ τ  ] = − [ g_τ ]
//! ```
//!
//! gives offsets far below the sampling time, with standard errors that know what the parameters could have absorbed.
//! A lateness that all flights share looks like a delay of the autopilot, or like what the model lacks, so every
//! flight's is counted from the median; what stays of the common one is how far the end effector's stream is behind
//! the quadrotor's.

use super::super::flight_data::FlightData;
use super::super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters};
use super::super::state::State;
use super::super::step::step;
use super::super::vector::Vector;
use super::residual::Misfit;
use crate::DT;
use crate::model::rollout::quantile;
use nalgebra::{DMatrix, DVector, SVector};
use rayon::prelude::*;
use serde::Serialize;

/// Unknowns per flight: lateness of the quadrotor's stream, of the end effector's, drift of both.
const UNKNOWNS: usize = 3;
/// Standard deviations that they have before anything is known: s, s, s/s.
const PRIOR: [f64; UNKNOWNS] = [0.03, 0.03, 1e-3];
/// An offset is worth a word beyond this, s, and this many standard errors; a drift, when it adds up to that.
const NOTABLE_S: f64 = 0.008;
const NOTABLE_ERRORS: f64 = 4.0;

/// A value and its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// The clocks of a configuration's flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamTiming {
    /// Lateness of the end effector's poses behind the quadrotor's, in the median flight, s.
    pub end_effector_behind_quadrotor_s: f64,
    /// One per unbroken stretch of a flight.
    pub flights: Vec<FlightTiming>,
}

impl StreamTiming {
    /// Whether the two streams, in all flights alike, are apart.
    pub fn streams_apart(&self) -> bool {
        self.end_effector_behind_quadrotor_s.abs() > NOTABLE_S
    }
}

/// How late the streams of one flight are behind its commands, compared with the median of the flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlightTiming {
    /// Name of the flight.
    pub flight: String,
    /// Duration of the stretch that was looked at, s.
    pub duration_s: f64,
    /// Lateness of the quadrotor's poses behind the commands, beyond the median flight's, s.
    pub quadrotor_late_s: Estimate,
    /// Lateness of the end effector's poses behind the commands, beyond the median flight's, s.
    pub end_effector_late_s: Estimate,
    /// By how much the lateness of both grows, s per s.
    pub drift: Estimate,
}

impl FlightTiming {
    /// The lateness of one stream, or the drift, that cannot be an accident.
    pub fn notable(&self) -> bool {
        let drifted = Estimate {
            value: self.drift.value * self.duration_s,
            standard_error: self.drift.standard_error * self.duration_s,
        };
        [self.quadrotor_late_s, self.end_effector_late_s, drifted]
            .iter()
            .any(|estimate| {
                estimate.value.abs() > NOTABLE_S
                    && estimate.value.abs() > NOTABLE_ERRORS * estimate.standard_error
            })
    }
}

impl std::fmt::Display for FlightTiming {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let milliseconds = |estimate: Estimate| {
            format!(
                "{:.0} ± {:.0} ms",
                1e3 * estimate.value,
                1e3 * estimate.standard_error
            )
        };
        write!(
            f,
            "flight {}: quadrotor late by {}, end effector late by {}, drifting by {:.1} ± {:.1} ms per minute",
            self.flight,
            milliseconds(self.quadrotor_late_s),
            milliseconds(self.end_effector_late_s),
            6e4 * self.drift.value,
            6e4 * self.drift.standard_error
        )
    }
}

/// Sums over one flight: of the parameters and, after them, its offsets.
struct Sums {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// The timing of every flight of `misfit` at fitted `parameters`; `None` if the equations are singular.
pub fn timing(misfit: &Misfit, parameters: &Parameters<f64>) -> Option<StreamTiming> {
    let parts: Vec<Sums> = misfit
        .flights
        .par_iter()
        .map(|flight| sums(misfit, flight, parameters))
        .collect();
    let size = PARAMETER_COUNT + UNKNOWNS * parts.len();
    let (mut hessian, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    for (i, info) in PARAMETERS.iter().enumerate() {
        let coordinate = info.coordinate(parameters.to_array()[i]);
        hessian[(i, i)] = info.prior_sigma.powi(-2);
        gradient[i] = hessian[(i, i)] * (coordinate - info.coordinate(info.default));
    }
    for (number, part) in parts.iter().enumerate() {
        let place = |i: usize| {
            if i < PARAMETER_COUNT {
                i
            } else {
                i + UNKNOWNS * number
            }
        };
        for i in 0..PARAMETER_COUNT + UNKNOWNS {
            for j in 0..PARAMETER_COUNT + UNKNOWNS {
                hessian[(place(i), place(j))] += part.hessian[(i, j)];
            }
            gradient[place(i)] += part.gradient[i];
        }
        for (i, sigma) in PRIOR.iter().enumerate() {
            let entry = place(PARAMETER_COUNT + i);
            hessian[(entry, entry)] += sigma.powi(-2);
        }
    }
    let covariance = hessian.cholesky()?.inverse();
    let step = -(&covariance * gradient);
    let of_flight = |(number, flight): (usize, &FlightData)| {
        let estimate = |i: usize| {
            let entry = PARAMETER_COUNT + UNKNOWNS * number + i;
            Estimate {
                value: step[entry],
                standard_error: covariance[(entry, entry)].sqrt(),
            }
        };
        FlightTiming {
            flight: flight.name.clone(),
            duration_s: flight.rows() as f64 * DT,
            quadrotor_late_s: estimate(0),
            end_effector_late_s: estimate(1),
            drift: estimate(2),
        }
    };
    let mut flights: Vec<FlightTiming> = misfit.flights.iter().enumerate().map(of_flight).collect();
    let middle = |of: fn(&FlightTiming) -> f64| {
        let mut values: Vec<f64> = flights.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        quantile(&values, 0.5).unwrap_or(0.0)
    };
    let quadrotor = middle(|flight| flight.quadrotor_late_s.value);
    let end_effector = middle(|flight| flight.end_effector_late_s.value);
    for flight in &mut flights {
        flight.quadrotor_late_s.value -= quadrotor;
        flight.end_effector_late_s.value -= end_effector;
    }
    Some(StreamTiming {
        end_effector_behind_quadrotor_s: end_effector - quadrotor,
        flights,
    })
}

fn sums(misfit: &Misfit, flight: &FlightData, parameters: &Parameters<f64>) -> Sums {
    const SIZE: usize = PARAMETER_COUNT + UNKNOWNS;
    let variables = parameters.variables();
    let mut state = flight.start(0, &variables);
    let (mut hessian, mut gradient) = (DMatrix::zeros(SIZE, SIZE), DVector::zeros(SIZE));
    let middle = 0.5 * flight.rows() as f64;
    for row in 0..flight.rows() {
        let outputs = state.outputs();
        let (_, weights) = misfit.row_loss(flight, row, &outputs.map(|output| output.value));
        let since_middle_s = (row as f64 - middle) * DT;
        for (entry, output) in outputs
            .iter()
            .enumerate()
            .filter(|&(entry, _)| weights[entry] > 0.0)
        {
            let late = lateness(&state, entry, since_middle_s);
            let slopes = SVector::<f64, SIZE>::from_fn(|i, _| {
                if i < PARAMETER_COUNT {
                    output.gradient[i]
                } else {
                    late[i - PARAMETER_COUNT]
                }
            });
            let weight = flight.weight * weights[entry];
            let error = output.value - flight.observed[row].outputs[entry];
            for i in 0..SIZE {
                gradient[i] += weight * slopes[i] * error;
                for j in 0..SIZE {
                    hessian[(i, j)] += weight * slopes[i] * slopes[j];
                }
            }
        }
        state = step(
            &variables,
            flight.arms[row],
            &state,
            &Vector::constant(flight.commands[row]),
        );
    }
    Sums { hessian, gradient }
}

/// Sensitivities of one output to the flight's offsets.
fn lateness<S: super::super::scalar::Scalar>(
    state: &State<S>,
    entry: usize,
    since_middle_s: f64,
) -> [f64; UNKNOWNS] {
    let velocity = |vector: &Vector<S>, axis: usize| vector.0[axis].value();
    match entry {
        0..3 => {
            let v = velocity(&state.velocity, entry);
            [-v, 0.0, -v * since_middle_s]
        }
        6..9 => {
            let v = velocity(
                &state.point_velocities[state.point_velocities.len() - 1],
                entry - 6,
            );
            [0.0, -v, -v * since_middle_s]
        }
        _ => [0.0; UNKNOWNS],
    }
}
