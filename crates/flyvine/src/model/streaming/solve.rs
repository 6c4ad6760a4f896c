//! One configuration of a streaming fit, solved.

use super::super::bank::{BankModel, ModelDiagnostics};
use super::super::error::ModelError;
use super::super::family::Model;
use super::super::lag::HEIGHT_ROW;
use super::super::shape::{Ridges, Shape};
use super::Cell;
use super::sums::{Basis, Solved};
use crate::flight::{Configuration, SIGNALS};
use serde::Serialize;

/// Share by which rounding may enlarge a residual before sums are refused.
const ALLOWED_EXCESS: f64 = 1e-10;

/// One model of a streaming fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamedCorner {
    /// Where.
    pub configuration: Configuration,
    /// Number of flights.
    pub flights: usize,
    /// Transitions fitted.
    pub rows: usize,
    /// Condition number of the largest row's regressors, about rest, equilibrated.
    pub condition_number: f64,
    /// Share by which the norm of a row's residual may exceed the least one, for rounding.
    pub excess: f64,
    /// Root-mean-square residual of the end-effector height, m.
    pub height_residual_m: f64,
    /// Spectral radius of the Jacobian at rest.
    pub spectral_radius: f64,
}

/// Solves one configuration.
pub(super) fn solve_cell(
    cell: Cell,
    flights: usize,
    shape: Shape,
    ridges: Ridges,
) -> Result<(BankModel, StreamedCorner), ModelError> {
    let Cell {
        configuration,
        flights: names,
        mut sums,
    } = cell;
    sums.skip_to(flights);
    let sums = sums.total().expect("a configuration has flights");
    let (rows, coefficients) = (sums.rows(), shape.coefficients());
    if rows < coefficients {
        return Err(ModelError::TooFewRows {
            configuration,
            flights: names.len(),
            rows,
            coefficients,
        });
    }
    let basis = Basis::new(shape, configuration);
    let ill_conditioned = |excess: f64| ModelError::IllConditioned {
        configuration,
        excess,
    };
    let solved: Solved = sums
        .solve(&basis, ridges)
        .ok_or_else(|| ill_conditioned(f64::INFINITY))?;
    let excess = solved.excess();
    if excess > ALLOWED_EXCESS {
        return Err(ill_conditioned(excess));
    }
    let linear = shape.linear_rows(&solved.linear.theta);
    let model = Model::Lag(shape.assemble(linear, solved.height_row(&basis))?);
    let mut squares = solved.linear.residual_squares;
    let linear_condition_number = solved.linear.condition_number;
    let mut condition_number = linear_condition_number;
    if let Some(height) = &solved.height {
        squares[HEIGHT_ROW] = height.residual_squares[0];
        condition_number = height.condition_number;
    }
    let rms: Vec<f64> = squares
        .iter()
        .map(|square| (square / rows as f64).sqrt())
        .collect();
    let spectral_radius = model.spectral_radius(configuration)?;
    let corner = StreamedCorner {
        configuration,
        flights: names.len(),
        rows,
        condition_number,
        excess,
        height_residual_m: rms[HEIGHT_ROW],
        spectral_radius,
    };
    let diagnostics = ModelDiagnostics {
        flights: names,
        rows,
        coefficients,
        condition_number,
        linear_condition_number,
        spectral_radius,
        residual_rms: SIGNALS.map(String::from).into_iter().zip(rms).collect(),
    };
    let model = BankModel {
        configuration,
        model,
        diagnostics,
    };
    Ok((model, corner))
}
