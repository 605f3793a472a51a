//! Devices, as Python sees them.

use decouplegs::gpu::{DeviceChoice, DeviceInfo, DeviceKind, Gpu};
use pyo3::prelude::*;

use crate::error::of_gpu;

/// A Vulkan device.
#[pyclass(frozen, get_all, module = "decouplegs")]
pub struct Device {
    /// Index in devices(), for Session.
    index: usize,
    /// Name of the device.
    name: String,
    /// Name and version of its driver.
    driver: String,
    /// Kind of hardware.
    kind: &'static str,
    /// ``uuid:`` and 32 hexadecimal digits: the same in every process, and CUDA's of the same
    /// device.
    uuid: String,
    /// Size of its largest heap, bytes.
    memory_bytes: u64,
    /// Highest Vulkan version that it offers.
    api_version: (u32, u32, u32),
}

impl Device {
    pub fn from_info(info: &DeviceInfo) -> Self {
        let [major, minor, patch] = info.api_version;
        Self {
            index: info.index,
            name: info.name.clone(),
            driver: info.driver.clone(),
            kind: match info.kind {
                DeviceKind::Discrete => "discrete",
                DeviceKind::Integrated => "integrated",
                DeviceKind::Virtual => "virtual",
                DeviceKind::Cpu => "cpu",
                DeviceKind::Other => "other",
            },
            uuid: DeviceChoice::Uuid(info.uuid).to_string(),
            memory_bytes: info.device_memory_bytes,
            api_version: (major, minor, patch),
        }
    }
}

#[pymethods]
impl Device {
    fn __repr__(&self) -> String {
        format!(
            "Device({}, {:?}, {}, {})",
            self.index, self.name, self.kind, self.uuid
        )
    }
}

/// All Vulkan devices of this machine.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<Vec<Device>> {
    let found = py.detach(Gpu::list).map_err(|error| of_gpu(&error))?;
    Ok(found.iter().map(Device::from_info).collect())
}
