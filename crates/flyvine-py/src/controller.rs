//! Control laws, step by step, from anybody's own simulator.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use flyvine::control::mpc::MpcOptions;
use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, Controller, Flying, Proposal, Tick, Trajectory, controller};
use flyvine::link::Observation;
use flyvine::model::ScheduledModel;
use flyvine::task::Plan;
use numpy::PyArray1;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use self_cell::self_cell;

use crate::arrays::{self, Matrix, Vector};
use crate::errors::{OrRaise, wrong};
use crate::json;
use crate::plan::PyPlan;
use crate::vehicle::pose;

/// What a controller borrows from.
struct Flown {
    trajectory: Trajectory,
    model: ScheduledModel,
}

type BoxedController<'a> = Box<dyn Controller + Send + 'a>;

self_cell!(
    /// A controller with what it borrows from.
    struct OwningController {
        owner: Flown,
        #[covariant]
        dependent: BoxedController,
    }
);

/// A control law on a plan, stepped by the caller.
#[pyclass(name = "Controller", module = "flyvine", frozen)]
pub struct PyController {
    law: ControlLaw,
    knots: usize,
    controller: Mutex<OwningController>,
}

/// How a plan is to be flown, from a caller's arguments.
pub fn flying(
    law: &str,
    mpc: Option<&Bound<'_, PyAny>>,
    step_limit_ms: Option<f64>,
    reference: Option<&Matrix<'_>>,
) -> PyResult<Flying> {
    let names = ControlLaw::ALL.map(ControlLaw::name).join(", ");
    let law = ControlLaw::from_name(law).ok_or_else(|| wrong("controller", law, names))?;
    let limit = |ms: f64| {
        Duration::try_from_secs_f64(1e-3 * ms)
            .ok()
            .filter(|limit| !limit.is_zero())
            .ok_or_else(|| wrong("step_limit_ms", ms, "a positive number"))
    };
    Ok(Flying {
        law,
        mpc: json::from_python::<MpcOptions>("mpc", mpc)?,
        step_limit: step_limit_ms.map(limit).transpose()?,
        recorded: Vec::new(),
        inconsistency: None,
        reference: reference
            .map(|reference| arrays::tuples("reference", reference))
            .transpose()?,
    })
}

fn build(plan: &Plan, flying: &Flying, limits: &Limits) -> PyResult<OwningController> {
    let owner = Flown {
        trajectory: Trajectory::of_plan(plan).or_raise()?,
        model: plan
            .model()
            .map_err(flyvine::control::FlyingError::from)
            .or_raise()?,
    };
    OwningController::try_new(owner, |flown| {
        controller(plan, &flown.trajectory, &flown.model, flying, limits)
    })
    .or_raise()
}

#[pymethods]
impl PyController {
    #[new]
    #[pyo3(signature = (plan, law="open-loop", *, mpc=None, limits=None, step_limit_ms=None, reference=None))]
    fn new(
        python: Python<'_>,
        plan: &PyPlan,
        law: &str,
        mpc: Option<&Bound<'_, PyAny>>,
        limits: Option<&Bound<'_, PyAny>>,
        step_limit_ms: Option<f64>,
        reference: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let flying = flying(law, mpc, step_limit_ms, reference.as_ref())?;
        let limits: Limits = json::from_python("limits", limits)?;
        Ok(Self {
            law: flying.law,
            knots: plan.0.knots(),
            controller: Mutex::new(python.detach(|| build(&plan.0, &flying, &limits))?),
        })
    }

    /// The control law.
    #[getter]
    fn law(&self) -> &'static str {
        self.law.name()
    }

    /// Commands to propose: one for each knot but the last.
    #[getter]
    fn steps(&self) -> usize {
        self.knots - 1
    }

    /// The command u_k (3), or None if there is none within the tick.
    #[pyo3(signature = (knot, quadrotor, end_effector, held_command))]
    fn step<'py>(
        &self,
        python: Python<'py>,
        knot: usize,
        quadrotor: Option<Vector<'py>>,
        end_effector: Option<Vector<'py>>,
        held_command: Vector<'py>,
    ) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        if knot + 1 >= self.knots {
            return Err(wrong("knot", knot, format!("0 to {}", self.knots - 2)));
        }
        let tick = Tick {
            knot,
            observation: Observation {
                t_s: knot as f64 * flyvine::DT,
                quadrotor: pose(quadrotor)?,
                end_effector: end_effector
                    .map(|tip| arrays::tuple("end_effector", &tip))
                    .transpose()?,
            },
            held_command: arrays::tuple("held_command", &held_command)?,
        };
        require_finite(&tick)?;
        let proposal = python.detach(|| {
            let mut controller = self.controller.lock().unwrap_or_else(PoisonError::into_inner);
            controller.with_dependent_mut(|_, controller| {
                if tick.knot == 0 {
                    controller.prepare(&tick.observation);
                }
                controller.propose(&tick)
            })
        });
        match proposal {
            Proposal::Command(command) => Ok(Some(arrays::vector(python, command.to_vec()))),
            Proposal::Late => Ok(None),
            Proposal::Failed => Err(PyRuntimeError::new_err(format!(
                "the controller has no answer at knot {knot}, and no hope of one"
            ))),
        }
    }

    /// What there is to say about the last step of a controller that optimizes, or None.
    fn report<'py>(&self, python: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let controller = self.controller.lock().unwrap_or_else(PoisonError::into_inner);
        controller
            .borrow_dependent()
            .report()
            .map(|report| json::to_python(python, &report))
            .transpose()
    }

    fn __repr__(&self) -> String {
        format!("<flyvine.Controller {}, {} knots>", self.law.name(), self.knots)
    }
}

/// Refuses what a motion-capture system cannot have seen.
fn require_finite(tick: &Tick) -> PyResult<()> {
    let finite = |what: &str, values: &[f64]| match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(wrong(what, value, "finite numbers, or None")),
        None => Ok(()),
    };
    if let Some(pose) = &tick.observation.quadrotor {
        finite("quadrotor", &pose.position)?;
        finite("quadrotor", &pose.attitude)?;
    }
    if let Some(tip) = &tick.observation.end_effector {
        finite("end_effector", tip)?;
    }
    finite("held_command", &tick.held_command)
}

/// Adds this file's names to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyController>()
}
