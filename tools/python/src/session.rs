//! Sessions: a device, and what is opened on it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use decouplegs::gpu::{DeviceChoice, DeviceOptions, Gpu};
use decouplegs::render::{ColorFormat, Outputs, Plane, RenderOptions, Storage};
use decouplegs::scene::Rules;
use decouplegs::session::{Session as EngineSession, SessionOptions};
use decouplegs_sharing::Cuda;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::batch_renderer::BatchRenderer;
use crate::device::Device;
use crate::error::{DeviceError, of_gpu, of_interop, of_session, value_error};
use crate::scene::Scene;

/// A device, and the scenes that were opened on it.
///
/// Opens a device: the best, or by number, a part of its name, or ``uuid:...``.
///
/// color: ``u8`` for clamped bytes, ``f32`` for values as blended, not clamped. depth, instance:
/// whether batch renderers draw these layers too (BatchRenderer.draw_layers, Images). exported:
/// whether images are drawn into memory that CUDA shares. None: where that can be; True: or
/// DeviceError. rules: the rules of image formation for all scenes: ``default``, ``gsplat15``,
/// ``gsplat16``, ``inria`` or ``nurec``. None: each scene's own, as its file says. taken_max:
/// frames that may be held on the device by tensors before TooManyHeldError. frames_in_flight:
/// frames of one call that are submitted before the first is waited for.
#[pyclass(frozen, generic, module = "decouplegs")]
pub struct Session {
    pub inner: Arc<EngineSession>,
    /// CUDA context, if images are shared with CUDA.
    cuda: Option<Arc<Cuda>>,
    /// Reason why they are not.
    not_shared: Option<String>,
}

/// Frames whose images are held on the device at most.
const TAKEN_MAX: usize = 65_536;

fn choice_of(device: Option<&Bound<'_, PyAny>>) -> PyResult<DeviceChoice> {
    let Some(device) = device else {
        return Ok(DeviceChoice::Automatic);
    };
    if let Ok(index) = device.extract::<usize>() {
        return Ok(DeviceChoice::Index(index));
    }
    let text: String = device.extract().map_err(|_| {
        value_error(
            "device: expected None, a number of devices(), a part of a name or \"uuid:...\""
                .to_owned(),
        )
    })?;
    Ok(text.parse().unwrap_or_default())
}

fn rules_of(name: &str) -> PyResult<Rules> {
    let message = || {
        value_error(format!(
            "rules: expected None, {}, found {name:?}",
            Rules::NAMES.map(|name| format!("{name:?}")).join(", ")
        ))
    };
    Rules::by_name(name).ok_or_else(message)
}

fn pitch_of(pitch_px: f64) -> PyResult<f64> {
    let is_one = pitch_px.is_finite() && pitch_px >= 0.0;
    is_one.then_some(pitch_px).ok_or_else(|| {
        value_error(format!(
            "background_pitch: expected pixels, 0 or more, found {pitch_px}"
        ))
    })
}

fn storage_of(name: &str) -> PyResult<Storage> {
    let message = || {
        value_error(format!(
            "storage: expected \"exact\" or \"compact\", found {name:?}"
        ))
    };
    Storage::by_name(name).ok_or_else(message)
}

/// CUDA functions on the device of `gpu`, or the reason why there are none.
fn cuda_of(gpu: &Gpu) -> Result<Cuda, String> {
    if !gpu.can_export() {
        return Err(format!(
            "{} cannot export memory and timelines (VK_KHR_external_memory_fd)",
            gpu.info()
        ));
    }
    Cuda::open(gpu.info().uuid).map_err(|error| error.to_string())
}

/// The planes of these names.
fn planes_of(names: &[String]) -> PyResult<Vec<Plane>> {
    let named = names.iter().map(|name| {
        Plane::by_name(name).ok_or_else(|| {
            let names = Plane::ALL.map(Plane::name).join(", ");
            value_error(format!(
                "planes: expected names among {names}, found {name:?}"
            ))
        })
    });
    named.collect()
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (device = None, *, color = "u8", depth = false, instance = false, planes = Vec::new(), flow_interval = 0.1, exported = None, rules = None, storage = "exact", background_pitch = None, taken_max = 16, frames_in_flight = 2, stage_times = false))]
    #[allow(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        py: Python<'_>,
        device: Option<&Bound<'_, PyAny>>,
        color: &str,
        depth: bool,
        instance: bool,
        planes: Vec<String>,
        flow_interval: f64,
        exported: Option<bool>,
        rules: Option<&str>,
        storage: &str,
        background_pitch: Option<f64>,
        taken_max: usize,
        frames_in_flight: usize,
        stage_times: bool,
    ) -> PyResult<Self> {
        let color = match color {
            "u8" => ColorFormat::U8,
            "f32" => ColorFormat::F32,
            _ => {
                return Err(value_error(format!(
                    "color: expected \"u8\" or \"f32\", found {color:?}"
                )));
            }
        };
        if !(1..=TAKEN_MAX).contains(&taken_max) || !(1..=64).contains(&frames_in_flight) {
            return Err(value_error(format!(
                "expected taken_max from 1 to {TAKEN_MAX} and frames_in_flight from 1 to 64, found {taken_max} and {frames_in_flight}"
            )));
        }
        let device = DeviceOptions {
            choice: choice_of(device)?,
            ..DeviceOptions::default()
        };
        let mut options = SessionOptions {
            device,
            ..SessionOptions::default()
        };
        let mut planes = planes_of(&planes)?;
        planes.extend(depth.then_some(Plane::Depth));
        planes.extend(instance.then_some(Plane::Instance));
        if !(flow_interval.is_finite() && flow_interval > 0.0) {
            return Err(value_error(format!(
                "flow_interval: expected seconds above 0, found {flow_interval}"
            )));
        }
        let outputs = Outputs {
            color,
            planes: planes.into_iter().collect(),
            ..Outputs::default()
        };
        let storage = storage_of(storage)?;
        options.rules = rules.map(rules_of).transpose()?;
        options.render = RenderOptions {
            outputs,
            flow_interval_s: flow_interval,
            storage,
            background_pitch_px: background_pitch.map(pitch_of).transpose()?,
            taken_max,
            frames_in_flight,
            stage_times,
            ..options.render
        };
        let opened = py.detach(|| {
            let gpu = Gpu::open(&options.device)?;
            let cuda = if exported == Some(false) {
                Err("exported is False".to_owned())
            } else {
                cuda_of(&gpu)
            };
            Ok((gpu, cuda))
        });
        let (gpu, cuda) = opened.map_err(|error| of_gpu(&error))?;
        let (cuda, not_shared) = match cuda {
            Ok(cuda) => (Some(Arc::new(cuda)), None),
            Err(reason) if exported == Some(true) => {
                return Err(DeviceError::new_err(format!(
                    "images cannot be shared with CUDA: {reason}"
                )));
            }
            Err(reason) => (None, Some(reason)),
        };
        options.render.outputs.exported = cuda.is_some();
        Ok(Self {
            inner: Arc::new(EngineSession::on(&gpu, &options)),
            cuda,
            not_shared,
        })
    }

    /// The device.
    #[getter]
    fn device(&self) -> Device {
        Device::from_info(self.inner.gpu().info())
    }

    /// True if BatchRenderer.draw_dlpack gives CUDA tensors over the renderer's memory, without a
    /// copy.
    #[getter]
    fn exported(&self) -> bool {
        self.cuda.is_some()
    }

    /// Reason why not, if it does not.
    #[getter]
    fn not_exported_because(&self) -> Option<&str> {
        self.not_shared.as_deref()
    }

    /// Storage format of color.
    #[getter]
    fn color(&self) -> &'static str {
        match self.inner.options().render.outputs.color {
            ColorFormat::U8 => "u8",
            ColorFormat::F32 => "f32",
        }
    }

    /// Names of the layers that renderers draw beside color.
    #[getter]
    fn layers(&self) -> Vec<&'static str> {
        let planes = &self.inner.options().render.outputs.planes;
        planes.iter().map(Plane::name).collect()
    }

    /// Frames that tensors may hold at a time.
    #[getter]
    fn taken_max(&self) -> usize {
        self.inner.options().render.taken_max
    }

    /// The scene of a scene file (.toml) or splat file, loaded unless it is loaded already.
    fn open_scene(&self, py: Python<'_>, path: PathBuf) -> PyResult<Scene> {
        let inner = py
            .detach(|| self.inner.open_scene(&path))
            .map_err(|error| of_session(&error))?;
        Ok(Scene { inner })
    }

    /// A renderer of worlds of this session. Its buffers are kept from frame to frame; use one for
    /// each thread that draws.
    fn batch_renderer(&self) -> PyResult<BatchRenderer> {
        BatchRenderer::new(&self.inner, self.cuda.as_ref()).map_err(|error| of_interop(&error))
    }

    /// Bytes on the device by purpose.
    fn memory(&self) -> BTreeMap<String, u64> {
        let report = self.inner.gpu().memory();
        report
            .bytes_by_purpose
            .into_iter()
            .map(|(purpose, bytes)| (purpose.to_owned(), bytes))
            .collect()
    }

    /// Vulkan validation messages since the last call; validation is on with
    /// DECOUPLEGS_VALIDATION=1.
    fn take_validation_messages(&self) -> Vec<String> {
        self.inner.gpu().take_validation_messages()
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// A handle: its copies are itself. Gymnasium copies the arguments of environments.
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self) -> String {
        format!("Session({})", self.inner.gpu().info())
    }
}
