//! Flights of a plan: one on any vehicle, many on simulated ones.

use std::ops::ControlFlow;
use std::sync::Arc;

use flyvine::control::supervisor::Limits;
use flyvine::control::{
    Controller, End, FlightOutcome, Flying, FlyingError, Proposal, Tick, Trajectory, fly, fly_plan,
};
use flyvine::link::Vehicle;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyString;
use rayon::prelude::*;

use crate::arrays::{self, Matrix, Vector};
use crate::controller::flying;
use crate::errors::{OrRaise, wrong};
use crate::flight::PyFlight;
use crate::json;
use crate::plan::PyPlan;
use crate::vehicle::{PyVehicle, PythonVehicle, spawn};

/// What became of a flight; immutable.
#[pyclass(name = "Outcome", module = "flyvine", frozen)]
pub struct PyOutcome(FlightOutcome);

#[pymethods]
impl PyOutcome {
    /// The recording, whatever the end.
    #[getter]
    fn flight(&self) -> PyFlight {
        PyFlight(self.0.flight.clone())
    }

    /// Whether all knots were flown.
    #[getter]
    fn completed(&self) -> bool {
        matches!(self.0.end, End::Completed)
    }

    /// Why it was cut short, or None.
    #[getter]
    fn cause(&self) -> Option<String> {
        match &self.0.end {
            End::Completed => None,
            End::Aborted { cause, .. } => Some(cause.to_string()),
        }
    }

    /// What the supervisor had to say, in order.
    #[getter]
    fn events(&self) -> Vec<String> {
        self.0.events.iter().map(ToString::to_string).collect()
    }

    /// Wall-clock times of a controller that optimizes, ms (steps).
    #[getter]
    fn step_ms<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector(python, self.0.steps.iter().map(|step| step.step_ms).collect())
    }

    fn __repr__(&self) -> String {
        let end = self.cause().unwrap_or_else(|| "completed".to_owned());
        let rows = self.0.flight.samples.len();
        format!("<flyvine.Outcome {:?}, {rows} rows, {end}>", self.0.flight.name)
    }
}

/// Any Python object with `propose(knot, quadrotor, end_effector, held_command)`, which returns a command or None.
struct PythonController {
    object: Py<PyAny>,
    raised: Option<PyErr>,
}

impl Controller for PythonController {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        let proposal = Python::attach(|python| {
            let pose = tick
                .observation
                .quadrotor
                .map(|pose| arrays::vector(python, [&pose.position[..], &pose.attitude[..]].concat()));
            let tip = tick
                .observation
                .end_effector
                .map(|tip| arrays::vector(python, tip.to_vec()));
            let held = arrays::vector(python, tick.held_command.to_vec());
            let answer = self
                .object
                .bind(python)
                .call_method1("propose", (tick.knot, pose, tip, held))?;
            if answer.is_none() {
                return Ok(Proposal::Late);
            }
            let command: Vector<'_> = answer.extract()?;
            arrays::tuple("the controller's command", &command).map(Proposal::Command)
        });
        proposal.unwrap_or_else(|error: PyErr| {
            self.raised = Some(error);
            Proposal::Failed
        })
    }
}

/// What is flown, and on what.
enum Law {
    Known(Box<Flying>),
    Own(PythonController),
}

enum Craft {
    Simulated(Box<SimulatedVehicle>),
    Process(Box<dyn Vehicle + Send>),
    Own(PythonVehicle),
}

/// Flies a plan; the supervisor owns every command.
#[pyfunction]
#[pyo3(
    name = "fly",
    signature = (plan, vehicle=None, controller=None, *, seed=1, mpc=None, limits=None, step_limit_ms=None, reference=None)
)]
#[allow(clippy::too_many_arguments)] // keywords in Python
fn fly_python(
    python: Python<'_>,
    plan: &PyPlan,
    vehicle: Option<&Bound<'_, PyAny>>,
    controller: Option<&Bound<'_, PyAny>>,
    seed: u64,
    mpc: Option<&Bound<'_, PyAny>>,
    limits: Option<&Bound<'_, PyAny>>,
    step_limit_ms: Option<f64>,
    reference: Option<Matrix<'_>>,
) -> PyResult<PyOutcome> {
    let named = |name: &str| {
        flying(name, mpc, step_limit_ms, reference.as_ref()).map(|flying| Law::Known(Box::new(flying)))
    };
    let mut law = match controller {
        None => named("open-loop")?,
        Some(controller) => match controller.cast::<PyString>() {
            Ok(name) => named(&name.to_cow()?)?,
            Err(_) => Law::Own(PythonController {
                object: controller.clone().unbind(),
                raised: None,
            }),
        },
    };
    let mut own_limits = Limits::default();
    let mut craft = match vehicle {
        None => Craft::Simulated(Box::new(
            SimulatedVehicle::new(VehicleParameters::default()).or_raise()?,
        )),
        Some(vehicle) => {
            if let Ok(simulated) = vehicle.cast::<PyVehicle>() {
                let simulated = simulated.borrow();
                own_limits = simulated.limits;
                Craft::Simulated(Box::new(simulated.vehicle.clone()))
            } else if let Ok(name) = vehicle.cast::<PyString>() {
                Craft::Process(Box::new(spawn(&name.to_cow()?)?))
            } else {
                Craft::Own(PythonVehicle::new(vehicle.clone().unbind()))
            }
        }
    };
    if limits.is_some() {
        own_limits = json::from_python("limits", limits)?;
    }
    let mut interrupted = None;
    let outcome = python.detach(|| {
        let vehicle: &mut dyn Vehicle = match &mut craft {
            Craft::Simulated(vehicle) => vehicle.as_mut(),
            Craft::Process(vehicle) => vehicle.as_mut(),
            Craft::Own(vehicle) => vehicle,
        };
        // Ctrl-C ends a flight as the operator's abort.
        let mut progress = |_, _| match Python::attach(|python| python.check_signals()) {
            Ok(()) => ControlFlow::Continue(()),
            Err(signal) => {
                interrupted = Some(signal);
                ControlFlow::Break(())
            }
        };
        let outcome = match &mut law {
            Law::Known(flying) => fly_plan(&plan.0, flying, own_limits, vehicle, seed, &mut progress),
            Law::Own(controller) => {
                Trajectory::of_plan(&plan.0)
                    .map_err(FlyingError::from)
                    .and_then(|flown| {
                        let mut outcome = fly(&flown, controller, own_limits, vehicle, seed, &mut progress)?;
                        outcome.flight.name.clone_from(&plan.0.task.name);
                        Ok(outcome)
                    })
            }
        };
        // What a vehicle says when it is put away changes nothing about its flight.
        let _ = vehicle.close();
        outcome
    });
    let raised = match (law, craft) {
        (Law::Own(controller), _) if controller.raised.is_some() => controller.raised,
        (_, Craft::Own(vehicle)) => vehicle.raised,
        _ => None,
    };
    match raised.or(interrupted) {
        Some(exception) => Err(exception),
        None => outcome.map(PyOutcome).or_raise(),
    }
}

/// Flies many simulated vehicles on all cores.
#[pyfunction]
#[pyo3(
    name = "fly_many",
    signature = (plan, seeds, vehicles=None, controller="open-loop", *, mpc=None, limits=None)
)]
fn fly_many_python(
    python: Python<'_>,
    plan: &PyPlan,
    seeds: Vec<u64>,
    vehicles: Option<Vec<Bound<'_, PyVehicle>>>,
    controller: &str,
    mpc: Option<&Bound<'_, PyAny>>,
    limits: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<PyOutcome>> {
    let flying = flying(controller, mpc, None, None)?;
    let default = Arc::new(SimulatedVehicle::new(VehicleParameters::default()).or_raise()?);
    let common: Option<Limits> = limits
        .map(|limits| json::from_python("limits", Some(limits)))
        .transpose()?;
    let crafts: Vec<(Arc<SimulatedVehicle>, Limits)> = match &vehicles {
        None => vec![(default, common.unwrap_or_default()); seeds.len()],
        Some(vehicles) if vehicles.len() == seeds.len() => vehicles
            .iter()
            .map(|vehicle| {
                let vehicle = vehicle.borrow();
                (
                    Arc::new(vehicle.vehicle.clone()),
                    common.unwrap_or(vehicle.limits),
                )
            })
            .collect(),
        Some(vehicles) => {
            let expected = format!("{}, one per seed", seeds.len());
            return Err(wrong("vehicles", vehicles.len(), expected));
        }
    };
    let outcomes: Result<Vec<FlightOutcome>, FlyingError> = python.detach(|| {
        (crafts, seeds)
            .into_par_iter()
            .with_max_len(1)
            .map(|((vehicle, limits), seed)| {
                let mut vehicle = SimulatedVehicle::clone(&vehicle);
                fly_plan(&plan.0, &flying, limits, &mut vehicle, seed, &mut |_, _| {
                    ControlFlow::Continue(())
                })
            })
            .collect()
    });
    Ok(outcomes.or_raise()?.into_iter().map(PyOutcome).collect())
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyOutcome>()?;
    module.add_function(wrap_pyfunction!(fly_python, module)?)?;
    module.add_function(wrap_pyfunction!(fly_many_python, module)?)
}
