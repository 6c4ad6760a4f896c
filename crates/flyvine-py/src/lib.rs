//! The Python package's native half: newtypes over the library, one file per topic.
//!
//! Arrays go to Python by handing over their memory. Every call that takes longer than a few microseconds releases the
//! interpreter's lock. What the library reports as serializable results arrives as dictionaries.

// The attribute macros of pyo3 expand to fully qualified paths.
#![allow(unused_qualifications)]

mod arrays;
mod bank;
mod controller;
mod errors;
mod flight;
mod fly;
mod json;
mod plan;
mod regression;
mod results;
mod sweep;
mod vehicle;

use pyo3::prelude::*;

#[pymodule]
fn _flyvine(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("DT", flyvine::DT)?;
    module.add("SIGNALS", flyvine::flight::SIGNALS)?;
    errors::register(module)?;
    flight::register(module)?;
    bank::register(module)?;
    regression::register(module)?;
    plan::register(module)?;
    vehicle::register(module)?;
    controller::register(module)?;
    fly::register(module)?;
    results::register(module)?;
    sweep::register(module)
}
