//! Arrays to and from NumPy.

use numpy::{
    AllowTypeChange, Element, PyArray1, PyArrayLikeDyn, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::capsule::DataType;
use crate::error::value_error;

/// Numbers of some type.
pub enum Values {
    U8(Vec<u8>),
    F32(Vec<f32>),
    I32(Vec<i32>),
}

impl Values {
    /// Type of the numbers, as DLPack knows it, and the address of the first.
    pub fn tensor(&self) -> (DataType, u64) {
        let (data_type, address) = match self {
            Self::U8(values) => (DataType::U8, values.as_ptr().expose_provenance()),
            Self::F32(values) => (DataType::F32, values.as_ptr().expose_provenance()),
            Self::I32(values) => (DataType::I32, values.as_ptr().expose_provenance()),
        };
        (data_type, address as u64)
    }
}

/// `values` as an array of `shape`, without a copy.
pub fn to_numpy<'py>(
    py: Python<'py>,
    values: Values,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    match values {
        Values::U8(values) => shaped(py, values, shape),
        Values::F32(values) => shaped(py, values, shape),
        Values::I32(values) => shaped(py, values, shape),
    }
}

/// `values` as an array of `shape`, without a copy.
pub fn shaped<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values)
        .reshape(shape.to_vec())?
        .into_any())
}

/// `R` by `C` finite numbers of anything that NumPy makes an array of. `what` it is, in errors.
pub fn matrix<const R: usize, const C: usize>(
    what: &str,
    value: &Bound<'_, PyAny>,
) -> PyResult<[[f64; C]; R]> {
    let array = numbers(what, value)?;
    if array.shape() != [R, C] {
        return Err(value_error(format!(
            "{what}: expected an array of shape [{R}, {C}], found {:?}",
            array.shape()
        )));
    }
    let view = array.as_array();
    let mut matrix = [[0.0; C]; R];
    for (r, row) in matrix.iter_mut().enumerate() {
        for (c, number) in row.iter_mut().enumerate() {
            *number = view[[r, c]];
        }
    }
    match matrix.iter().flatten().find(|number| !number.is_finite()) {
        Some(number) => Err(value_error(format!(
            "{what}: expected finite numbers, found {number}"
        ))),
        None => Ok(matrix),
    }
}

/// Rows of `C` finite numbers.
pub fn rows<const C: usize>(what: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; C]>> {
    let array = numbers(what, value)?;
    if array.shape().len() != 2 || array.shape()[1] != C {
        return Err(value_error(format!(
            "{what}: expected an array of shape [N, {C}], found {:?}",
            array.shape()
        )));
    }
    let view = array.as_array();
    Ok((0..array.shape()[0])
        .map(|row| std::array::from_fn(|column| view[[row, column]]))
        .collect())
}

fn numbers<'py>(
    what: &str,
    value: &Bound<'py, PyAny>,
) -> PyResult<PyArrayLikeDyn<'py, f64, AllowTypeChange>> {
    value.extract().map_err(|error: PyErr| {
        PyTypeError::new_err(format!("{what}: expected an array of numbers ({error})"))
    })
}
