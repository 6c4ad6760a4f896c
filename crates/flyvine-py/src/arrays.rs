//! Arrays between Rust and numpy. What goes to Python is handed over, not copied; what comes from Python is read in place
//! where it is a contiguous array of float64, and converted where it is not.

use numpy::{
    AllowTypeChange, PyArray, PyArray1, PyArray2, PyArray3, PyArrayLike1, PyArrayLike2, PyArrayMethods,
};
use pyo3::prelude::*;

use crate::errors::wrong;

/// A vector or list of numbers.
pub type Vector<'py> = PyArrayLike1<'py, f64, AllowTypeChange>;
/// A matrix or list of rows.
pub type Matrix<'py> = PyArrayLike2<'py, f64, AllowTypeChange>;

/// Numbers as an array (n).
pub fn vector(python: Python<'_>, values: Vec<f64>) -> Bound<'_, PyArray1<f64>> {
    PyArray::from_vec(python, values)
}

/// Rows of a fixed length as an array (n × N).
pub fn rows<const N: usize>(python: Python<'_>, values: Vec<[f64; N]>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let shape = [values.len(), N];
    PyArray::from_vec(python, values.into_flattened()).reshape(shape)
}

/// Numbers, row-major, as an array (rows × columns).
pub fn matrix(python: Python<'_>, values: Vec<f64>, shape: [usize; 2]) -> PyResult<Bound<'_, PyArray2<f64>>> {
    PyArray::from_vec(python, values).reshape(shape)
}

/// Numbers, row-major, as an array of matrices.
pub fn stack(python: Python<'_>, values: Vec<f64>, shape: [usize; 3]) -> PyResult<Bound<'_, PyArray3<f64>>> {
    PyArray::from_vec(python, values).reshape(shape)
}

/// The numbers of a vector of `length`.
pub fn numbers(what: &str, array: &Vector<'_>, length: usize) -> PyResult<Vec<f64>> {
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    if values.len() == length {
        Ok(values)
    } else {
        Err(wrong(what, format!("{} numbers", values.len()), length))
    }
}

/// The N numbers of a vector.
pub fn tuple<const N: usize>(what: &str, array: &Vector<'_>) -> PyResult<[f64; N]> {
    let array = array.as_array();
    if array.len() != N {
        return Err(wrong(what, format!("{} numbers", array.len()), N));
    }
    Ok(std::array::from_fn(|i| array[i]))
}

/// The rows of a matrix with N columns.
pub fn tuples<const N: usize>(what: &str, array: &Matrix<'_>) -> PyResult<Vec<[f64; N]>> {
    let array = array.as_array();
    if array.ncols() != N {
        let found = format!("{} columns", array.ncols());
        return Err(wrong(what, found, N));
    }
    Ok(array
        .outer_iter()
        .map(|row| std::array::from_fn(|i| row[i]))
        .collect())
}
