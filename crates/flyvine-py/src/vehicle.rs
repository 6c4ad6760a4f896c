//! Vehicles: the simulated one, those in another process, and anybody's Python object.

use std::path::PathBuf;

use flyvine::control::supervisor::Limits;
use flyvine::flight::{Configuration, Pose};
use flyvine::link::exec::{ExecOptions, ExecVehicle};
use flyvine::link::{Observation, Setpoint, Vehicle, VehicleError};
use flyvine::run::{parse_vehicle_file, read_vehicle_file};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::arrays::{self, Vector};
use crate::errors::{OrRaise, wrong};
use crate::json;

/// The simulated vehicle.
#[pyclass(name = "Vehicle", module = "flyvine")]
pub struct PyVehicle {
    /// The vehicle itself.
    pub vehicle: SimulatedVehicle,
    /// The limits within which it is flown.
    pub limits: Limits,
}

/// What a vehicle reports; immutable.
#[pyclass(name = "Observation", module = "flyvine", frozen)]
pub struct PyObservation(Observation);

#[pymethods]
impl PyVehicle {
    #[new]
    #[pyo3(signature = (toml=""))]
    fn new(toml: &str) -> PyResult<Self> {
        let (parameters, limits) = parse_vehicle_file(toml, "vehicle").or_raise()?;
        Self::of(parameters, limits)
    }

    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        let (parameters, limits) = read_vehicle_file(&path).or_raise()?;
        Self::of(parameters, limits)
    }

    /// Its parameters, as in its TOML.
    #[getter]
    fn parameters<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(python, self.vehicle.parameters())
    }

    #[pyo3(signature = (length_m=0.7, pressure_kpa=0.0, seed=1))]
    fn reset(
        &mut self,
        python: Python<'_>,
        length_m: f64,
        pressure_kpa: f64,
        seed: u64,
    ) -> PyResult<PyObservation> {
        let configuration = Configuration {
            length_m,
            pressure_kpa,
        };
        python
            .detach(|| self.vehicle.reset(configuration, seed))
            .map(PyObservation)
            .or_raise()
    }

    #[pyo3(signature = (command, length_m=0.7, pressure_kpa=0.0, *, velocity=None))]
    fn step(
        &mut self,
        python: Python<'_>,
        command: Vector<'_>,
        length_m: f64,
        pressure_kpa: f64,
        velocity: Option<Vector<'_>>,
    ) -> PyResult<PyObservation> {
        let setpoint = Setpoint {
            position: arrays::tuple("command", &command)?,
            velocity: velocity
                .map(|velocity| arrays::tuple("velocity", &velocity))
                .transpose()?,
        };
        let configuration = Configuration {
            length_m,
            pressure_kpa,
        };
        python
            .detach(|| self.vehicle.step(setpoint, configuration))
            .map(PyObservation)
            .or_raise()
    }

    /// The vehicle without noise: quadrotor (7), tip (3), nodes of the arm (links + 1, 3), configuration (2).
    fn truth<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let truth = self.vehicle.truth();
        let result = pyo3::types::PyDict::new(python);
        result.set_item("t_s", truth.t_s)?;
        result.set_item("quadrotor", arrays::vector(python, seven(&truth.quadrotor)))?;
        result.set_item(
            "end_effector",
            arrays::vector(python, truth.end_effector.to_vec()),
        )?;
        result.set_item("nodes", arrays::rows(python, truth.nodes)?)?;
        let Configuration {
            length_m,
            pressure_kpa,
        } = truth.configuration;
        result.set_item(
            "configuration",
            arrays::vector(python, vec![length_m, pressure_kpa]),
        )?;
        Ok(result.into_any())
    }
}

impl PyVehicle {
    fn of(parameters: VehicleParameters, limits: Limits) -> PyResult<Self> {
        Ok(Self {
            vehicle: SimulatedVehicle::new(parameters).or_raise()?,
            limits,
        })
    }
}

/// Position and quaternion of a pose.
fn seven(pose: &Pose) -> Vec<f64> {
    [&pose.position[..], &pose.attitude[..]].concat()
}

#[pymethods]
impl PyObservation {
    #[new]
    #[pyo3(signature = (t_s, quadrotor=None, end_effector=None))]
    fn new(t_s: f64, quadrotor: Option<Vector<'_>>, end_effector: Option<Vector<'_>>) -> PyResult<Self> {
        Ok(Self(Observation {
            t_s,
            quadrotor: pose(quadrotor)?,
            end_effector: end_effector
                .map(|tip| arrays::tuple("end_effector", &tip))
                .transpose()?,
        }))
    }

    #[getter]
    fn t_s(&self) -> f64 {
        self.0.t_s
    }

    /// x, y, z, m, and w, x, y, z of the attitude (7), or None.
    #[getter]
    fn quadrotor<'py>(&self, python: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let pose = self.0.quadrotor.as_ref()?;
        Some(arrays::vector(python, seven(pose)))
    }

    /// x, y, z, m (3), or None.
    #[getter]
    fn end_effector<'py>(&self, python: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        Some(arrays::vector(python, self.0.end_effector?.to_vec()))
    }

    fn __repr__(&self) -> String {
        format!("<flyvine.Observation at {:.3} s>", self.0.t_s)
    }
}

/// A pose from its seven numbers.
pub fn pose(seven: Option<Vector<'_>>) -> PyResult<Option<Pose>> {
    let Some(seven) = seven else { return Ok(None) };
    let [x, y, z, qw, qx, qy, qz] = arrays::tuple("quadrotor", &seven)?;
    Ok(Some(Pose {
        position: [x, y, z],
        attitude: [qw, qx, qy, qz],
    }))
}

/// Any Python object with `reset(length_m, pressure_kpa, seed)` and `step(command, length_m, pressure_kpa)`, each of which
/// returns an [`PyObservation`].
pub struct PythonVehicle {
    object: Py<PyAny>,
    /// What it raised: the flight ends, and then the exception goes on its way.
    pub raised: Option<PyErr>,
}

impl PythonVehicle {
    /// Flies `object`.
    pub fn new(object: Py<PyAny>) -> Self {
        Self { object, raised: None }
    }

    fn observe(
        &mut self,
        call: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<Observation>,
    ) -> Result<Observation, VehicleError> {
        Python::attach(|python| call(self.object.bind(python))).map_err(|error| {
            let what = error.to_string();
            self.raised = Some(error);
            VehicleError::Refused { what }
        })
    }
}

fn observation(answer: Bound<'_, PyAny>) -> PyResult<Observation> {
    match answer.cast::<PyObservation>() {
        Ok(observation) => Ok(observation.get().0),
        Err(_) => Err(wrong(
            "the vehicle's answer",
            answer.get_type(),
            "a flyvine.Observation",
        )),
    }
}

impl Vehicle for PythonVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        self.observe(|object| observation(object.call_method1("reset", (length_m, pressure_kpa, seed))?))
    }

    /// The velocity goes along as the keyword `velocity` where there is one: vehicles that know of none need not.
    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        self.observe(|object| {
            let array = |numbers: [f64; 3]| arrays::vector(object.py(), numbers.to_vec());
            let keywords = pyo3::types::PyDict::new(object.py());
            if let Some(velocity) = setpoint.velocity {
                keywords.set_item("velocity", array(velocity))?;
            }
            let told = (array(setpoint.position), length_m, pressure_kpa);
            observation(object.call_method("step", told, Some(&keywords))?)
        })
    }
}

/// A vehicle in another process, `exec:PROGRAM ARGS`.
pub fn spawn(name: &str) -> PyResult<ExecVehicle> {
    match name.split_once(':') {
        Some(("exec", command_line)) => ExecVehicle::spawn(command_line, ExecOptions::default()).or_raise(),
        _ => Err(wrong(
            "vehicle",
            name,
            "`exec:PROGRAM ARGS`, a Vehicle, or an object with reset and step",
        )),
    }
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyVehicle>()?;
    module.add_class::<PyObservation>()
}
