//! Scenes on the device.

use std::path::PathBuf;
use std::sync::Arc;

use decouplegs::session::Scene as EngineScene;
use glam::DVec3;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;

use crate::camera::{Camera, RigCamera};
use crate::error::{of_session, value_error};
use crate::lidar::{Lidar, MotionTuple, tuple_of};
use crate::pose::{pose_of, to_matrix};

/// A scene on the device, which stays there as long as something of it is held.
#[pyclass(frozen, module = "decouplegs")]
pub struct Scene {
    pub inner: Arc<EngineScene>,
}

/// `cameras`, of `size_px` where it is given.
fn sized(
    mut cameras: Vec<decouplegs::scene::Camera>,
    size_px: Option<(u32, u32)>,
) -> PyResult<Vec<Camera>> {
    if let Some((width_px, height_px)) = size_px {
        for camera in &mut cameras {
            camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
            camera.intrinsics.check().map_err(value_error)?;
        }
    }
    Ok(cameras.into_iter().map(|inner| Camera { inner }).collect())
}

fn finite(time_s: f64) -> PyResult<f64> {
    if time_s.is_finite() {
        Ok(time_s)
    } else {
        Err(value_error(format!(
            "time_s: expected a finite number, found {time_s}"
        )))
    }
}

#[pymethods]
impl Scene {
    /// The ego vehicle's cameras; none for a splat file.
    #[getter]
    fn rig(&self) -> Vec<RigCamera> {
        self.inner
            .rig()
            .cameras()
            .map(|camera| RigCamera {
                inner: camera.clone(),
            })
            .collect()
    }

    /// The ego vehicle's LiDARs; none for a splat file.
    #[getter]
    fn lidars(&self) -> Vec<Lidar> {
        let lidars = self.inner.rig().lidars().cloned();
        lidars.map(|inner| Lidar { inner }).collect()
    }

    /// Motion of the ego vehicle from the scene file: velocity, m/s along the axes of the world,
    /// and turn, rad/s about those of the vehicle.
    fn ego_motion(&self, time_s: f64) -> PyResult<MotionTuple> {
        Ok(tuple_of(&self.inner.ego().motion_at(finite(time_s)?)))
    }

    /// Pose of the ego vehicle from the scene file, world_from_rig, float64 [4, 4], meters.
    fn ego_pose<'py>(&self, py: Python<'py>, time_s: f64) -> PyResult<Bound<'py, PyAny>> {
        to_matrix(py, &self.inner.ego().at(finite(time_s)?))
    }

    /// First and last time of the ego's trajectory, seconds.
    #[getter]
    fn ego_span_s(&self) -> (f64, f64) {
        (self.inner.ego().start_s(), self.inner.ego().end_s())
    }

    /// The rig where the ego is at time_s, in images of ``size`` = (width, height) pixels where it
    /// is given.
    #[pyo3(signature = (time_s = 0.0, size = None))]
    fn cameras(&self, time_s: f64, size: Option<(u32, u32)>) -> PyResult<Vec<Camera>> {
        let ego = self.inner.ego();
        sized(self.inner.rig().driving(ego, finite(time_s)?), size)
    }

    /// The rig on a vehicle that stands at world_from_rig, float64 [4, 4], meters.
    #[pyo3(signature = (world_from_rig, size = None))]
    fn cameras_at(
        &self,
        world_from_rig: &Bound<'_, PyAny>,
        size: Option<(u32, u32)>,
    ) -> PyResult<Vec<Camera>> {
        let pose = pose_of("world_from_rig", world_from_rig)?;
        sized(self.inner.rig().at(&pose), size)
    }

    /// A camera that shows all splats of a splat file: the middle 90 % of them on each axis. size:
    /// (width, height), pixels. It stands towards direction [3], with up [3] up in the image; None:
    /// as ``decouplegs render`` has it, with -y up for splat files.
    #[pyo3(signature = (size = (1280, 720), *, direction = None, up = None))]
    fn frame(
        &self,
        size: (u32, u32),
        direction: Option<[f64; 3]>,
        up: Option<[f64; 3]>,
    ) -> PyResult<Camera> {
        let [towards, upwards] = [direction, up].map(|axis| axis.map(DVec3::from_array));
        let framed = self.inner.frame([size.0, size.1], towards, upwards);
        let inner = framed.ok_or_else(|| {
            value_error(format!(
                "nothing is framed: expected a splat file without cameras of its own, a size above 0 and a direction across up, found {} cameras, size {size:?}, direction {direction:?} and up {up:?}",
                self.inner.rig().cameras().count()
            ))
        })?;
        Ok(Camera { inner })
    }

    /// Agents of the scene file that can be moved, with which a World begins.
    #[getter]
    fn agents(&self) -> Vec<String> {
        self.inner
            .agents()
            .iter()
            .map(|agent| agent.name.clone())
            .collect()
    }

    /// Agents of plain splats, which are part of the background.
    #[getter]
    fn plain_agents(&self) -> Vec<String> {
        self.inner.plain_agents().to_vec()
    }

    /// Pose of an agent from the scene file, world_from_agent, float64 [4, 4], meters.
    fn agent_pose<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        time_s: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let agent = self.inner.agents().iter().find(|agent| agent.name == name);
        let agent = agent.ok_or_else(|| {
            PyKeyError::new_err(format!("the scene has no agent {name:?} that can be moved"))
        })?;
        to_matrix(py, &agent.trajectory.at(finite(time_s)?))
    }

    /// Assets that agents may show, counted from 0.
    #[getter]
    fn asset_count(&self) -> usize {
        self.inner.asset_count()
    }

    /// Length, width and height of an asset, meters. Its origin is the center of its box.
    fn asset_size(&self, asset: usize) -> PyResult<(f32, f32, f32)> {
        self.inner
            .asset_dims_m(asset)
            .map(Into::into)
            .map_err(|error| of_session(&error))
    }

    /// Copies another compressed asset (.safetensors) to the device, for all worlds over this
    /// scene; its number.
    fn add_asset(&self, py: Python<'_>, path: PathBuf) -> PyResult<usize> {
        py.detach(|| self.inner.add_asset(&path))
            .map_err(|error| of_session(&error))
    }

    /// Splats of the background.
    #[getter]
    fn background_splats(&self) -> usize {
        self.inner.background_splats()
    }

    fn __repr__(&self) -> String {
        let (splats, agents) = (self.inner.background_splats(), self.inner.agents().len());
        format!(
            "Scene({splats} splats, {agents} agents, {} cameras)",
            self.inner.rig().cameras().count()
        )
    }
}
