//! Scores and reports.

use std::path::PathBuf;

use flyvine::run::{read_results, score_flight, write_experiment, write_report};
use pyo3::prelude::*;

use crate::errors::OrRaise;
use crate::flight::PyFlight;
use crate::json;
use crate::plan::PyPlan;

/// How far a flown end effector was from where it should have been.
#[pyfunction]
fn score<'py>(python: Python<'py>, flight: &PyFlight, plan: &PyPlan) -> PyResult<Bound<'py, PyAny>> {
    let mut flown = flight.0.clone();
    // Behind an abort the position is held for a while.
    flown.samples.truncate(plan.0.knots());
    let score = python.detach(|| score_flight(&plan.0, &flown)).or_raise()?;
    json::to_python(python, &score)
}

/// Adds an experiment to a run folder.
#[pyfunction]
fn add_experiment(python: Python<'_>, run: PathBuf, plan: &PyPlan, flight: &PyFlight) -> PyResult<()> {
    python
        .detach(|| write_experiment(&run, &plan.0, &flight.0, &Vec::new()))
        .or_raise()
}

/// Makes report.html and its figures from a run folder.
#[pyfunction]
fn report(python: Python<'_>, run: PathBuf) -> PyResult<PathBuf> {
    python
        .detach(|| {
            let results = read_results(&run, &mut |_, _| ())?;
            write_report(&run, &results)
        })
        .or_raise()
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(score, module)?)?;
    module.add_function(wrap_pyfunction!(add_experiment, module)?)?;
    module.add_function(wrap_pyfunction!(report, module)?)
}
