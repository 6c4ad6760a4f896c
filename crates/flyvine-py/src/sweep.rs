//! Sweeps through the same engine as the command line's: the same rows, the same bytes.

use std::path::PathBuf;

use flyvine_sweep::{Journal, RowResult, Shard, Sweep, collect, journal_rows, merge, run, summarize};
use numpy::PyArray1;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rayon::prelude::*;

use crate::errors::{FlyvineError, OrRaise, wrong};
use crate::json;

/// Flights of plans on many simulated vehicles; immutable. It can be pickled, and carries everything that its rows need.
#[pyclass(name = "Sweep", module = "flyvine", frozen)]
pub struct PySweep(Sweep);

fn json_error(error: serde_json::Error) -> PyErr {
    FlyvineError::new_err(format!("sweep: {error}"))
}

#[pymethods]
impl PySweep {
    /// Reads a sweep's file; its tasks are planned, once, into `folder`/plans.
    #[staticmethod]
    fn read(python: Python<'_>, path: PathBuf, folder: PathBuf) -> PyResult<Self> {
        python
            .detach(|| Sweep::read(&path, &folder.join("plans"), &mut |_| ()))
            .map(Self)
            .or_raise()
    }

    #[staticmethod]
    fn from_bytes(python: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        python
            .detach(|| serde_json::from_slice(bytes))
            .map(Self)
            .map_err(json_error)
    }

    fn to_bytes<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = serde_json::to_vec(&self.0).map_err(json_error)?;
        Ok(PyBytes::new(python, &bytes))
    }

    fn __reduce__<'py>(&self, python: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let constructor = python.get_type::<Self>().getattr("from_bytes")?;
        Ok((constructor, (self.to_bytes(python)?,)))
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    fn __len__(&self) -> usize {
        self.0.rows()
    }

    /// What is flown in a row.
    fn row<'py>(&self, python: Python<'py>, index: usize) -> PyResult<Bound<'py, PyDict>> {
        self.check_index(index)?;
        let row = self.0.row(index);
        let described = PyDict::new(python);
        described.set_item("task", &row.plan.task.name)?;
        described.set_item("plan_sha256", row.plan_sha256)?;
        described.set_item("controller", row.law.name())?;
        described.set_item("seed", row.seed)?;
        for (path, value) in self.0.parameters().into_iter().zip(row.values) {
            described.set_item(path, value)?;
        }
        Ok(described)
    }

    /// Hash of everything that determines a row.
    fn key(&self, index: usize) -> PyResult<String> {
        self.check_index(index)?;
        Ok(self.0.key(index))
    }

    /// Indices of the rows that no journal in `folder` has.
    fn missing<'py>(&self, python: Python<'py>, folder: PathBuf) -> PyResult<Bound<'py, PyArray1<u64>>> {
        let missing = python
            .detach(|| {
                let known = journal_rows(&folder)?;
                let indices = (0..self.0.rows()).into_par_iter();
                Ok(indices
                    .filter(|&index| !known.contains_key(&self.0.key(index)))
                    .map(|index| index as u64)
                    .collect::<Vec<u64>>())
            })
            .map_err(|error: flyvine_sweep::SweepError| crate::errors::Exception::exception(error))?;
        Ok(PyArray1::from_vec(python, missing))
    }

    /// Flies rows, on all cores of this process; (key, result as JSON) each.
    fn compute(&self, python: Python<'_>, indices: Vec<usize>) -> PyResult<Vec<(String, String)>> {
        for &index in &indices {
            self.check_index(index)?;
        }
        python
            .detach(|| {
                let one = |&index: &usize| {
                    let result = serde_json::to_string(&self.0.compute(index))?;
                    Ok((self.0.key(index), result))
                };
                indices
                    .par_iter()
                    .with_max_len(1)
                    .map(one)
                    .collect::<Result<Vec<_>, serde_json::Error>>()
            })
            .map_err(json_error)
    }

    /// Appends computed rows to the journal in `folder`.
    fn keep(&self, python: Python<'_>, folder: PathBuf, rows: Vec<(String, String)>) -> PyResult<()> {
        let rows = rows
            .into_iter()
            .map(|(key, result)| Ok((key, serde_json::from_str::<RowResult>(&result)?)))
            .collect::<Result<Vec<_>, _>>()
            .map_err(json_error)?;
        python
            .detach(|| {
                let journal = Journal::open(&folder, Shard::WHOLE)?;
                rows.iter()
                    .try_for_each(|(key, result)| journal.append(key, result))
            })
            .or_raise()
    }

    /// Computes every row of shard (i, n) that no journal in `folder` has.
    #[pyo3(signature = (folder, shard=(1, 1)))]
    fn run(&self, python: Python<'_>, folder: PathBuf, shard: (usize, usize)) -> PyResult<usize> {
        let (number, of) = shard;
        if !(1..=of).contains(&number) {
            return Err(wrong(
                "shard",
                format!("({number}, {of})"),
                "(i, n) with 1 ≤ i ≤ n",
            ));
        }
        let report = python
            .detach(|| run(&self.0, &folder, Shard { number, of }, &|_| ()))
            .or_raise()?;
        // The rows are kept; an interrupt that came meanwhile is answered now.
        python
            .check_signals()
            .map_err(|_| PyKeyboardInterrupt::new_err("the sweep is complete"))?;
        Ok(report.computed)
    }

    /// Writes `folder`/results.parquet from the journals of `folder` and `others`.
    #[pyo3(signature = (folder, others=Vec::new()))]
    fn merge(&self, python: Python<'_>, folder: PathBuf, others: Vec<PathBuf>) -> PyResult<PathBuf> {
        let folders = [vec![folder.clone()], others].concat();
        python
            .detach(|| merge(&self.0, &folders, &folder).map(|(path, _)| path))
            .or_raise()
    }

    /// Shares of success, quantiles of errors, and the worst flights.
    fn summary<'py>(&self, python: Python<'py>, folder: PathBuf) -> PyResult<Bound<'py, PyAny>> {
        let summary = python
            .detach(|| Ok(summarize(&self.0, &collect(&self.0, &[folder])?)))
            .map_err(|error: flyvine_sweep::SweepError| crate::errors::Exception::exception(error))?;
        json::to_python(python, &summary)
    }

    fn __repr__(&self) -> String {
        format!("<flyvine.Sweep {:?}, {} rows>", self.0.name(), self.0.rows())
    }
}

impl PySweep {
    fn check_index(&self, index: usize) -> PyResult<()> {
        if index < self.0.rows() {
            return Ok(());
        }
        Err(wrong("row", index, format!("less than {}", self.0.rows())))
    }
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PySweep>()
}
