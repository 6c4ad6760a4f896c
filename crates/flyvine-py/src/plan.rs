//! Tasks and plans.

use std::path::PathBuf;

use flyvine::file::sha256_hex;
use flyvine::task::{Plan, PlanOptions, Task, make_plan, read_plan, write_plan, write_plan_csv};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::arrays;
use crate::bank::PyBank;
use crate::errors::{FlyvineError, OrRaise};
use crate::json;

/// What the end effector shall do; immutable.
#[pyclass(name = "Task", module = "flyvine", frozen)]
pub struct PyTask {
    task: Task,
    sha256: String,
}

/// The optimized motion for one task on one bank; immutable.
#[pyclass(name = "Plan", module = "flyvine", frozen)]
pub struct PyPlan(pub Plan);

#[pymethods]
impl PyTask {
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        let task = Task::read(&path).or_raise()?;
        let text = std::fs::read(&path)
            .map_err(|error| FlyvineError::new_err(format!("{}: {error}", path.display())))?;
        Ok(Self {
            task,
            sha256: sha256_hex(&text),
        })
    }

    #[staticmethod]
    #[pyo3(signature = (text, name="task"))]
    fn parse(text: &str, name: &str) -> PyResult<Self> {
        let task = Task::parse(text, name).or_raise()?;
        Ok(Self {
            task,
            sha256: sha256_hex(text.as_bytes()),
        })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.task.name
    }

    /// Number of knots N.
    #[getter]
    fn knots(&self) -> usize {
        self.task.knots()
    }

    fn to_dict<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(python, &self.task)
    }

    fn __repr__(&self) -> String {
        format!("<flyvine.Task {:?}>", self.task.name)
    }
}

/// Plans a task on a bank.
#[pyfunction]
#[pyo3(name = "make_plan")]
fn make_plan_python(python: Python<'_>, task: &PyTask, bank: &PyBank) -> PyResult<PyPlan> {
    python.detach(|| {
        let bank_json =
            serde_json::to_vec(&bank.0).map_err(|error| FlyvineError::new_err(error.to_string()))?;
        let options = PlanOptions {
            task_sha256: task.sha256.clone(),
            bank_sha256: sha256_hex(&bank_json),
            ..PlanOptions::default()
        };
        make_plan(&task.task, &bank.0, &options).map(PyPlan).or_raise()
    })
}

#[pymethods]
impl PyPlan {
    #[staticmethod]
    fn read(python: Python<'_>, path: PathBuf) -> PyResult<Self> {
        python.detach(|| read_plan(&path)).map(Self).or_raise()
    }

    fn write(&self, python: Python<'_>, path: PathBuf) -> PyResult<()> {
        python.detach(|| write_plan(&path, &self.0)).or_raise()
    }

    fn write_csv(&self, path: PathBuf) -> PyResult<()> {
        write_plan_csv(&path, &self.0).or_raise()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.task.name
    }

    /// Number of knots N.
    #[getter]
    fn knots(&self) -> usize {
        self.0.knots()
    }

    /// u*_k ((N − 1) × 3), m.
    #[getter]
    fn commands<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::rows(python, self.0.commands.clone())
    }

    /// z*_k (N × n); the first nine entries of each are x.
    #[getter]
    fn states<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [self.0.states.len(), self.0.states[0].len()];
        arrays::matrix(python, self.0.states.concat(), shape)
    }

    /// K_k ((N − 1) × 3 × n): u = u*_k + K_k (z − z*_k).
    #[getter]
    fn gains<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let shape = [self.0.gains.len(), 3, self.0.states[0].len()];
        arrays::stack(python, self.0.gains.concat(), shape)
    }

    /// End-effector reference (N × 3), m.
    #[getter]
    fn reference<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::rows(python, self.0.reference.clone())
    }

    /// Length, m, and pressure, kPa, per knot (N × 2).
    #[getter]
    fn configurations<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let configurations = self.0.configurations.iter();
        let rows = configurations.map(|configuration| [configuration.length_m, configuration.pressure_kpa]);
        arrays::rows(python, rows.collect())
    }

    #[getter]
    fn converged(&self) -> bool {
        self.0.solve.converged
    }

    /// How the solve ended.
    #[getter]
    fn solve<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(python, &self.0.solve)
    }

    /// The bank that it was made on.
    #[getter]
    fn bank(&self) -> PyBank {
        PyBank(self.0.bank.clone())
    }

    fn __repr__(&self) -> String {
        let Plan { task, solve, .. } = &self.0;
        format!(
            "<flyvine.Plan {:?}, {} knots, {}>",
            task.name,
            self.0.knots(),
            solve.status
        )
    }
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyTask>()?;
    module.add_class::<PyPlan>()?;
    module.add_function(wrap_pyfunction!(make_plan_python, module)?)
}
