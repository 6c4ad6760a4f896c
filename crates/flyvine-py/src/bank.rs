//! Identified models.

use std::path::PathBuf;

use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{
    Bank, Extrapolation, Family, FamilyOptions, FitOptions, Model, ScheduledModel, check, fit_families,
};
use flyvine::trajopt::Dynamics;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{self, Matrix, Vector};
use crate::errors::{OrRaise, wrong};
use crate::flight::PyFlight;
use crate::json;

/// Identified models at the flown configurations, and the interpolation between them; immutable.
#[pyclass(name = "Bank", module = "flyvine", frozen)]
pub struct PyBank(pub Bank);

/// One predictor: x⁺ = f(z, u); immutable.
#[pyclass(name = "Model", module = "flyvine", frozen)]
pub struct PyModel {
    model: ScheduledModel,
    rest: Vec<f64>,
    configuration: Configuration,
}

/// Fits the families on flights; returns the bank and the report.
#[pyfunction]
#[pyo3(signature = (flights, family="auto", options=None))]
fn fit<'py>(
    python: Python<'py>,
    flights: Vec<Bound<'py, PyFlight>>,
    family: &str,
    options: Option<&Bound<'py, PyAny>>,
) -> PyResult<(PyBank, Bound<'py, PyAny>)> {
    let families = match family {
        "auto" => vec![Family::Lag, Family::Physical],
        "lag" => vec![Family::Lag],
        "physical" => vec![Family::Physical],
        other => return Err(wrong("family", other, "auto, lag or physical")),
    };
    let options = FamilyOptions {
        families,
        lag: json::from_python::<FitOptions>("options of the lag family", options)?,
        physical: PhysicalFitOptions::default(),
    };
    let flights = owned(&flights);
    let (bank, report) = python
        .detach(|| fit_families(&flights, &options, &mut |_| ()))
        .or_raise()?;
    Ok((PyBank(bank), json::to_python(python, &report)?))
}

fn owned(flights: &[Bound<'_, PyFlight>]) -> Vec<Flight> {
    flights.iter().map(|flight| flight.get().0.clone()).collect()
}

#[pymethods]
impl PyBank {
    #[staticmethod]
    #[pyo3(signature = (path, extrapolate=false))]
    fn read(python: Python<'_>, path: PathBuf, extrapolate: bool) -> PyResult<Self> {
        let extrapolation = if extrapolate {
            Extrapolation::Allow
        } else {
            Extrapolation::Refuse
        };
        let bank = python.detach(|| Bank::read(&path)).or_raise()?;
        Ok(Self(bank.with_extrapolation(extrapolation)))
    }

    fn write(&self, python: Python<'_>, path: PathBuf) -> PyResult<()> {
        python.detach(|| self.0.write(&path)).or_raise()
    }

    /// The configurations of its models (models × 2): length, m, and pressure, kPa.
    fn configurations<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let models = self.0.models().iter();
        let rows = models.map(|model| [model.configuration.length_m, model.configuration.pressure_kpa]);
        arrays::rows(python, rows.collect())
    }

    fn covers(&self, length_m: f64, pressure_kpa: f64) -> bool {
        self.0.covers(Configuration {
            length_m,
            pressure_kpa,
        })
    }

    fn at(&self, length_m: f64, pressure_kpa: f64) -> PyResult<PyModel> {
        PyModel::along(
            &self.0,
            &[Configuration {
                length_m,
                pressure_kpa,
            }],
        )
    }

    /// The time-varying model along configurations (steps × 2).
    fn along(&self, configurations: Matrix<'_>) -> PyResult<PyModel> {
        let rows = arrays::tuples::<2>("configurations", &configurations)?;
        PyModel::along(&self.0, &configurations_of(rows))
    }

    fn check<'py>(
        &self,
        python: Python<'py>,
        flights: Vec<Bound<'py, PyFlight>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let flights = owned(&flights);
        let report = python.detach(|| check(&self.0, &flights)).or_raise()?;
        json::to_python(python, &report)
    }

    /// Everything in the bank, as in its file.
    fn to_dict<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(python, &self.0)
    }

    fn __repr__(&self) -> String {
        let family = match self.0.models()[0].model {
            Model::Lag(_) => Family::Lag,
            Model::Physical(_) => Family::Physical,
        };
        format!("<flyvine.Bank of {} {family} models>", self.0.models().len())
    }
}

/// Configurations from rows of length and pressure.
pub fn configurations_of(rows: Vec<[f64; 2]>) -> Vec<Configuration> {
    rows.into_iter()
        .map(|[length_m, pressure_kpa]| Configuration {
            length_m,
            pressure_kpa,
        })
        .collect()
}

impl PyModel {
    fn along(bank: &Bank, configurations: &[Configuration]) -> PyResult<Self> {
        let model = bank.scheduled(configurations).or_raise()?;
        Ok(Self {
            rest: model.at_knot(0).rest_state(configurations[0]),
            configuration: configurations[0],
            model,
        })
    }
}

#[pymethods]
impl PyModel {
    /// Length n of the state z.
    #[getter]
    fn state_len(&self) -> usize {
        self.model.state_len()
    }

    /// Length m of the command u.
    #[getter]
    fn command_len(&self) -> usize {
        self.model.command_len()
    }

    /// States x that z is made of, the newest first.
    #[getter]
    fn lags(&self) -> usize {
        self.model.at_knot(0).lags()
    }

    /// z at rest, hovering at (0, 0, 1.5) with the arm hanging straight (n).
    fn rest_state<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector(python, self.rest.clone())
    }

    /// z⁺ = f(z, u) at a step (n).
    #[pyo3(signature = (state, command, step=0))]
    fn step<'py>(
        &self,
        python: Python<'py>,
        state: Vector<'py>,
        command: Vector<'py>,
        step: usize,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mut state = arrays::numbers("state", &state, self.state_len())?;
        let command = arrays::numbers("command", &command, self.command_len())?;
        self.advance(step, &mut state, &command);
        Ok(arrays::vector(python, state))
    }

    /// A and B of z⁺ ≈ A z + B u at a step (n × n, n × m).
    #[pyo3(signature = (state, command, step=0))]
    #[allow(clippy::type_complexity)]
    fn jacobian<'py>(
        &self,
        python: Python<'py>,
        state: Vector<'py>,
        command: Vector<'py>,
        step: usize,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
        let (n, m, fresh) = (self.state_len(), self.command_len(), self.model.fresh_len());
        let state = arrays::numbers("state", &state, n)?;
        let command = arrays::numbers("command", &command, m)?;
        let mut jacobian = vec![0.0; fresh * (n + m)];
        self.model.jacobian(step, &state, &command, &mut jacobian);
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n * m]);
        for row in 0..n {
            if row < fresh {
                let from = &jacobian[row * (n + m)..(row + 1) * (n + m)];
                a[row * n..(row + 1) * n].copy_from_slice(&from[..n]);
                b[row * m..(row + 1) * m].copy_from_slice(&from[n..]);
            } else {
                a[row * n + row - fresh] = 1.0; // shifted lags
            }
        }
        Ok((
            arrays::matrix(python, a, [n, n])?,
            arrays::matrix(python, b, [n, m])?,
        ))
    }

    /// The states from `state` on under `commands` (N × m): (N + 1) × n, the first is `state`.
    fn rollout<'py>(
        &self,
        python: Python<'py>,
        state: Vector<'py>,
        commands: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (n, m) = (self.state_len(), self.command_len());
        let mut state = arrays::numbers("state", &state, n)?;
        let commands = commands.as_array();
        if commands.ncols() != m {
            return Err(wrong("commands", format!("{} columns", commands.ncols()), m));
        }
        let steps = commands.nrows();
        let commands: Vec<f64> = commands.iter().copied().collect();
        let states = python.detach(|| {
            let mut states = Vec::with_capacity((steps + 1) * n);
            states.extend_from_slice(&state);
            for (step, command) in commands.chunks_exact(m).enumerate() {
                self.advance(step, &mut state, command);
                states.extend_from_slice(&state);
            }
            states
        });
        arrays::matrix(python, states, [steps + 1, n])
    }

    /// Largest modulus of the eigenvalues of A at rest.
    fn spectral_radius(&self) -> PyResult<f64> {
        self.model
            .at_knot(0)
            .spectral_radius(self.configuration)
            .or_raise()
    }
}

impl PyModel {
    fn advance(&self, step: usize, state: &mut [f64], command: &[f64]) {
        let fresh_len = self.model.fresh_len();
        let mut fresh = vec![0.0; fresh_len];
        self.model.step(step, state, command, &mut fresh);
        state.copy_within(..state.len() - fresh_len, fresh_len);
        state[..fresh_len].copy_from_slice(&fresh);
    }
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyBank>()?;
    module.add_class::<PyModel>()?;
    module.add_function(wrap_pyfunction!(fit, module)?)
}
