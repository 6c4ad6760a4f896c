//! Least squares for a [`Correction`]: one Gauss–Newton step from physics alone, on simulation error.
//!
//! Windows of 2.5 s begin where the observer says that the vehicle was. With `F = ∂f/∂z` along the simulation and the
//! correction's coefficients c in one vector, the state's sensitivity is
//!
//! ```text
//! S_{k+1} = F_k S_k + ∂(C φ_k)/∂c,   S_0 = 0
//! ```
//!
//! so that the normal equations of several flights are the sums of theirs.

use super::PhysicalFitOptions;
use crate::flight::Flight;
use crate::model::physical::correction::{CORRECTED, Correction, FEATURES, features};
use crate::model::physical::state::{STATE_LEN, offset};
use crate::model::physical::{FlightData, PhysicalError, PhysicalModel, observe};
use crate::trajopt::Dynamics;
use nalgebra::{DMatrix, DVector};

/// Number of coefficients.
const COEFFICIENTS: usize = CORRECTED.len() * FEATURES;
/// Steps of a window, and rows from one window's start to the next.
const WINDOW_STEPS: usize = 50;
const WINDOW_STRIDE: usize = 25;
/// Rows that the observer has before the first window.
const SETTLED_ROWS: usize = 10;
/// Rows of the state whose simulation is compared: both positions.
const COMPARED: [usize; 6] = [
    offset::POSITION,
    offset::POSITION + 1,
    offset::POSITION + 2,
    offset::TIP,
    offset::TIP + 1,
    offset::TIP + 2,
];

/// What one flight says about the correction of a model.
#[derive(Debug, Clone)]
pub struct CorrectionEquations {
    /// `Σ Sᵀ S / σ²`, [`COEFFICIENTS`] square.
    normal: DMatrix<f64>,
    /// `Σ Sᵀ (seen − simulated) / σ²`.
    right: DVector<f64>,
    /// Sums of the features' squares.
    squares: [f64; FEATURES],
    /// Rows that were simulated.
    rows: usize,
}

impl CorrectionEquations {
    /// Simulates `flight` by `model`, which has no correction yet.
    ///
    /// # Errors
    /// As [`FlightData::stretches`] and [`observe`].
    pub fn new(
        model: &PhysicalModel,
        flight: &Flight,
        options: &PhysicalFitOptions,
    ) -> Result<Self, PhysicalError> {
        let mut equations = CorrectionEquations {
            normal: DMatrix::zeros(COEFFICIENTS, COEFFICIENTS),
            right: DVector::zeros(COEFFICIENTS),
            squares: [0.0; FEATURES],
            rows: 0,
        };
        for stretch in FlightData::stretches(flight)? {
            let estimates = observe(model, &model.parameters, &stretch, 0)?;
            for start in (SETTLED_ROWS..stretch.rows()).step_by(WINDOW_STRIDE) {
                equations.add_window(model, &stretch, start, &estimates[start]);
            }
        }
        let variance = options.position_sigma_m.powi(2) * options.correlated_rows;
        let weight = options.weights.get(&flight.name).copied().unwrap_or(1.0) / variance;
        equations.normal *= weight;
        equations.right *= weight;
        Ok(equations)
    }

    fn add_window(
        &mut self,
        model: &PhysicalModel,
        flight: &FlightData,
        start: usize,
        estimate: &[f64; STATE_LEN],
    ) {
        let command_len = model.command_len();
        let width = STATE_LEN + command_len;
        let mut state = *estimate;
        let mut next = [0.0; STATE_LEN];
        let mut jacobian = vec![0.0; STATE_LEN * width];
        let mut sensitivity = DMatrix::zeros(STATE_LEN, COEFFICIENTS);
        let end = (start + WINDOW_STEPS + 1).min(flight.rows());
        for row in start..end - 1 {
            let command = &flight.commands[row];
            model.linearize(row, &state, command, &mut next, &mut jacobian);
            let features = features(model.arm.length_m, &state, command);
            let transition = DMatrix::from_fn(STATE_LEN, STATE_LEN, |i, j| jacobian[i * width + j]);
            sensitivity = transition * sensitivity;
            for (number, &entry) in CORRECTED.iter().enumerate() {
                for (j, feature) in features.iter().enumerate() {
                    sensitivity[(entry, number * FEATURES + j)] += feature;
                }
            }
            state = next;
            let seen = &flight.observed[row + 1];
            if seen.complete() {
                let error = DVector::from_fn(COMPARED.len(), |i, _| {
                    seen.outputs[COMPARED[i]] - state[COMPARED[i]]
                });
                let compared = sensitivity.select_rows(&COMPARED);
                self.normal.gemm_tr(1.0, &compared, &compared, 1.0);
                self.right.gemv_tr(1.0, &compared, &error, 1.0);
                self.rows += 1;
            }
            for (square, feature) in self.squares.iter_mut().zip(features) {
                *square += feature * feature;
            }
        }
    }

    /// The correction by the sum of several flights' equations. A priori every term, its feature being of ordinary size,
    /// adds `deviation_m_s` to a velocity, give or take. `None` if they are singular.
    pub fn solve(flights: &[&Self], deviation_m_s: f64) -> Option<Correction> {
        let mut normal = DMatrix::zeros(COEFFICIENTS, COEFFICIENTS);
        let mut right = DVector::zeros(COEFFICIENTS);
        let (mut squares, mut rows) = ([0.0; FEATURES], 0);
        for flight in flights {
            normal += &flight.normal;
            right += &flight.right;
            for (sum, square) in squares.iter_mut().zip(flight.squares) {
                *sum += square;
            }
            rows += flight.rows;
        }
        for i in 0..COEFFICIENTS {
            let mean_square = squares[i % FEATURES] / rows.max(1) as f64;
            normal[(i, i)] += mean_square / deviation_m_s.powi(2) + f64::MIN_POSITIVE;
        }
        let solution = normal.cholesky()?.solve(&right);
        Some(Correction::new(solution.as_slice()))
    }
}
