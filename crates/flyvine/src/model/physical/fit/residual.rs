//! Simulation error: how far whole flights, simulated from their first row, are from what was seen.

use super::super::flight_data::FlightData;
use super::super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters};
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

/// What one stage of a fit minimizes, over the coordinates of the parameters:
///
/// ```text
/// 1/c Σ_rows Σ_bodies s² ln(1 + |e|² / (σ s)²)  +  Σ_i ((coordinate_i − default_i) / prior σ_i)²
/// ```
///
/// with residuals e of quadrotor position, attitude and end effector, each with its own σ. The logarithm
/// (Cauchy's loss) is quadratic for errors small against `s σ` and keeps a simulation that went astray from
/// outweighing everything else.
pub struct Objective<'a> {
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

/// The quadratic model of an [`Objective`]: half its gradient, and the Gauss–Newton half of its Hessian.
pub struct NormalEquations {
    /// Half the gradient.
    pub gradient: Column,
    /// Half the Hessian, without second derivatives of the simulation.
    pub hessian: Matrix,
}

impl Objective<'_> {
    /// The value at `parameters`; infinite where a simulation is not finite.
    pub fn value(&self, parameters: &Parameters<f64>) -> f64 {
        let values: Vec<f64> = self
            .flights
            .par_iter()
            .map(|flight| self.flight_value(flight, parameters))
            .collect();
        let value = values.iter().sum::<f64>() + prior(parameters).0;
        if value.is_finite() { value } else { f64::INFINITY }
    }

    /// Gradient and Hessian at `parameters`, by forward-mode sensitivities.
    pub fn normal_equations(&self, parameters: &Parameters<f64>) -> NormalEquations {
        let parts: Vec<NormalEquations> = self
            .flights
            .par_iter()
            .map(|flight| self.flight_normal_equations(flight, parameters))
            .collect();
        let (_, mut gradient, prior_hessian) = prior(parameters);
        let mut hessian = Matrix::from_diagonal(&prior_hessian);
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

    fn flight_value(&self, flight: &FlightData, parameters: &Parameters<f64>) -> f64 {
        let mut state = flight.start(0, parameters);
        let mut sum = 0.0;
        for row in 0..flight.rows().min(self.rows) {
            sum += self.row_loss(flight, row, &state.outputs()).0;
            state = step(
                parameters,
                flight.arms[row],
                &state,
                &Vector(flight.commands[row]),
            );
        }
        sum / self.correlated_rows
    }

    fn flight_normal_equations(&self, flight: &FlightData, parameters: &Parameters<f64>) -> NormalEquations {
        let variables = parameters.variables();
        let mut state: State<Dual<N>> = flight.start(0, &variables);
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
                    let weighted = weights[entry] * slopes[j];
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
    fn row_loss(
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

/// Value, half gradient and half Hessian diagonal of the prior.
fn prior(parameters: &Parameters<f64>) -> (f64, Column, Column) {
    let coordinates = parameters.coordinates();
    let (mut value, mut gradient, mut hessian) = (0.0, Column::zeros(), Column::zeros());
    for (i, info) in PARAMETERS.iter().enumerate() {
        let precision = info.prior_sigma.powi(-2);
        let deviation = coordinates[i] - info.coordinate(info.default);
        value += precision * deviation * deviation;
        gradient[i] = precision * deviation;
        hessian[i] = precision;
    }
    (value, gradient, hessian)
}
