//! Least squares and its statistics, and the linear-quadratic regulator.

use flyvine::control::mpc::{Stage, TrackingWeights, regulate};
use flyvine::model::statistics::{Observations, regress};
use numpy::{PyArray3, PyReadonlyArray3};
use pyo3::prelude::*;

use crate::arrays::{self, Matrix, Vector};
use crate::errors::{OrRaise, wrong};
use crate::json;

/// Ordinary least squares of a response (rows) on regressors (rows × columns), and what it says about itself.
#[pyfunction]
#[pyo3(name = "regress", signature = (regressors, response, names=None, intercept=false))]
fn regress_python<'py>(
    python: Python<'py>,
    regressors: Matrix<'py>,
    response: Vector<'py>,
    names: Option<Vec<String>>,
    intercept: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let regressors = regressors.as_array();
    let columns = regressors.ncols();
    let names = names.unwrap_or_else(|| (0..columns).map(|column| format!("x{column}")).collect());
    if names.len() != columns {
        return Err(wrong("names", names.len(), format!("{columns}, one per column")));
    }
    let data = Observations {
        names,
        response: arrays::numbers("response", &response, regressors.nrows())?,
        regressors: regressors.iter().copied().collect(),
        intercept,
    };
    let regression = python.detach(|| regress(&data)).or_raise()?;
    json::to_python(python, &regression)
}

/// Gains K_k of the time-varying regulator for z⁺ = A_k z + B_k u: u = K_k z.
#[pyfunction]
#[pyo3(name = "regulate")]
fn regulate_python<'py>(
    python: Python<'py>,
    a: PyReadonlyArray3<'py, f64>,
    b: PyReadonlyArray3<'py, f64>,
    state_weights: Vector<'py>,
    command_weights: Vector<'py>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let (a, b) = (a.as_array(), b.as_array());
    let (stages, n, m) = (a.shape()[0], a.shape()[1], b.shape()[2]);
    if a.shape()[2] != n || b.shape()[..2] != [stages, n] {
        let found = format!("{:?} and {:?}", a.shape(), b.shape());
        return Err(wrong("A and B", found, "N × n × n and N × n × m"));
    }
    let stage = Stage {
        state: n,
        command: m,
        fresh: n,
    };
    let weights = TrackingWeights {
        state: arrays::numbers("state_weights", &state_weights, n)?,
        command: arrays::numbers("command_weights", &command_weights, m)?,
        command_change: vec![0.0; m],
    };
    if let Some(weight) = weights
        .command
        .iter()
        .find(|weight| weight.is_nan() || **weight <= 0.0)
    {
        return Err(wrong("command_weights", weight, "positive numbers"));
    }
    let stride = stage.stride();
    let mut jacobians = vec![0.0; stages * stage.jacobian_len()];
    for (k, jacobian) in jacobians.chunks_exact_mut(stage.jacobian_len()).enumerate() {
        for i in 0..n {
            for j in 0..n {
                jacobian[i * stride + j] = a[[k, i, j]];
            }
            for j in 0..m {
                jacobian[i * stride + n + j] = b[[k, i, j]];
            }
        }
    }
    let gains = python.detach(|| {
        let regulator = regulate(&stage, &jacobians, &weights);
        // nalgebra stores columns.
        let rows = regulator.gains.iter().map(|gain| gain.transpose());
        rows.flat_map(|gain| gain.as_slice().to_vec()).collect()
    });
    arrays::stack(python, gains, [stages, m, n])
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(regress_python, module)?)?;
    module.add_function(wrap_pyfunction!(regulate_python, module)?)
}
