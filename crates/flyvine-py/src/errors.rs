//! The library's errors as Python exceptions that say the same things.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::{PyErr, create_exception};

create_exception!(
    _flyvine,
    FlyvineError,
    PyValueError,
    "What flyvine refuses: the message names place, what was found and what was expected."
);

/// Declares one exception per error type of the library.
macro_rules! exceptions {
    ($($name:ident, $documentation:literal: $($error:ty),+;)+) => {
        $(create_exception!(_flyvine, $name, FlyvineError, $documentation);)+
        $($(impl Exception for $error {
            fn exception(self) -> PyErr {
                $name::new_err(self.to_string())
            }
        })+)+

        /// Adds the exceptions to the module.
        pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
            let python = module.py();
            module.add("FlyvineError", python.get_type::<FlyvineError>())?;
            $(module.add(stringify!($name), python.get_type::<$name>())?;)+
            Ok(())
        }
    };
}

/// An error of the library that has an exception.
pub trait Exception {
    /// The exception with the error's message.
    fn exception(self) -> PyErr;
}

exceptions! {
    FlightError, "A recording that cannot be read or written.":
        flyvine::flight::FlightError;
    ModelError, "Flights, a model or a bank that cannot be used.":
        flyvine::model::ModelError;
    TaskError, "A task that cannot be posed.":
        flyvine::task::TaskError;
    PlanError, "A plan that cannot be made, read or written.":
        flyvine::task::PlanError;
    VehicleError, "A vehicle that cannot be made, or refuses what it is told.":
        flyvine::sim::ParameterError, flyvine::run::VehicleFileError, flyvine::link::VehicleError,
        flyvine::link::exec::ExecError;
    ControlError, "A plan that cannot be flown with a control law, or within the limits.":
        flyvine::control::FlyingError, flyvine::control::TrajectoryError;
    ScoreError, "A flight that is not one of its plan.":
        flyvine::report::ScoreError;
    RunError, "A run folder that cannot be read or written.":
        flyvine::run::RunError;
    SweepError, "A sweep that cannot be read, run or merged.":
        flyvine_sweep::SweepError;
}

/// `Result`s of the library as Python's.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Exception> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(Exception::exception)
    }
}

/// An argument that is not what it should be.
pub fn wrong(what: &str, found: impl std::fmt::Display, expected: impl std::fmt::Display) -> PyErr {
    FlyvineError::new_err(format!("{what}: found {found}, expected {expected}"))
}
