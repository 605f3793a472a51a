//! The Python package `decouplegs`: sessions, scenes, worlds and batch renderers of the engine, in
//! NumPy and DLPack.
//!
//! What Python sees is documented in `decouplegs/_native.pyi`. Each class holds the engine's own
//! object of that name; work on the device is done without the interpreter's lock. `unsafe` is only
//! in `capsule`, where DLPack's structs are handed to C.

mod array;
mod batch_renderer;
mod camera;
mod capsule;
mod description;
mod device;
mod drawing;
mod error;
mod images;
mod lent;
mod lidar;
mod png;
mod pose;
mod rollout;
mod rollout_ego;
mod scene;
mod session;
mod site;
mod statistics;
mod world;

use pyo3::prelude::*;

/// The native part of the package.
#[pymodule]
#[pyo3(name = "_native")]
mod native {
    #[pymodule_export]
    use crate::batch_renderer::BatchRenderer;
    #[pymodule_export]
    use crate::camera::{Camera, RigCamera};
    #[pymodule_export]
    use crate::device::{Device, devices};
    #[pymodule_export]
    use crate::error::{DeviceError, Error, FileError, TooManyHeldError};
    #[pymodule_export]
    use crate::images::{Images, Tensor};
    #[pymodule_export]
    use crate::lidar::Lidar;
    #[pymodule_export]
    use crate::png::save_png;
    #[pymodule_export]
    use crate::rollout::Rollout;
    #[pymodule_export]
    use crate::rollout_ego::RolloutEgo;
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::session::Session;
    #[pymodule_export]
    use crate::site::Site;
    #[pymodule_export]
    use crate::statistics::Statistics;
    #[pymodule_export]
    use crate::world::{Agent, World};

    use super::{Bound, PyModule, PyResult};
    use pyo3::types::PyModuleMethods;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
