//! The logical device and all that lives as long as it: what buffers, kernels and queues share.

use std::{
    ffi::CStr,
    mem::ManuallyDrop,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use ash::prelude::VkResult;
use ash::{ext, khr, vk};
use gpu_allocator::{
    AllocationSizes, AllocatorDebugSettings,
    vulkan::{Allocator, AllocatorCreateDesc},
};

use crate::{
    DeviceInfo, DeviceKind, DeviceOptions, GpuError, Limits, MemoryReport, QueueUse,
    accounting::Accounting,
    choice,
    device::{self, Abilities, Families, Opened, Physical},
    drill::{Drill, DrillState},
    error::failed,
    export::Exports,
    instance::Instance,
    kernel_cache::PipelineStore,
    trial::{ExecutableProperties, KernelTrial},
};

/// Memory blocks that small buffers share. Larger ones have an allocation of their own (see
/// `memory`), so blocks stay small and what the driver counts stays near what we count.
const DEVICE_BLOCK_BYTES: u64 = 32 << 20;
const HOST_BLOCK_BYTES: u64 = 8 << 20;

/// An open device.
pub(crate) struct Context {
    pub(crate) device: ash::Device,
    pub(crate) push_descriptor: khr::push_descriptor::Device,
    /// Export functions, if the device can export.
    pub(crate) exports: Option<Exports>,
    /// Functions that ask the driver about kernels, if that was wanted and the driver can answer.
    pub(crate) executables: Option<ExecutableProperties>,
    /// Kernels that replace those of the program.
    pub(crate) trial: KernelTrial,
    /// Names and labels, where the instance has them.
    pub(crate) debug: Option<ext::debug_utils::Device>,
    pub(crate) info: DeviceInfo,
    pub(crate) limits: Limits,
    pub(crate) abilities: Abilities,
    pub(crate) families: Families,
    /// Time for which a wait polls before it sleeps.
    pub(crate) poll: Duration,
    /// Dropped by hand, before the device.
    pub(crate) allocator: ManuallyDrop<Mutex<Allocator>>,
    pub(crate) accounting: Mutex<Accounting>,
    pub(crate) pipelines: PipelineStore,
    /// Fault on purpose, if one was asked for.
    pub(crate) drill: Option<DrillState>,
    physical: vk::PhysicalDevice,
    /// Dropped after the device, by field order and our `Drop`.
    instance: Instance,
}

impl Context {
    /// Opens the device that `options` names, or the best that can do the work.
    pub(crate) fn open(options: &DeviceOptions) -> Result<Self, GpuError> {
        let instance = Instance::new(options.validation)?;
        let devices = device::enumerate(&instance)?;
        let infos: Vec<DeviceInfo> = devices.iter().map(|device| device.info.clone()).collect();
        let mut refusal = GpuError::NoDevice;
        for index in choice::candidates(&options.choice, &infos)? {
            match open_physical(&instance, &devices[index], options) {
                Ok((opened, families)) => {
                    return Self::finish(instance, &devices[index], opened, families, options);
                }
                // The best device's reason is the one worth reading.
                Err(error) if matches!(refusal, GpuError::NoDevice) => refusal = error,
                Err(_) => {}
            }
        }
        Err(refusal)
    }

    fn finish(
        instance: Instance,
        physical: &Physical,
        opened: Opened,
        families: Families,
        options: &DeviceOptions,
    ) -> Result<Self, GpuError> {
        let Opened {
            device,
            abilities,
            mut limits,
        } = opened;
        if let Some(Drill::Heap(bytes)) = options.drill {
            limits.device_memory_bytes = limits.device_memory_bytes.min(bytes);
        }
        let mut debug_settings = AllocatorDebugSettings::default();
        debug_settings.log_leaks_on_shutdown = false;
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: device.clone(),
            physical_device: physical.raw,
            debug_settings,
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::new(DEVICE_BLOCK_BYTES, HOST_BLOCK_BYTES),
        });
        let allocator = match allocator {
            Ok(allocator) => allocator,
            Err(error) => {
                // SAFETY: the device was just made and nothing was made from it.
                unsafe { device.destroy_device(None) };
                return Err(GpuError::Driver {
                    call: "preparing the allocator",
                    code: error.to_string(),
                });
            }
        };
        // SAFETY: a query on a device of this instance.
        let properties = unsafe { instance.raw.get_physical_device_properties(physical.raw) };
        Ok(Self {
            push_descriptor: khr::push_descriptor::Device::new(&instance.raw, &device),
            exports: abilities.exports.then(|| Exports::new(&instance, &device)),
            executables: (abilities.kernel_reports)
                .then(|| ExecutableProperties::new(&instance, &device)),
            trial: options.trial.clone(),
            debug: instance
                .labels
                .then(|| ext::debug_utils::Device::new(&instance.raw, &device)),
            info: physical.info.clone(),
            limits,
            abilities,
            families,
            poll: match physical.info.kind {
                DeviceKind::Cpu => Duration::ZERO,
                _ => options.poll,
            },
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            accounting: Mutex::default(),
            drill: options.drill.map(DrillState::new),
            pipelines: PipelineStore::open(&device, &properties, &options.kernels),
            physical: physical.raw,
            device,
            instance,
        })
    }

    /// Result of `call`, a call of the Vulkan function `name`, unless a drill has it fail instead:
    /// then it is not made.
    pub(crate) fn code_of<T>(
        &self,
        name: &'static str,
        call: impl FnOnce() -> VkResult<T>,
    ) -> VkResult<T> {
        let drilled = self.drill.as_ref().and_then(|drill| drill.call(name));
        drilled.map_or_else(call, Err)
    }

    /// [`Context::code_of`], with the code as an error; for calls that can lose the device where no
    /// stage is known.
    pub(crate) fn call<T>(
        &self,
        name: &'static str,
        call: impl FnOnce() -> VkResult<T>,
    ) -> Result<T, GpuError> {
        self.code_of(name, call).map_err(failed(name))
    }

    /// Export functions, or an error with the reason why there are none.
    pub(crate) fn exports(&self) -> Result<&Exports, GpuError> {
        self.exports.as_ref().ok_or_else(|| GpuError::MissingFeature {
            device: self.info.name.clone(),
            feature: "VK_KHR_external_memory_fd and VK_KHR_external_semaphore_fd for buffers and timelines".into(),
            needed_by: "sharing images with another API".into(),
        })
    }

    /// Removes and returns the validation messages since the last call.
    pub(crate) fn take_messages(&self) -> Vec<String> {
        self.instance.take_messages()
    }

    /// Bytes by purpose, and the driver's view where it gives one.
    pub(crate) fn memory_report(&self) -> MemoryReport {
        let mut report = self
            .accounting
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .report();
        if self.abilities.memory_budget {
            let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
            let mut memory = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut budget);
            // SAFETY: a query on this instance's device, which has the extension that the chained
            // structure belongs to.
            unsafe {
                self.instance
                    .raw
                    .get_physical_device_memory_properties2(self.physical, &mut memory);
            };
            let heaps = memory.memory_properties;
            let local = |i: &usize| {
                heaps.memory_heaps[*i]
                    .flags
                    .contains(vk::MemoryHeapFlags::DEVICE_LOCAL)
            };
            let local: Vec<usize> = (0..heaps.memory_heap_count as usize)
                .filter(local)
                .collect();
            report.budget_bytes = Some(local.iter().map(|&i| budget.heap_budget[i]).sum());
            report.driver_usage_bytes = Some(local.iter().map(|&i| budget.heap_usage[i]).sum());
        }
        report
    }

    /// The first device-local type among those in `bits`.
    pub(crate) fn device_local_type(&self, bits: u32) -> Option<u32> {
        // SAFETY: a query on a device of this instance.
        let memory = unsafe {
            self.instance
                .raw
                .get_physical_device_memory_properties(self.physical)
        };
        let local = |index: &u32| {
            let flags = memory.memory_types[*index as usize].property_flags;
            bits >> index & 1 == 1 && flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL)
        };
        (0..memory.memory_type_count).find(local)
    }

    /// Gives `handle` a name in validation messages and debuggers. A name that cannot be given is
    /// no reason to fail.
    pub(crate) fn set_name<H: vk::Handle>(&self, handle: H, name: &str) {
        if let Some(debug) = &self.debug {
            let name = ShortName::new(name);
            let info = vk::DebugUtilsObjectNameInfoEXT::default()
                .object_handle(handle)
                .object_name(name.as_c_str());
            // SAFETY: `handle` is a live object of this device, made a moment ago by the caller and
            // not yet shared.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }
}

fn open_physical(
    instance: &Instance,
    physical: &Physical,
    options: &DeviceOptions,
) -> Result<(Opened, Families), GpuError> {
    let mut families = device::families(instance, physical)?;
    if options.queues == QueueUse::One {
        families.update = None;
    }
    let indices: Vec<u32> = std::iter::once(families.main)
        .chain(families.update)
        .collect();
    Ok((
        device::open(instance, physical, &indices, options.reports_kernels)?,
        families,
    ))
}

impl Drop for Context {
    fn drop(&mut self) {
        // An error here is a device lost: destroying is allowed then too.
        // SAFETY: queues are externally synchronized; every other owner of this context is gone, so
        // no other call can run.
        let _ = unsafe { self.device.device_wait_idle() };
        self.pipelines.close(&self.device);
        // SAFETY: dropped once, here, and not used after.
        unsafe { ManuallyDrop::drop(&mut self.allocator) };
        // SAFETY: everything made from the device holds this context alive, and the allocator has
        // returned its memory.
        unsafe { self.device.destroy_device(None) };
    }
}

/// A name as C wants it, without an allocation: labels are written for every stage of every frame.
/// Longer names are cut.
pub(crate) struct ShortName([u8; 64]);

impl ShortName {
    pub(crate) fn new(name: &str) -> Self {
        let mut bytes = [0; 64];
        for (to, from) in bytes[..63]
            .iter_mut()
            .zip(name.bytes().filter(|&byte| byte != 0))
        {
            *to = from;
        }
        Self(bytes)
    }

    pub(crate) fn as_c_str(&self) -> &CStr {
        CStr::from_bytes_until_nul(&self.0).unwrap_or_default()
    }
}
