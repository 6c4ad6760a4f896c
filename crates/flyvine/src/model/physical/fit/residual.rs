//! Simulation error: how far whole flights, simulated from their first row, are from what was seen.

use super::super::flight_data::FlightData;
use super::super::parameters::{PARAMETER_COUNT, Parameters};
use super::super::scalar::Dual;
use super::super::state::{OUTPUT_LEN, State};
use super::super::step::step;
use super::super::vector::Vector;
use super::PhysicalFitOptions;
use rayon::prelude::*;

/// Number of parameters.
const N: usize = PARAMETER_COUNT;
/// A symmetric matrix over the parameters.
pub type Matrix = nalgebra::SMatrix<f64, N, N>;
/// A vector over the parameters.
pub type Column = nalgebra::SVector<f64, N>;

/// How far simulations of one configuration's flights are from what was seen:
///
/// ```text
/// 1/c Σ_flights weight Σ_rows Σ_bodies s² ln(1 + |e|² / (σ s)²)
/// ```
///
/// with residuals e of quadrotor position, attitude and end effector, each with its own σ. The logarithm
/// (Cauchy's loss) is quadratic for errors small against `s σ` and keeps a simulation that went astray from
/// outweighing everything else.
pub struct Misfit<'a> {
    /// Flights to simulate.
    pub flights: &'a [FlightData],
    /// Only the first rows of every flight count.
    pub rows: usize,
    /// Errors are large beyond this distance, m.
    pub robust_scale_m: f64,
    /// Rows c that share one model error.
    pub correlated_rows: f64,
    /// Residual sizes.
    pub options: &'a PhysicalFitOptions,
}

/// A [`Misfit`]'s value.
#[derive(Debug, Clone, Copy, Default)]
pub struct Value {
    /// The loss; infinite where a simulation is not finite.
    pub loss: f64,
    /// Sum over the rows of the end effector's distance from where it was seen, m.
    pub tip_distance_m: f64,
    /// Rows in which it was seen.
    pub tip_rows: usize,
}

/// The quadratic model of a [`Misfit`]: half its gradient, and the Gauss–Newton half of its Hessian.
pub struct NormalEquations {
    /// Half the gradient.
    pub gradient: Column,
    /// Half the Hessian, without second derivatives of the simulation.
    pub hessian: Matrix,
}

impl Value {
    /// Of two sets of flights together.
    pub fn and(self, other: Value) -> Value {
        Value {
            loss: self.loss + other.loss,
            tip_distance_m: self.tip_distance_m + other.tip_distance_m,
            tip_rows: self.tip_rows + other.tip_rows,
        }
    }

    /// Mean distance of the end effector from where it was seen, m.
    pub fn tip_error_m(self) -> f64 {
        self.tip_distance_m / self.tip_rows.max(1) as f64
    }
}

impl Misfit<'_> {
    /// The value at `parameters`.
    pub fn value(&self, parameters: &Parameters<f64>) -> Value {
        let values: Vec<Value> = self
            .flights
            .par_iter()
            .map(|flight| self.flight_value(flight, parameters))
            .collect();
        let sum = values.into_iter().fold(Value::default(), Value::and);
        let loss = if sum.loss.is_finite() {
            sum.loss
        } else {
            f64::INFINITY
        };
        Value { loss, ..sum }
    }

    /// Gradient and Hessian at `parameters`, by forward-mode sensitivities.
    pub fn normal_equations(&self, parameters: &Parameters<f64>) -> NormalEquations {
        let parts: Vec<NormalEquations> = self
            .flights
            .par_iter()
            .map(|flight| self.flight_normal_equations(flight, parameters))
            .collect();
        let (mut gradient, mut hessian) = (Column::zeros(), Matrix::zeros());
        for part in &parts {
            gradient += part.gradient;
            hessian += part.hessian;
        }
        hessian.fill_lower_triangle_with_upper_triangle();
        NormalEquations { gradient, hessian }
    }

    /// Rows that count.
    pub fn counted_rows(&self) -> usize {
        self.flights
            .iter()
            .map(|flight| flight.rows().min(self.rows))
            .sum()
    }

    fn flight_value(&self, flight: &FlightData, parameters: &Parameters<f64>) -> Value {
        let mut state = flight.start(0, parameters);
        let mut sum = Value::default();
        for row in 0..flight.rows().min(self.rows) {
            let outputs = state.outputs();
            sum.loss += self.row_loss(flight, row, &outputs).0;
            if flight.observed[row].end_effector {
                let seen = &flight.observed[row].outputs;
                sum.tip_distance_m += (6..9).map(|i| (outputs[i] - seen[i]).powi(2)).sum::<f64>().sqrt();
                sum.tip_rows += 1;
            }
            state = step(
                parameters,
                flight.arms[row],
                &state,
                &Vector(flight.commands[row]),
            );
        }
        sum.loss *= flight.weight / self.correlated_rows;
        sum
    }

    fn flight_normal_equations(&self, flight: &FlightData, parameters: &Parameters<f64>) -> NormalEquations {
        let variables = parameters.variables();
        let mut state: State<Dual> = flight.start(0, &variables);
        let mut gradient = Column::zeros();
        let mut hessian = Matrix::zeros();
        for row in 0..flight.rows().min(self.rows) {
            let outputs = state.outputs();
            let values = outputs.map(|output| output.value);
            let (_, weights) = self.row_loss(flight, row, &values);
            for entry in (0..OUTPUT_LEN).filter(|&entry| weights[entry] > 0.0) {
                let error = values[entry] - flight.observed[row].outputs[entry];
                let slopes = &outputs[entry].gradient;
                for j in 0..N {
                    let weighted = flight.weight * weights[entry] * slopes[j];
                    gradient[j] += weighted * error;
                    for i in 0..=j {
                        hessian[(i, j)] += weighted * slopes[i];
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
        NormalEquations { gradient, hessian }
    }

    /// Loss of one row, and the weight of every squared residual at which its slope is the loss's (times 1/c).
    pub fn row_loss(
        &self,
        flight: &FlightData,
        row: usize,
        outputs: &[f64; OUTPUT_LEN],
    ) -> (f64, [f64; OUTPUT_LEN]) {
        let observed = &flight.observed[row];
        let (position, attitude) = (self.options.position_sigma_m, self.options.attitude_sigma);
        let robust = (self.robust_scale_m / position).powi(2);
        let mut loss = 0.0;
        let mut weights = [0.0; OUTPUT_LEN];
        for (entries, sigma, seen) in [
            (0..3, position, observed.quadrotor),
            (3..6, attitude, observed.quadrotor),
            (6..9, position, observed.end_effector),
        ] {
            if !seen {
                continue;
            }
            let squares: f64 = entries
                .clone()
                .map(|i| (outputs[i] - observed.outputs[i]).powi(2))
                .sum();
            let relative = squares / (sigma * sigma * robust);
            loss += robust * relative.ln_1p();
            weights[entries].fill(1.0 / ((1.0 + relative) * sigma * sigma * self.correlated_rows));
        }
        (loss, weights)
    }
}
