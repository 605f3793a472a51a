//! Memory and timelines that another API on the same device may import: CUDA, and through it
//! PyTorch, without a copy.
//!
//! Linux only, by opaque file descriptors (`VK_KHR_external_memory_fd`,
//! `VK_KHR_external_semaphore_fd`). An importer finds the device by its UUID
//! ([`crate::DeviceInfo::uuid`]), imports the memory as dedicated and of the size in
//! [`ExportedMemory`], and waits on the timeline for the value of a [`crate::Ticket`] before it
//! reads.

use std::os::fd::{FromRawFd, OwnedFd};

use ash::{khr, vk};

use crate::{GpuError, error::failed, instance::Instance};

/// The kind of handle that is exported.
const MEMORY_HANDLE: vk::ExternalMemoryHandleTypeFlags =
    vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD;
const SEMAPHORE_HANDLE: vk::ExternalSemaphoreHandleTypeFlags =
    vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD;

/// The memory of a buffer for another API. The descriptor belongs to the holder of this value, and
/// goes to the importer with it.
#[derive(Debug)]
pub struct ExportedMemory {
    /// An opaque descriptor of the memory.
    pub descriptor: OwnedFd,
    /// Allocated size, at least the buffer's length: the importer needs it.
    pub allocation_bytes: u64,
}

/// Functions for exporting, if the device has them.
pub(crate) struct Exports {
    memory: khr::external_memory_fd::Device,
    semaphore: khr::external_semaphore_fd::Device,
}

impl Exports {
    pub(crate) fn new(instance: &Instance, device: &ash::Device) -> Self {
        Self {
            memory: khr::external_memory_fd::Device::new(&instance.raw, device),
            semaphore: khr::external_semaphore_fd::Device::new(&instance.raw, device),
        }
    }

    /// Descriptor of `memory`, which was allocated with [`memory_info`].
    pub(crate) fn memory_descriptor(&self, memory: vk::DeviceMemory) -> Result<OwnedFd, GpuError> {
        let get = vk::MemoryGetFdInfoKHR::default()
            .memory(memory)
            .handle_type(MEMORY_HANDLE);
        // SAFETY: the memory was allocated to be exported as this type.
        let descriptor =
            unsafe { self.memory.get_memory_fd(&get) }.map_err(failed("vkGetMemoryFdKHR"))?;
        // SAFETY: the call gives away a descriptor that nobody else owns.
        Ok(unsafe { OwnedFd::from_raw_fd(descriptor) })
    }

    /// Descriptor of `semaphore`, which was made with [`semaphore_info`].
    pub(crate) fn semaphore_descriptor(
        &self,
        semaphore: vk::Semaphore,
    ) -> Result<OwnedFd, GpuError> {
        let get = vk::SemaphoreGetFdInfoKHR::default()
            .semaphore(semaphore)
            .handle_type(SEMAPHORE_HANDLE);
        // SAFETY: the semaphore was made to be exported as this type.
        let descriptor = unsafe { self.semaphore.get_semaphore_fd(&get) }
            .map_err(failed("vkGetSemaphoreFdKHR"))?;
        // SAFETY: the call gives away a descriptor that nobody else owns.
        Ok(unsafe { OwnedFd::from_raw_fd(descriptor) })
    }
}

/// True if storage buffers and timeline semaphores of `physical` can be exported; it has the
/// extensions.
pub(crate) fn is_possible(instance: &Instance, physical: vk::PhysicalDevice) -> bool {
    let buffer = vk::PhysicalDeviceExternalBufferInfo::default()
        .usage(vk::BufferUsageFlags::STORAGE_BUFFER)
        .handle_type(MEMORY_HANDLE);
    let mut buffer_found = vk::ExternalBufferProperties::default();
    let mut timeline =
        vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
    let semaphore = vk::PhysicalDeviceExternalSemaphoreInfo::default()
        .handle_type(SEMAPHORE_HANDLE)
        .push_next(&mut timeline);
    let mut semaphore_found = vk::ExternalSemaphoreProperties::default();
    // SAFETY: queries on a device of this instance, of Vulkan 1.1.
    unsafe {
        instance.raw.get_physical_device_external_buffer_properties(
            physical,
            &buffer,
            &mut buffer_found,
        );
        instance
            .raw
            .get_physical_device_external_semaphore_properties(
                physical,
                &semaphore,
                &mut semaphore_found,
            );
    }
    let memory = buffer_found
        .external_memory_properties
        .external_memory_features;
    memory.contains(vk::ExternalMemoryFeatureFlags::EXPORTABLE)
        && semaphore_found
            .external_semaphore_features
            .contains(vk::ExternalSemaphoreFeatureFlags::EXPORTABLE)
}

/// Says, chained to the creation of a buffer, that its memory will be exported.
pub(crate) fn buffer_info() -> vk::ExternalMemoryBufferCreateInfo<'static> {
    vk::ExternalMemoryBufferCreateInfo::default().handle_types(MEMORY_HANDLE)
}

/// Says, chained to an allocation, that the memory will be exported.
pub(crate) fn memory_info() -> vk::ExportMemoryAllocateInfo<'static> {
    vk::ExportMemoryAllocateInfo::default().handle_types(MEMORY_HANDLE)
}

/// Says, chained to the creation of a semaphore, that it will be exported.
pub(crate) fn semaphore_info() -> vk::ExportSemaphoreCreateInfo<'static> {
    vk::ExportSemaphoreCreateInfo::default().handle_types(SEMAPHORE_HANDLE)
}
