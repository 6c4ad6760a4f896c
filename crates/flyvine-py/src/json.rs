//! Results as dictionaries, options from dictionaries.

use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::errors::FlyvineError;

/// A serializable value as Python's dictionaries, lists, numbers and strings; numbers that are not finite are None.
pub fn to_python<'py>(python: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| FlyvineError::new_err(error.to_string()))?;
    python.import("json")?.call_method1("loads", (text,))
}

/// A value from Python's dictionaries, lists, numbers and strings; what is left out takes its default.
pub fn from_python<T: DeserializeOwned + Default>(
    what: &str,
    value: Option<&Bound<'_, PyAny>>,
) -> PyResult<T> {
    let Some(value) = value.filter(|value| !value.is_none()) else {
        return Ok(T::default());
    };
    let text: String = value
        .py()
        .import("json")?
        .call_method1("dumps", (value,))?
        .extract()?;
    serde_json::from_str(&text).map_err(|error| FlyvineError::new_err(format!("{what}: {error}")))
}
