//! LiDARs of Python, and their sweeps.

use std::path::PathBuf;
use std::sync::Arc;

use decouplegs::asset::read_lidar;
use decouplegs::scene::lidar::{LidarPoint, PointFrame, ROOF_M, ReturnMode, ReturnOptions};
use decouplegs::scene::{LidarSweep, Motion, Pose, RigLidar};
use glam::DVec3;
use numpy::Element;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::shaped;
use crate::error::{FileError, sentence, value_error};
use crate::pose::{pose_of, to_matrix};

/// A LiDAR fixed to a vehicle.
///
/// sensor: a model that comes with the program, such as ``pandar128``, or a file (.toml, NCore
/// .json). rig_from_lidar, float64 [4, 4], meters, is where it sits on the vehicle; None: on the
/// roof of a car. Frame of the LiDAR: x forward, y left, z up.
#[pyclass(frozen, module = "decouplegs")]
pub struct Lidar {
    pub inner: RigLidar,
}

/// Velocity and turn of a vehicle, as `World.set_motion` takes them.
pub type MotionTuple = ([f64; 3], [f64; 3]);

/// `motion` as Python has it.
pub fn tuple_of(motion: &Motion) -> MotionTuple {
    (
        motion.velocity_mps.to_array(),
        motion.turn_rad_per_s.to_array(),
    )
}

/// The motion of `velocity` and `turn`.
pub fn motion_of((velocity, turn): MotionTuple) -> PyResult<Motion> {
    let motion = Motion {
        velocity_mps: DVec3::from_array(velocity),
        turn_rad_per_s: DVec3::from_array(turn),
    };
    motion.check().map_err(value_error)?;
    Ok(motion)
}

/// Options of the returns of `lidar`.
pub fn options_of(
    lidar: &RigLidar,
    returns: Option<&str>,
    opacity_min: f32,
    seed: u64,
) -> PyResult<ReturnOptions> {
    let mode = match returns {
        None => lidar.model.returns,
        Some(name) => {
            let names = ReturnMode::NAMED.map(|(name, _)| name).join(", ");
            let wrong = || value_error(format!("returns: expected {names}, found {name:?}"));
            ReturnMode::by_name(name).ok_or_else(wrong)?
        }
    };
    if !(0.0..=1.0).contains(&opacity_min) {
        return Err(value_error(format!(
            "opacity_min: expected 0 to 1, found {opacity_min}"
        )));
    }
    Ok(ReturnOptions {
        mode,
        opacity_min,
        seed,
    })
}

/// Points of `sweep` in the frame called `frame`.
pub fn points_of(sweep: &LidarSweep, frame: &str) -> PyResult<Vec<LidarPoint>> {
    let named = PointFrame::by_name(frame, sweep.lidar.model.sweep_s);
    let names = PointFrame::NAMES.join(", ");
    let wrong = || value_error(format!("frame: expected {names}, found {frame:?}"));
    Ok(sweep.points(named.ok_or_else(wrong)?))
}

/// `points` as arrays, one per value.
pub fn to_dict<'py>(py: Python<'py>, points: &[LidarPoint]) -> PyResult<Bound<'py, PyDict>> {
    fn column<'py, T: Element>(
        dict: &Bound<'py, PyDict>,
        name: &str,
        values: impl Iterator<Item = T>,
    ) -> PyResult<()> {
        let values: Vec<T> = values.collect();
        let count = values.len();
        dict.set_item(name, shaped(dict.py(), values, &[count])?)
    }
    let dict = PyDict::new(py);
    let positions = points
        .iter()
        .flat_map(|point| point.position_m.as_vec3().to_array());
    let positions = shaped(py, positions.collect::<Vec<f32>>(), &[points.len(), 3])?;
    dict.set_item("points", positions)?;
    let measured = || points.iter().map(|point| point.measured);
    column(&dict, "range", measured().map(|found| found.range_m))?;
    column(&dict, "intensity", measured().map(|found| found.intensity))?;
    column(&dict, "instance", measured().map(|found| found.instance))?;
    column(&dict, "return_number", measured().map(|found| found.number))?;
    column(&dict, "return_count", measured().map(|found| found.count))?;
    column(&dict, "beam", measured().map(|found| found.beam))?;
    let beams = || points.iter().map(|point| point.beam);
    column(&dict, "ring", beams().map(|beam| beam.ring))?;
    column(&dict, "laser", beams().map(|beam| beam.laser))?;
    column(&dict, "column", beams().map(|beam| beam.column))?;
    column(&dict, "offset_ns", beams().map(|beam| beam.offset_ns()))?;
    Ok(dict)
}

#[pymethods]
impl Lidar {
    #[new]
    #[pyo3(signature = (sensor, rig_from_lidar = None, name = None))]
    fn new(
        sensor: PathBuf,
        rig_from_lidar: Option<&Bound<'_, PyAny>>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let model = read_lidar(&sensor).map_err(|error| FileError::new_err(sentence(&error)))?;
        let rig_from_lidar = match rig_from_lidar {
            Some(pose) => pose_of("rig_from_lidar", pose)?,
            None => Pose {
                translation: ROOF_M,
                ..Pose::IDENTITY
            },
        };
        Ok(Self {
            inner: RigLidar {
                name: name.unwrap_or_else(|| model.name.clone()),
                model: Arc::new(model),
                rig_from_lidar,
            },
        })
    }

    /// Names its sweep.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Name of the model.
    #[getter]
    fn sensor(&self) -> &str {
        &self.inner.model.name
    }

    /// Rows, counted from the highest.
    #[getter]
    fn rings(&self) -> usize {
        self.inner.model.rings()
    }

    /// Columns of a sweep.
    #[getter]
    fn columns(&self) -> usize {
        self.inner.model.columns()
    }

    /// Duration of a sweep, seconds.
    #[getter]
    fn sweep_s(&self) -> f64 {
        self.inner.model.sweep_s
    }

    /// Least and greatest range that it reports, meters.
    #[getter]
    fn range_m(&self) -> (f64, f64) {
        self.inner.model.range_m.into()
    }

    /// Pose on the vehicle, float64 [4, 4], meters.
    #[getter]
    fn rig_from_lidar<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_matrix(py, &self.inner.rig_from_lidar)
    }

    fn __repr__(&self) -> String {
        let model = &self.inner.model;
        format!(
            "Lidar({:?}, {}, {} x {} beams)",
            self.inner.name,
            model.name,
            model.rings(),
            model.columns()
        )
    }
}
