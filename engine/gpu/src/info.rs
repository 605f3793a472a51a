//! Properties and abilities of a device, without Vulkan types.

use std::{collections::BTreeMap, fmt};

/// Kind of hardware of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceKind {
    /// A card of its own, with its own memory.
    Discrete,
    /// Part of the processor, sharing its memory.
    Integrated,
    /// Handed through by a hypervisor.
    Virtual,
    /// Software on the processor, such as lavapipe.
    Cpu,
    /// The driver does not say.
    Other,
}

/// A device that the loader found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Position in [`crate::Gpu::list`].
    pub index: usize,
    /// The device's own name.
    pub name: String,
    /// The driver's name and version as the driver writes them.
    pub driver: String,
    /// Highest Vulkan version that the device offers: major, minor, patch.
    pub api_version: [u32; 3],
    /// Kind of hardware.
    pub kind: DeviceKind,
    /// UUID of the driver, the same for this device in every process and after every reboot.
    pub uuid: [u8; 16],
    /// Size of the largest device-local heap.
    pub device_memory_bytes: u64,
}

impl fmt::Display for DeviceInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [major, minor, patch] = self.api_version;
        write!(
            f,
            "{} ({}, Vulkan {major}.{minor}.{patch})",
            self.name, self.driver
        )
    }
}

/// The numbers that kernels and capacities are sized by.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Invocations in a subgroup; kernels whose workgroup is a multiple of it along x run with
    /// exactly this size, all lanes active, where the device lets us ask for it.
    pub subgroup_size: u32,
    /// Memory that a workgroup shares.
    pub shared_memory_bytes: u32,
    /// Invocations in a workgroup.
    pub workgroup_threads_max: u32,
    /// Subgroups in a workgroup.
    pub workgroup_subgroups_max: u32,
    /// Largest range of a buffer that a kernel can address; no longer buffer is created.
    pub storage_buffer_bytes_max: u64,
    /// Size of a kernel's push constants.
    pub push_constant_bytes_max: u32,
    /// Workgroups of one dispatch along x, y and z.
    pub dispatch_groups_max: [u32; 3],
    /// Nanoseconds in a tick of the device's clock.
    pub timestamp_period_ns: f32,
    /// Size of the largest device-local heap.
    pub device_memory_bytes: u64,
}

/// Memory in use.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MemoryReport {
    /// Bytes that buffers hold, by the purpose they were made for. Purposes that hold nothing are
    /// left out.
    pub bytes_by_purpose: BTreeMap<&'static str, u64>,
    /// Sum over all purposes, bytes.
    pub total_bytes: u64,
    /// Budget of this process in its device-local heaps, if the driver reports it
    /// (`VK_EXT_memory_budget`).
    pub budget_bytes: Option<u64>,
    /// Use of them by this process as counted by the driver, which includes pipelines and unused
    /// parts of memory blocks.
    pub driver_usage_bytes: Option<u64>,
}
