//! Images of a call, where they were drawn, as tensors that other libraries take.

use std::any::Any;
use std::sync::Arc;

use decouplegs::render::{Plane, PlaneType};
use decouplegs_sharing::Stream;
use pyo3::exceptions::{PyBufferError, PyIndexError};
use pyo3::prelude::*;

use crate::capsule::{DataType, Description, Device};
use crate::drawing::Layers;
use crate::error::{of_interop, value_error};
use crate::lent::{Addresses, CudaHanded, CudaLoan};

/// Owner of the memory.
#[derive(Clone)]
enum Holder {
    Device(Arc<CudaLoan>, i32),
    Host(Arc<Layers>),
}

/// The images of one frame.
#[derive(Clone)]
pub struct Frame {
    holder: Holder,
    addresses: Addresses,
    color: DataType,
    /// First pixel, width and height of each.
    ranges: Arc<[(usize, [u32; 2])]>,
}

impl Frame {
    pub fn on_device(
        loan: Arc<CudaLoan>,
        ordinal: i32,
        addresses: Addresses,
        ranges: Vec<(usize, [u32; 2])>,
    ) -> Self {
        let color = if loan.images().buffers().images_u8.is_empty() {
            DataType::F32
        } else {
            DataType::U8
        };
        Self {
            holder: Holder::Device(loan, ordinal),
            addresses,
            color,
            ranges: ranges.into(),
        }
    }

    /// Images of `sizes_px`, one after the other.
    pub fn on_host(layers: Layers, sizes_px: &[[u32; 2]]) -> Self {
        let mut first = 0;
        let range = |&[width, height]: &[u32; 2]| {
            let range = (first, [width, height]);
            first += width as usize * height as usize;
            range
        };
        let ranges = sizes_px.iter().map(range).collect();
        let (color, address) = layers.color.tensor();
        let mut addresses = Addresses {
            color: address,
            ..Addresses::default()
        };
        for (plane, values) in &layers.planes {
            addresses.planes[*plane as usize] = values.tensor().1;
        }
        Self {
            holder: Holder::Host(Arc::new(layers)),
            addresses,
            color,
            ranges,
        }
    }

    /// Cameras `first` to `first + count`, as one tensor.
    fn tensor(&self, (first, count): (usize, usize), layer: &str) -> PyResult<Tensor> {
        let ranges = &self.ranges[first..first + count];
        let (start, [width, height]) = ranges[0];
        let pixels = width as usize * height as usize;
        let regular = |(index, range): (usize, &(usize, [u32; 2]))| {
            *range == (start + index * pixels, [width, height])
        };
        if !ranges.iter().enumerate().all(regular) {
            return Err(value_error(
                "cameras of several sizes make no one tensor: take camera(view, camera) of each, or draw them as views of their own"
                    .to_owned(),
            ));
        }
        let (address, dtype, channels) = match (layer, Plane::by_name(layer)) {
            ("color", _) => (self.addresses.color, self.color, Some(4)),
            (_, Some(plane)) => {
                let dtype = match plane.value_type() {
                    PlaneType::F32 => DataType::F32,
                    PlaneType::U16 => DataType::I32,
                };
                let channels = (plane.channels() > 1).then_some(plane.channels() as u32);
                (self.addresses.planes[plane as usize], dtype, channels)
            }
            (_, None) => {
                let names = Plane::ALL.map(|plane| format!("{:?}", plane.name()));
                return Err(value_error(format!(
                    "layer: expected \"color\" or {}, found {layer:?}",
                    names.join(" or ")
                )));
            }
        };
        if address == 0 {
            return Err(value_error(format!(
                "the session draws no {layer}: open it with Session(planes=[{layer:?}])"
            )));
        }
        let offset = start as u64 * u64::from(channels.unwrap_or(1_u32)) * dtype.bytes();
        let shape = [count as i64, i64::from(height), i64::from(width)]
            .into_iter()
            .chain(channels.map(i64::from))
            .collect();
        Ok(Tensor {
            holder: self.holder.clone(),
            address: address + offset,
            dtype,
            shape,
        })
    }
}

/// Images of one call.
#[pyclass(frozen, module = "decouplegs")]
pub struct Images {
    frames: Vec<Frame>,
    /// Frame and index in it of each camera, by view.
    views: Vec<Vec<(usize, usize)>>,
}

impl Images {
    /// `frames` hold the cameras of all views in order; `of_views` says how many each view has.
    pub fn new(frames: Vec<Frame>, of_views: Vec<usize>) -> Self {
        let indices = |(number, frame): (usize, &Frame)| {
            (0..frame.ranges.len()).map(move |index| (number, index))
        };
        let mut indices = frames
            .iter()
            .enumerate()
            .flat_map(indices)
            .collect::<Vec<_>>()
            .into_iter();
        let views = of_views
            .into_iter()
            .map(|count| indices.by_ref().take(count).collect())
            .collect();
        Self { frames, views }
    }

    fn of_view(&self, view: usize) -> PyResult<&[(usize, usize)]> {
        let there = self.views.len();
        self.views
            .get(view)
            .map(Vec::as_slice)
            .ok_or_else(|| PyIndexError::new_err(format!("there are {there} views, not {view}")))
    }
}

#[pymethods]
impl Images {
    /// Frames that the call took.
    #[getter]
    fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Views that were drawn.
    #[getter]
    fn views(&self) -> usize {
        self.views.len()
    }

    /// All cameras of a frame: [C, H, W, 4] of color, [C, H, W] of the others. Cameras must be of
    /// one size.
    #[pyo3(signature = (index, layer = "color"))]
    fn frame(&self, index: usize, layer: &str) -> PyResult<Tensor> {
        let there = self.frames.len();
        let frame = self.frames.get(index).ok_or_else(|| {
            PyIndexError::new_err(format!("there are {there} frames, not {index}"))
        })?;
        frame.tensor((0, frame.ranges.len()), layer)
    }

    /// All cameras of a view: [C, H, W, 4] of color, [C, H, W] of the others. Cameras must be of
    /// one size.
    #[pyo3(signature = (index, layer = "color"))]
    fn view(&self, index: usize, layer: &str) -> PyResult<Tensor> {
        let indices = self.of_view(index)?;
        let (frame, first) = indices[0];
        if indices.iter().any(|camera| camera.0 != frame) {
            return Err(value_error(format!(
                "view {index} has more cameras or pixels than a frame can have: take camera({index}, camera) of each"
            )));
        }
        self.frames[frame].tensor((first, indices.len()), layer)
    }

    /// One camera: [H, W, 4] of color, [H, W] of the others.
    #[pyo3(signature = (view, camera, layer = "color"))]
    fn camera(&self, view: usize, camera: usize, layer: &str) -> PyResult<Tensor> {
        let indices = self.of_view(view)?;
        let there = indices.len();
        let &(frame, at) = indices.get(camera).ok_or_else(|| {
            PyIndexError::new_err(format!("view {view} has {there} cameras, not {camera}"))
        })?;
        let mut tensor = self.frames[frame].tensor((at, 1), layer)?;
        tensor.shape.remove(0);
        Ok(tensor)
    }

    /// All cameras of the call, of one frame and one size: [C, H, W, 4].
    fn tensor(&self) -> PyResult<Tensor> {
        if self.frames.len() != 1 {
            return Err(PyBufferError::new_err(format!(
                "these are the images of {} frames, no one tensor: take frame(index) or view(index)",
                self.frames.len()
            )));
        }
        self.frame(0, "color")
            .map_err(|error| PyBufferError::new_err(error.to_string()))
    }

    /// tensor().__dlpack__(...)
    #[pyo3(signature = (*, stream = None, max_version = None, dl_device = None, copy = None))]
    fn __dlpack__(
        &self,
        py: Python<'_>,
        stream: Option<i64>,
        max_version: Option<(u32, u32)>,
        dl_device: Option<(i32, i32)>,
        copy: Option<bool>,
    ) -> PyResult<Py<PyAny>> {
        self.tensor()?
            .__dlpack__(py, stream, max_version, dl_device, copy)
    }

    /// tensor().__dlpack_device__()
    fn __dlpack_device__(&self) -> PyResult<(i32, i32)> {
        Ok(self.tensor()?.__dlpack_device__())
    }

    fn __repr__(&self) -> String {
        format!(
            "Images({} views in {} frames)",
            self.views.len(),
            self.frames.len()
        )
    }
}

/// Images as a tensor.
#[pyclass(frozen, module = "decouplegs")]
pub struct Tensor {
    holder: Holder,
    address: u64,
    dtype: DataType,
    shape: Vec<i64>,
}

impl Tensor {
    fn device(&self) -> Device {
        match &self.holder {
            Holder::Device(_, ordinal) => Device {
                kind: Device::CUDA,
                number: *ordinal,
            },
            Holder::Host(_) => Device {
                kind: Device::CPU,
                number: 0,
            },
        }
    }

    /// Guard that keeps the memory while the consumer has it, and makes its stream wait.
    fn keeper(&self, stream: Option<i64>) -> PyResult<Box<dyn Any + Send>> {
        match &self.holder {
            Holder::Device(loan, _) => {
                let stream = Stream::of_dlpack(stream).map_err(value_error)?;
                let handed: CudaHanded =
                    loan.hand_out(stream).map_err(|error| of_interop(&error))?;
                Ok(Box::new(handed))
            }
            Holder::Host(layers) => Ok(Box::new(layers.clone())),
        }
    }
}

#[pymethods]
impl Tensor {
    /// Sizes of its axes.
    #[getter]
    fn shape(&self) -> Vec<i64> {
        self.shape.clone()
    }

    /// Type, by its name in NumPy.
    #[getter]
    fn dtype(&self) -> &'static str {
        self.dtype.name()
    }

    /// A capsule, read-only as DLPack 1 has it where max_version allows. stream as in the array API
    /// standard.
    #[pyo3(signature = (*, stream = None, max_version = None, dl_device = None, copy = None))]
    fn __dlpack__(
        &self,
        py: Python<'_>,
        stream: Option<i64>,
        max_version: Option<(u32, u32)>,
        dl_device: Option<(i32, i32)>,
        copy: Option<bool>,
    ) -> PyResult<Py<PyAny>> {
        let device = self.device();
        if dl_device.is_some_and(|wanted| wanted != (device.kind, device.number)) {
            return Err(PyBufferError::new_err(
                "the images are not on that device: take them where they are, or use BatchRenderer.draw for arrays on the host",
            ));
        }
        if copy == Some(true) {
            return Err(PyBufferError::new_err(
                "images are handed out where they lie: copy them after taking them",
            ));
        }
        let description = Description {
            address: self.address,
            device,
            dtype: self.dtype,
            shape: self.shape.clone(),
        };
        description.capsule(
            py,
            self.keeper(stream)?,
            max_version.is_some_and(|(major, _)| major >= 1),
        )
    }

    /// (2, number) for CUDA, (1, 0) for the host.
    fn __dlpack_device__(&self) -> (i32, i32) {
        let device = self.device();
        (device.kind, device.number)
    }

    fn __repr__(&self) -> String {
        let memory = if self.device().kind == Device::CUDA {
            "CUDA"
        } else {
            "the host"
        };
        format!(
            "Tensor({:?}, {}, on {memory})",
            self.shape,
            self.dtype.name()
        )
    }
}
