//! Cameras as dictionaries and text, in the form of a scene file's `[[rig]]` tables.

use decouplegs::asset::{camera_json, cameras_from_text};
use decouplegs::scene::RigCamera;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::error::value_error;

/// The camera that `description` describes, a dictionary or text of a single one.
pub fn camera_of(description: &Bound<'_, PyAny>) -> PyResult<RigCamera> {
    let text: String = if description.is_instance_of::<PyString>() {
        description.extract()?
    } else if description.is_instance_of::<PyDict>() {
        let json = description.py().import("json")?;
        let text = json.call_method1("dumps", (description,));
        let text = text.map_err(|error| {
            PyTypeError::new_err(format!(
                "description: expected numbers, text, lists and dictionaries ({error}); write arrays as lists with .tolist()"
            ))
        })?;
        text.extract()?
    } else {
        let found = description.get_type().name()?;
        return Err(PyTypeError::new_err(format!(
            "description: expected a dict or a str, found {found}"
        )));
    };
    let cameras =
        cameras_from_text(&text).map_err(|reason| value_error(format!("description: {reason}")))?;
    let count = cameras.len();
    let mut cameras = cameras.into_iter();
    match (cameras.next(), count) {
        (Some(camera), 1) => Ok(camera),
        _ => Err(value_error(format!(
            "description: expected one camera, found {count}: describe each on its own"
        ))),
    }
}

/// The dictionary that describes `camera`.
pub fn to_dict<'py>(py: Python<'py>, camera: &RigCamera) -> PyResult<Bound<'py, PyAny>> {
    let text = camera_json(camera).map_err(value_error)?;
    py.import("json")?.call_method1("loads", (text,))
}
