//! Recordings.

use std::path::PathBuf;

use flyvine::flight::{
    COLUMNS, Flight, HygieneOptions, Mapping, Pose, Sample, VELOCITY_COLUMNS, clean, parse_csv, read_flight,
    recover_flight, write_flight,
};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{self, Vector};
use crate::errors::{OrRaise, wrong};
use crate::json;

/// One recording at 20 Hz; immutable.
#[pyclass(name = "Flight", module = "flyvine", frozen)]
pub struct PyFlight(pub Flight);

#[pymethods]
impl PyFlight {
    #[staticmethod]
    #[pyo3(signature = (path, mapping=None))]
    fn read(python: Python<'_>, path: PathBuf, mapping: Option<PathBuf>) -> PyResult<Self> {
        python.detach(|| {
            let flight = match mapping {
                Some(mapping) => Mapping::read(&mapping).and_then(|mapping| mapping.read_flight(&path)),
                None => read_flight(&path),
            };
            flight.map(Self).or_raise()
        })
    }

    #[staticmethod]
    fn recover(python: Python<'_>, path: PathBuf) -> PyResult<Self> {
        python.detach(|| recover_flight(&path).map(Self).or_raise())
    }

    #[staticmethod]
    #[pyo3(signature = (columns, name="flight"))]
    fn from_arrays(columns: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let column = |name: &str| -> PyResult<Vec<f64>> {
            let values: Vector<'_> = columns.get_item(name)?.extract()?;
            Ok(values.as_array().iter().copied().collect())
        };
        let mut names = COLUMNS.to_vec();
        if columns.contains(VELOCITY_COLUMNS[0])? {
            names.extend(VELOCITY_COLUMNS);
        }
        let table = names
            .iter()
            .map(|name| column(name))
            .collect::<PyResult<Vec<_>>>()?;
        let count = table[0].len();
        for (name, values) in names.iter().zip(&table) {
            if values.len() != count {
                let found = format!("{} rows", values.len());
                return Err(wrong(&format!("column {name}"), found, count));
            }
        }
        // Through the same door as files: numbers written out in full come back to the last bit.
        let mut text = names.join(",");
        for row in 0..count {
            let cells = table.iter().map(|values| match values[row] {
                missing if missing.is_nan() => String::new(),
                value => value.to_string(),
            });
            text.push('\n');
            text += &cells.collect::<Vec<_>>().join(",");
        }
        let flight = parse_csv(name, text.as_bytes()).or_raise()?;
        Ok(Self(Flight {
            name: name.to_owned(),
            ..flight
        }))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    fn __len__(&self) -> usize {
        self.0.samples.len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<flyvine.Flight {:?}, {} rows>",
            self.0.name,
            self.0.samples.len()
        )
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    /// The columns of the CSV format; poses that are missing are NaN.
    fn arrays<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let samples = &self.0.samples;
        let columns = PyDict::new(python);
        for (place, name) in COLUMNS.iter().enumerate() {
            let values = samples.iter().map(|sample| entry(sample, place)).collect();
            columns.set_item(name, arrays::vector(python, values))?;
        }
        if samples.iter().any(|sample| sample.command_velocity.is_some()) {
            for (axis, name) in VELOCITY_COLUMNS.iter().enumerate() {
                let values = samples
                    .iter()
                    .map(|sample| sample.command_velocity.map_or(f64::NAN, |v| v[axis]));
                columns.set_item(name, arrays::vector(python, values.collect()))?;
            }
        }
        Ok(columns)
    }

    /// x (rows × 9), NaN where a pose is missing.
    fn states<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let states = self.0.samples.iter();
        arrays::rows(
            python,
            states
                .map(|sample| sample.state().unwrap_or([f64::NAN; 9]))
                .collect(),
        )
    }

    /// u (rows × 3).
    fn commands<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::rows(
            python,
            self.0.samples.iter().map(|sample| sample.command).collect(),
        )
    }

    #[pyo3(signature = (**options))]
    fn clean<'py>(
        &self,
        python: Python<'py>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<(Self, Bound<'py, PyAny>)> {
        let options: HygieneOptions =
            json::from_python("hygiene options", options.map(|options| options.as_any()))?;
        let mut flight = self.0.clone();
        let report = python.detach(|| clean(&mut flight, &options));
        Ok((Self(flight), json::to_python(python, &report)?))
    }

    fn write(&self, python: Python<'_>, path: PathBuf) -> PyResult<()> {
        python.detach(|| write_flight(&path, &self.0).or_raise())
    }
}

/// One entry of a row, by column.
fn entry(sample: &Sample, column: usize) -> f64 {
    let pose = |value: &dyn Fn(&Pose) -> f64| sample.quadrotor.as_ref().map_or(f64::NAN, value);
    match column {
        0 => sample.t_s,
        1 => sample.configuration.length_m,
        2 => sample.configuration.pressure_kpa,
        3..=5 => sample.command[column - 3],
        6..=8 => pose(&|pose| pose.position[column - 6]),
        9..=12 => pose(&|pose| pose.attitude[column - 9]),
        _ => sample.end_effector.map_or(f64::NAN, |tip| tip[column - 13]),
    }
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyFlight>()
}
