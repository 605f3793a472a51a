//! Images as PNG files.

use std::path::PathBuf;

use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::error::{of_session, value_error};

/// Writes an image to a PNG file, which is there whole or not at all and replaces one that was
/// there. image: uint8 [H, W, 3] or [H, W, 4], of which red, green and blue are written.
#[pyfunction]
pub fn save_png(py: Python<'_>, path: PathBuf, image: &Bound<'_, PyAny>) -> PyResult<()> {
    let array: PyReadonlyArrayDyn<'_, u8> = image.extract().map_err(|_| {
        let found = image
            .getattr("dtype")
            .map_or_else(|_| image.get_type().to_string(), |dtype| dtype.to_string());
        PyTypeError::new_err(format!(
            "image: expected an array of uint8, found {found}; draw with Session(color=\"u8\")"
        ))
    })?;
    let &[height, width, channels @ (3 | 4)] = array.shape() else {
        return Err(value_error(format!(
            "image: expected an array of shape [H, W, 3] or [H, W, 4], found {:?}; of images [C, H, W, 4] give one",
            array.shape()
        )));
    };
    let side = |pixels: usize| {
        u32::try_from(pixels).map_err(|_| value_error(format!("image: {pixels} pixels a side")))
    };
    let size_px = [side(width)?, side(height)?];
    let values: Vec<u8> = array.as_array().iter().copied().collect();
    let pixels = values.chunks_exact(channels);
    let rgba: Vec<u8> = pixels
        .flat_map(|pixel| [pixel[0], pixel[1], pixel[2], 255])
        .collect();
    py.detach(|| decouplegs::save_png(&path, size_px, &rgba))
        .map_err(|error| of_session(&error))
}
