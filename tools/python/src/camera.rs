//! Cameras of Python.

use decouplegs::scene::photometry::{ColorCurve, Response, Vignetting};
use decouplegs::scene::{
    Camera as EngineCamera, Intrinsics, Photometry, Pose, Rig, RigCamera as EngineRigCamera,
    Shutter, ShutterDirection,
};
use glam::DVec3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{self, matrix, shaped};
use crate::description::{camera_of, to_dict};
use crate::error::value_error;
use crate::lidar::motion_of;
use crate::pose::{pose_of, to_matrix};

/// A camera in the world.
///
/// A camera of ``width`` by ``height`` pixels.
///
/// K: float64 [3, 3], pixels, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``; pixel (i, j) has its
/// center at (i + 0.5, j + 0.5). world_from_camera: float64 [4, 4], meters, OpenCV axes. lens,
/// shutter, photometry, windshield: dictionaries as the tables of these names in a scene file's
/// [[rig]]; None: a pinhole, a global shutter, colors as they are, no windshield.
#[pyclass(frozen, module = "decouplegs")]
pub struct Camera {
    pub inner: EngineCamera,
}

/// `intrinsics` with the parts that are given, each a dictionary in the form of a `[[rig]]` table.
fn with_parts(
    intrinsics: Intrinsics,
    parts: &[(&str, Option<&Bound<'_, PyAny>>)],
    py: Python<'_>,
) -> PyResult<Intrinsics> {
    if parts.iter().all(|(_, part)| part.is_none()) {
        return Ok(intrinsics);
    }
    let description = PyDict::new(py);
    description.set_item("width_px", intrinsics.width_px)?;
    description.set_item("height_px", intrinsics.height_px)?;
    for (key, number) in [
        ("fx_px", intrinsics.fx_px),
        ("fy_px", intrinsics.fy_px),
        ("cx_px", intrinsics.cx_px),
        ("cy_px", intrinsics.cy_px),
    ] {
        description.set_item(key, number)?;
    }
    for (key, part) in parts {
        if let Some(part) = part {
            description.set_item(key, part)?;
        }
    }
    Ok(camera_of(description.as_any())?.intrinsics)
}

/// A camera fixed to a vehicle.
///
/// As Camera; rig_from_camera, float64 [4, 4], meters, is where it sits on the vehicle.
#[pyclass(frozen, module = "decouplegs")]
pub struct RigCamera {
    pub inner: EngineRigCamera,
}

fn intrinsics_of(width_px: u32, height_px: u32, k: &Bound<'_, PyAny>) -> PyResult<Intrinsics> {
    let [[fx_px, skew, cx_px], [zero, fy_px, cy_px], last] = matrix::<3, 3>("K", k)?;
    if skew != 0.0 || zero != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err(value_error(format!(
            "K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found a skew of {skew}, {zero} below it and the last row {last:?}"
        )));
    }
    let intrinsics = Intrinsics::pinhole([width_px, height_px], [fx_px, fy_px], [cx_px, cy_px]);
    intrinsics.check().map_err(value_error)?;
    Ok(intrinsics)
}

fn k_of<'py>(py: Python<'py>, of: &Intrinsics) -> PyResult<Bound<'py, PyAny>> {
    shaped(
        py,
        vec![
            of.fx_px, 0.0, of.cx_px, 0.0, of.fy_px, of.cy_px, 0.0, 0.0, 1.0,
        ],
        &[3, 3],
    )
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width, height, K, world_from_camera, name = String::from("camera"), *, lens = None, shutter = None, photometry = None, windshield = None))]
    #[allow(
        non_snake_case,
        reason = "K is the usual name of the matrix of intrinsics, and arguments are named in Python"
    )]
    #[allow(clippy::too_many_arguments, reason = "most are keywords in Python")]
    fn new(
        width: u32,
        height: u32,
        K: &Bound<'_, PyAny>,
        world_from_camera: &Bound<'_, PyAny>,
        name: String,
        lens: Option<&Bound<'_, PyAny>>,
        shutter: Option<&Bound<'_, PyAny>>,
        photometry: Option<&Bound<'_, PyAny>>,
        windshield: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let world_from_camera = pose_of("world_from_camera", world_from_camera)?;
        let parts = [
            ("lens", lens),
            ("shutter", shutter),
            ("photometry", photometry),
            ("windshield", windshield),
        ];
        let intrinsics = intrinsics_of(width, height, K)?;
        Ok(Self {
            inner: EngineCamera::new(
                name,
                with_parts(intrinsics, &parts, K.py())?,
                world_from_camera,
            ),
        })
    }

    /// The camera that description describes: a dict, or text as JSON or TOML, with the keys of a
    /// scene file's [[rig]] table. position_m, and rotation_wxyz or look, are in the world.
    #[staticmethod]
    fn from_description(description: &Bound<'_, PyAny>) -> PyResult<Self> {
        let camera = camera_of(description)?;
        Ok(Self {
            inner: EngineCamera::new(camera.name, camera.intrinsics, camera.rig_from_camera),
        })
    }

    /// Dictionary of which from_description makes the same camera, at rest.
    #[getter]
    fn description<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let camera = EngineRigCamera {
            name: self.inner.name.clone(),
            intrinsics: self.inner.intrinsics,
            rig_from_camera: self.inner.world_from_camera,
        };
        to_dict(py, &camera)
    }

    /// A pinhole at eye that looks at target, both [3], meters, with up [3] up in the image. size:
    /// (width, height), pixels; fov_deg: horizontal field of view.
    #[staticmethod]
    #[pyo3(signature = (eye, target, up = [0.0, 0.0, 1.0], *, size = (1280, 720), fov_deg = 60.0, name = String::from("camera")))]
    fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        size: (u32, u32),
        fov_deg: f64,
        name: String,
    ) -> PyResult<Self> {
        if !(fov_deg > 0.0 && fov_deg < 180.0) {
            return Err(value_error(format!(
                "fov_deg: expected degrees between 0 and 180, found {fov_deg}"
            )));
        }
        let [from, to, upwards] = [eye, target, up].map(DVec3::from_array);
        let pose = Pose::look_at(from, to, upwards)
            .filter(|pose| from.is_finite() && pose.rotation.is_finite());
        let world_from_camera = pose.ok_or_else(|| {
            value_error(format!(
                "eye {eye:?}, target {target:?}, up {up:?}: expected finite numbers, another target than eye, and up across the view"
            ))
        })?;
        let intrinsics = Intrinsics::from_horizontal_fov(size.0, size.1, fov_deg.to_radians());
        intrinsics.check().map_err(value_error)?;
        Ok(Self {
            inner: EngineCamera::new(name, intrinsics, world_from_camera),
        })
    }

    /// Names its image.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Pixels a row.
    #[getter]
    fn width(&self) -> u32 {
        self.inner.intrinsics.width_px
    }

    /// Number of rows.
    #[getter]
    fn height(&self) -> u32 {
        self.inner.intrinsics.height_px
    }

    /// Intrinsics, float64 [3, 3], pixels.
    #[getter]
    #[pyo3(name = "K")]
    fn k<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        k_of(py, &self.inner.intrinsics)
    }

    /// Pose, float64 [4, 4], meters.
    #[getter]
    fn world_from_camera<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_matrix(py, &self.inner.world_from_camera)
    }

    /// The same camera in motion, with a shutter whose direction is "global", "top_to_bottom",
    /// "bottom_to_top", "left_to_right" or "right_to_left"; start and end are world_from_camera at
    /// the start and at the end of the readout, float64 [4, 4], meters.
    fn with_shutter(
        &self,
        direction: &str,
        readout_s: f64,
        start: &Bound<'_, PyAny>,
        end: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let named = ShutterDirection::from_name(direction).ok_or_else(|| {
            let names = ShutterDirection::ALL.map(ShutterDirection::name).join(", ");
            value_error(format!(
                "direction: expected one of {names}, found {direction:?}"
            ))
        })?;
        if readout_s.is_nan() || readout_s <= 0.0 {
            return Err(value_error(format!(
                "readout_s: expected a number above 0, found {readout_s}"
            )));
        }
        let (start, end) = (pose_of("start", start)?, pose_of("end", end)?);
        let (world_from_camera, motion) = Pose::halfway(&start, &end, readout_s);
        let k = self.inner.intrinsics;
        let shutter = Shutter::new(named, readout_s, [k.width_px, k.height_px]);
        let intrinsics = Intrinsics { shutter, ..k };
        intrinsics.check().map_err(value_error)?;
        Ok(Self {
            inner: EngineCamera {
                name: self.inner.name.clone(),
                intrinsics,
                world_from_camera,
                motion,
            },
        })
    }

    /// The same camera with a photometric calibration, whose stages come in this order: exposure in
    /// stops, with colors that are "display"-referred or "linear"; vignetting, three arrays: center
    /// [2] and radius [2], pixels, and coefficients of r^2, r^4 and r^6 [3, 3], a row per channel;
    /// balance [3, 3], a homography of red, green and the sum of all three; color matrix [3, 4],
    /// rows of three factors and an offset; exponents [3]; response [4, 3]: exponents below and
    /// above the center, exponents of the whole, and the center, each of red, green and blue.
    #[allow(clippy::too_many_arguments, reason = "they are keywords in Python")]
    #[pyo3(signature = (*, exposure_ev = 0.0, curve = "display", vignetting = None, balance = None, matrix = None, gamma = None, response = None))]
    fn with_photometry(
        &self,
        exposure_ev: f64,
        curve: &str,
        vignetting: Option<([f64; 2], [f64; 2], Bound<'_, PyAny>)>,
        balance: Option<&Bound<'_, PyAny>>,
        matrix: Option<&Bound<'_, PyAny>>,
        gamma: Option<[f64; 3]>,
        response: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let identity = Photometry::IDENTITY;
        let photometry = Photometry {
            exposure_ev,
            curve: match curve {
                "display" => ColorCurve::Display,
                "linear" => ColorCurve::Linear,
                other => {
                    return Err(value_error(format!(
                        "curve: expected \"display\" or \"linear\", found {other:?}"
                    )));
                }
            },
            vignetting: match vignetting {
                Some((center_px, radius_px, rgb)) => Some(Vignetting {
                    center_px: [center_px; 3],
                    radius_px,
                    rgb: array::matrix("vignetting", &rgb)?,
                }),
                None => None,
            },
            balance: match balance {
                Some(balance) => Some(array::matrix("balance", balance)?),
                None => None,
            },
            matrix: match matrix {
                Some(matrix) => array::matrix("matrix", matrix)?,
                None => identity.matrix,
            },
            gamma: gamma.unwrap_or(identity.gamma),
            response: match response {
                Some(response) => {
                    let [toe, shoulder, gamma, center] = array::matrix("response", response)?;
                    Some(Response {
                        toe,
                        shoulder,
                        gamma,
                        center,
                    })
                }
                None => None,
            },
        };
        photometry.check().map_err(value_error)?;
        let mut inner = self.inner.clone();
        inner.intrinsics.photometry = photometry;
        Ok(Self { inner })
    }

    fn __repr__(&self) -> String {
        let Intrinsics {
            width_px,
            height_px,
            fx_px,
            ..
        } = self.inner.intrinsics;
        format!(
            "Camera({:?}, {width_px}x{height_px}, fx {fx_px:.1} px)",
            self.inner.name
        )
    }
}

#[pymethods]
impl RigCamera {
    #[new]
    #[pyo3(signature = (name, width, height, K, rig_from_camera))]
    #[allow(non_snake_case, reason = "as in Camera")]
    fn new(
        name: String,
        width: u32,
        height: u32,
        K: &Bound<'_, PyAny>,
        rig_from_camera: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let rig_from_camera = pose_of("rig_from_camera", rig_from_camera)?;
        Ok(Self {
            inner: EngineRigCamera {
                name,
                intrinsics: intrinsics_of(width, height, K)?,
                rig_from_camera,
            },
        })
    }

    /// The camera that description describes: a dict, or text as JSON or TOML, with the keys of a
    /// scene file's [[rig]] table. position_m, and rotation_wxyz or look, are on the vehicle.
    #[staticmethod]
    fn from_description(description: &Bound<'_, PyAny>) -> PyResult<Self> {
        let inner = camera_of(description)?;
        Ok(Self { inner })
    }

    /// Dictionary of which from_description makes the same camera.
    #[getter]
    fn description<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_dict(py, &self.inner)
    }

    /// Names its image.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Pixels a row.
    #[getter]
    fn width(&self) -> u32 {
        self.inner.intrinsics.width_px
    }

    /// Number of rows.
    #[getter]
    fn height(&self) -> u32 {
        self.inner.intrinsics.height_px
    }

    /// Intrinsics, float64 [3, 3], pixels.
    #[getter]
    #[pyo3(name = "K")]
    fn k<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        k_of(py, &self.inner.intrinsics)
    }

    /// Pose on the vehicle, float64 [4, 4], meters.
    #[getter]
    fn rig_from_camera<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_matrix(py, &self.inner.rig_from_camera)
    }

    /// The same view in another number of pixels.
    fn resized(&self, width: u32, height: u32) -> PyResult<Self> {
        let mut inner = self.inner.clone();
        inner.intrinsics = inner.intrinsics.resized(width, height);
        inner.intrinsics.check().map_err(value_error)?;
        Ok(Self { inner })
    }

    /// The camera in the world, of a vehicle that is at world_from_rig, float64 [4, 4], meters. A
    /// rolling shutter sees its motion: velocity, m/s along the axes of the world, and turn, rad/s
    /// about those of the vehicle.
    #[pyo3(signature = (world_from_rig, *, velocity = [0.0; 3], turn = [0.0; 3]))]
    fn at(
        &self,
        world_from_rig: &Bound<'_, PyAny>,
        velocity: [f64; 3],
        turn: [f64; 3],
    ) -> PyResult<Camera> {
        let world_from_rig = pose_of("world_from_rig", world_from_rig)?;
        let motion = motion_of((velocity, turn))?;
        let rig = Rig::from_iter([self.inner.clone()]);
        let inner = rig.moving_at(&world_from_rig, &motion).remove(0);
        Ok(Camera { inner })
    }

    fn __repr__(&self) -> String {
        let Intrinsics {
            width_px,
            height_px,
            fx_px,
            ..
        } = self.inner.intrinsics;
        format!(
            "RigCamera({:?}, {width_px}x{height_px}, fx {fx_px:.1} px)",
            self.inner.name
        )
    }
}
