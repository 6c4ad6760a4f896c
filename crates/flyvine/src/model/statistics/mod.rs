//! What a regression says about itself, row by row: everything that MATLAB's `fitlm` tells, with which the
//! paper's models were fitted.
//!
//! [`row_statistics`] looks at one row of a lag model; [`regress`] and [`regress_robustly`] take any regressors.

mod ordinary;
mod robust;

pub use ordinary::{CoefficientStatistics, Regression, regress};
pub use robust::{RobustLoss, RobustRegression, regress_robustly};

use super::error::ModelError;
use super::features::{quadratic_len, quadratic_terms};
use super::lag::{CommandInputs, HEIGHT_ROW, STATE_LEN};
use super::options::Structure;
use super::track::Track;
use crate::flight::{Flight, SIGNALS};

/// A least-squares problem: named columns and observations of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Observations {
    /// Names of the regressors.
    pub names: Vec<String>,
    /// Regressors, one row per observation (rows × names), row-major.
    pub regressors: Vec<f64>,
    /// What is regressed, one per observation.
    pub response: Vec<f64>,
    /// Whether column 0 is the constant.
    pub intercept: bool,
}

/// The observations of row `signal` (0 to 8) of a lag model: the increment of that signal against
/// `w = (z, u)`, and for the height row of the paper's structure against the constant, w and its products.
///
/// # Errors
/// A flight without rows or without a commanded velocity that the inputs call for.
pub fn row_observations(
    flights: &[Flight],
    signal: usize,
    structure: Structure,
    lags: usize,
    inputs: CommandInputs,
) -> Result<Observations, ModelError> {
    super::lag::require_lags(lags)?;
    let quadratic = structure == Structure::Paper && signal == HEIGHT_ROW;
    let p = lags * STATE_LEN + inputs.len();
    let (mut regressors, mut response) = (Vec::new(), Vec::new());
    let (mut w, mut terms) = (vec![0.0; p], vec![0.0; quadratic_len(p)]);
    for flight in flights {
        let track = Track::new(flight, inputs)?;
        for k in (0..track.rows()).filter(|&k| track.unbroken(k, lags, 1)) {
            track.lagged_state(k, &mut w[..lags * STATE_LEN]);
            w[lags * STATE_LEN..].copy_from_slice(track.command(k));
            if quadratic {
                quadratic_terms(&w, &w, &mut terms);
                regressors.extend_from_slice(&terms);
            } else {
                regressors.extend_from_slice(&w);
            }
            response.push(track.state(k + 1)[signal] - track.state(k)[signal]);
        }
    }
    Ok(Observations {
        names: names(lags, inputs, quadratic),
        regressors,
        response,
        intercept: quadratic,
    })
}

/// What the least-squares fit of row `signal` of a lag model says about itself.
///
/// # Errors
/// As [`row_observations`] and [`regress`].
pub fn row_statistics(
    flights: &[Flight],
    signal: usize,
    structure: Structure,
    lags: usize,
    inputs: CommandInputs,
) -> Result<Regression, ModelError> {
    regress(&row_observations(flights, signal, structure, lags, inputs)?)
}

/// `qr_x[k]`, `qr_x[k-1]`, …, `cmd_x`, …, and products of them.
fn names(lags: usize, inputs: CommandInputs, quadratic: bool) -> Vec<String> {
    let lagged = |lag: usize| {
        if lag == 0 {
            "[k]".into()
        } else {
            format!("[k-{lag}]")
        }
    };
    let commands = ["cmd_x", "cmd_y", "cmd_z", "cmd_vx", "cmd_vy", "cmd_vz"];
    let states = (0..lags).flat_map(|lag| {
        SIGNALS
            .iter()
            .map(move |signal| format!("{signal}{}", lagged(lag)))
    });
    let linear: Vec<String> = states
        .chain(commands[..inputs.len()].iter().map(|name| name.to_string()))
        .collect();
    if !quadratic {
        return linear;
    }
    let product = |i: usize, j: usize| {
        if i == j {
            format!("{}^2", linear[i])
        } else {
            format!("{}*{}", linear[i], linear[j])
        }
    };
    let pairs = (0..linear.len()).flat_map(|i| (i..linear.len()).map(move |j| (i, j)));
    let products: Vec<String> = pairs.map(|(i, j)| product(i, j)).collect();
    [vec!["(intercept)".to_owned()], linear, products].concat()
}
