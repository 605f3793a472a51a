//! Errors of the engine as exceptions.

use std::error::Error as StdError;

use decouplegs::episode::{EpisodeError, SiteError};
use decouplegs::explain::one_line;
use decouplegs::gpu::GpuError;
use decouplegs::render::RenderError;
use decouplegs::session::SessionError;
use decouplegs_sharing::InteropError;
use pyo3::exceptions::{PyIndexError, PyKeyError, PyRuntimeError, PyValueError};
use pyo3::{PyErr, create_exception};

create_exception!(
    decouplegs,
    Error,
    PyRuntimeError,
    "What the engine could not do. The base of the others."
);
create_exception!(
    decouplegs,
    DeviceError,
    Error,
    "No such device, a device that was lost, or one without the memory or the means."
);
create_exception!(
    decouplegs,
    FileError,
    Error,
    "A file that is missing or wrong; the message names it and what was expected."
);
create_exception!(
    decouplegs,
    TooManyHeldError,
    Error,
    "As many frames are held on the device as `taken_max` allows: drop some tensors."
);

/// An error and what it comes from, in one sentence.
pub fn sentence(error: &(dyn StdError + 'static)) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(error) = source {
        let more = error.to_string();
        // Transparent errors say what their source says.
        if !text.ends_with(&more) {
            text = format!("{text}: {more}");
        }
        source = error.source();
    }
    one_line(&text)
}

pub fn of_gpu(error: &GpuError) -> PyErr {
    DeviceError::new_err(sentence(error))
}

pub fn of_interop(error: &InteropError) -> PyErr {
    DeviceError::new_err(sentence(error))
}

pub fn of_session(error: &SessionError) -> PyErr {
    let text = sentence(error);
    match error {
        SessionError::Gpu(_) => DeviceError::new_err(text),
        SessionError::Asset(_) => FileError::new_err(text),
        SessionError::Render(error) => of_render(error),
        SessionError::NoAgent { .. } => PyKeyError::new_err(text),
        SessionError::NoAsset { .. } => PyIndexError::new_err(text),
        SessionError::PlainSplats { .. }
        | SessionError::TooManyAgents { .. }
        | SessionError::NoCameras
        | SessionError::Image(_)
        | SessionError::OtherSession { .. } => PyValueError::new_err(text),
        _ => Error::new_err(text),
    }
}

pub fn of_render(error: &RenderError) -> PyErr {
    let text = sentence(error);
    match error {
        RenderError::Gpu(_) => DeviceError::new_err(text),
        RenderError::View(_) | RenderError::AgentPose { .. } => PyValueError::new_err(text),
        RenderError::TooManyTaken { .. } => TooManyHeldError::new_err(text),
        _ => Error::new_err(text),
    }
}

pub fn of_site(error: &SiteError) -> PyErr {
    match error {
        SiteError::Asset(_) => FileError::new_err(sentence(error)),
        _ => PyValueError::new_err(sentence(error)),
    }
}

pub fn of_episode(error: &EpisodeError) -> PyErr {
    match error {
        EpisodeError::Render(error) => of_session(error),
        EpisodeError::Unfit { .. } => PyValueError::new_err(sentence(error)),
        EpisodeError::Log(_) => FileError::new_err(sentence(error)),
        EpisodeError::Agents { .. } => PyValueError::new_err(sentence(error)),
    }
}

pub fn value_error(text: impl Into<String>) -> PyErr {
    PyValueError::new_err(text.into())
}
