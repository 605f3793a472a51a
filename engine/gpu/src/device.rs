//! Physical devices: what they are, what they can do, and the logical device with just the features
//! that we use.

use std::{
    ffi::{CStr, c_char},
    ptr::null_mut,
};

use ash::{ext, khr, vk};

use crate::{DeviceInfo, DeviceKind, GpuError, Limits, error::failed, export, instance::Instance};

/// Bindings of a kernel; what push descriptors hold on every device seen.
pub(crate) const BINDINGS_MAX: usize = 32;

/// A physical device, with what was asked about it.
pub(crate) struct Physical {
    pub(crate) raw: vk::PhysicalDevice,
    pub(crate) info: DeviceInfo,
}

/// All devices in the loader's order.
pub(crate) fn enumerate(instance: &Instance) -> Result<Vec<Physical>, GpuError> {
    // SAFETY: a query on a live instance.
    let devices = match unsafe { instance.raw.enumerate_physical_devices() } {
        // Drivers are installed and none of them finds its hardware.
        Err(vk::Result::ERROR_INITIALIZATION_FAILED) => Vec::new(),
        devices => devices.map_err(failed("vkEnumeratePhysicalDevices"))?,
    };
    Ok(devices
        .into_iter()
        .enumerate()
        .map(|(index, raw)| Physical {
            raw,
            info: describe(instance, raw, index),
        })
        .collect())
}

fn describe(instance: &Instance, device: vk::PhysicalDevice, index: usize) -> DeviceInfo {
    let mut id = vk::PhysicalDeviceIDProperties::default();
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut id)
        .push_next(&mut driver);
    // SAFETY: `device` comes from this instance, and the chained structures are of Vulkan 1.2,
    // which the instance asked for; an older driver leaves them zero.
    unsafe {
        instance
            .raw
            .get_physical_device_properties2(device, &mut properties);
    };
    let base = properties.properties;
    let version = base.api_version;
    DeviceInfo {
        index,
        name: text(base.device_name_as_c_str()),
        driver: format!(
            "{} {}",
            text(driver.driver_name_as_c_str()),
            text(driver.driver_info_as_c_str())
        )
        .trim()
        .to_owned(),
        api_version: [
            vk::api_version_major(version),
            vk::api_version_minor(version),
            vk::api_version_patch(version),
        ],
        kind: match base.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
            vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
            vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
            vk::PhysicalDeviceType::CPU => DeviceKind::Cpu,
            _ => DeviceKind::Other,
        },
        uuid: id.device_uuid,
        device_memory_bytes: largest_device_heap_bytes(instance, device),
    }
}

fn text<E>(name: Result<&CStr, E>) -> String {
    name.map_or_else(
        |_| String::new(),
        |name| name.to_string_lossy().into_owned(),
    )
}

fn largest_device_heap_bytes(instance: &Instance, device: vk::PhysicalDevice) -> u64 {
    // SAFETY: a query on a device of this instance.
    let memory = unsafe { instance.raw.get_physical_device_memory_properties(device) };
    let heaps = memory.memory_heaps_as_slice().iter();
    heaps
        .filter(|heap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
        .map(|heap| heap.size)
        .max()
        .unwrap_or(0)
}

/// Queue family of each role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Families {
    pub(crate) main: u32,
    /// A family that computes and does not draw, other than `main`.
    pub(crate) update: Option<u32>,
    /// Meaningful bits of a timestamp in either.
    pub(crate) main_timestamp_bits: u32,
    pub(crate) update_timestamp_bits: u32,
}

pub(crate) fn families(instance: &Instance, physical: &Physical) -> Result<Families, GpuError> {
    // SAFETY: a query on a device of this instance.
    let families = unsafe {
        instance
            .raw
            .get_physical_device_queue_family_properties(physical.raw)
    };
    choose_families(&families).ok_or_else(|| missing(physical, "a queue family that computes"))
}

fn choose_families(families: &[vk::QueueFamilyProperties]) -> Option<Families> {
    use vk::QueueFlags as Flags;
    let position = |wanted: &dyn Fn(Flags) -> bool| {
        families
            .iter()
            .position(|family| wanted(family.queue_flags))
    };
    let main = position(&|flags| flags.contains(Flags::GRAPHICS | Flags::COMPUTE))
        .or_else(|| position(&|flags| flags.contains(Flags::COMPUTE)))?;
    let update =
        position(&|flags| flags.contains(Flags::COMPUTE) && !flags.contains(Flags::GRAPHICS))
            .filter(|&family| family != main);
    Some(Families {
        main: main as u32,
        update: update.map(|family| family as u32),
        main_timestamp_bits: families[main].timestamp_valid_bits,
        update_timestamp_bits: families[update.unwrap_or(main)].timestamp_valid_bits,
    })
}

/// Optional abilities of the device.
pub(crate) struct Abilities {
    /// Compute pipelines may ask for the subgroup size in [`Limits`], all lanes active.
    pub(crate) pinned_subgroups: bool,
    /// `VK_EXT_memory_budget` is there.
    pub(crate) memory_budget: bool,
    /// Buffers and timelines can be exported to other APIs.
    pub(crate) exports: bool,
    /// The driver tells registers and shared memory of kernels, and was asked to.
    pub(crate) kernel_reports: bool,
    /// SPIR-V capabilities that this device does not have, with the feature that would give them.
    pub(crate) missing_capabilities: Vec<(u32, &'static str)>,
}

/// A logical device with its abilities and limits.
pub(crate) struct Opened {
    pub(crate) device: ash::Device,
    pub(crate) abilities: Abilities,
    pub(crate) limits: Limits,
}

/// Opens `physical` with one queue of each of `families`; with `reports_kernels`, so that the
/// driver can be asked about kernels, where it has the extension.
pub(crate) fn open(
    instance: &Instance,
    physical: &Physical,
    families: &[u32],
    reports_kernels: bool,
) -> Result<Opened, GpuError> {
    let [major, minor, patch] = physical.info.api_version;
    if (major, minor) < (1, 3) {
        return Err(missing(
            physical,
            &format!("Vulkan 1.3 (it offers {major}.{minor}.{patch})"),
        ));
    }
    // SAFETY: a query on a device of this instance.
    let extensions = unsafe {
        instance
            .raw
            .enumerate_device_extension_properties(physical.raw)
    }
    .map_err(failed("vkEnumerateDeviceExtensionProperties"))?;
    let has = |name: &CStr| {
        extensions
            .iter()
            .any(|extension| extension.extension_name_as_c_str() == Ok(name))
    };
    if !has(khr::push_descriptor::NAME) {
        return Err(missing(physical, "VK_KHR_push_descriptor"));
    }
    let (limits, subgroup_size_can_be_asked_for, bindings_max) = limits(instance, physical);
    if (bindings_max as usize) < BINDINGS_MAX {
        return Err(missing(
            physical,
            &format!("{BINDINGS_MAX} push descriptors (it offers {bindings_max})"),
        ));
    }
    let memory_budget = has(ext::memory_budget::NAME);
    let mut names = vec![khr::push_descriptor::NAME.as_ptr()];
    if memory_budget {
        names.push(ext::memory_budget::NAME.as_ptr());
    }
    let exports = has(khr::external_memory_fd::NAME)
        && has(khr::external_semaphore_fd::NAME)
        && export::is_possible(instance, physical.raw);
    if exports {
        names.extend([
            khr::external_memory_fd::NAME.as_ptr(),
            khr::external_semaphore_fd::NAME.as_ptr(),
        ]);
    }
    let kernel_reports = reports_kernels && has(khr::pipeline_executable_properties::NAME);
    if kernel_reports {
        names.push(khr::pipeline_executable_properties::NAME.as_ptr());
    }
    let found = features(instance, physical)?;
    let abilities = Abilities {
        pinned_subgroups: found.has_full_subgroups() && subgroup_size_can_be_asked_for,
        memory_budget,
        exports,
        kernel_reports,
        missing_capabilities: found.missing_capabilities(),
    };
    let device = create_device(instance, physical, families, &names, &found, kernel_reports)?;
    Ok(Opened {
        device,
        abilities,
        limits,
    })
}

fn limits(instance: &Instance, physical: &Physical) -> (Limits, bool, u32) {
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut size_control = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
    let mut push = vk::PhysicalDevicePushDescriptorPropertiesKHR::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut subgroup)
        .push_next(&mut size_control)
        .push_next(&mut push);
    // SAFETY: a query on a device of this instance that offers Vulkan 1.3 and the push descriptor
    // extension.
    unsafe {
        instance
            .raw
            .get_physical_device_properties2(physical.raw, &mut properties);
    };
    let base = properties.properties.limits;
    let can_ask = size_control
        .required_subgroup_size_stages
        .contains(vk::ShaderStageFlags::COMPUTE)
        && (size_control.min_subgroup_size..=size_control.max_subgroup_size)
            .contains(&subgroup.subgroup_size);
    let threads_max = base.max_compute_work_group_invocations;
    let limits = Limits {
        subgroup_size: subgroup.subgroup_size,
        shared_memory_bytes: base.max_compute_shared_memory_size,
        workgroup_threads_max: threads_max,
        workgroup_subgroups_max: match size_control.max_compute_workgroup_subgroups {
            0 => threads_max / subgroup.subgroup_size.max(1),
            subgroups_max => subgroups_max,
        },
        storage_buffer_bytes_max: u64::from(base.max_storage_buffer_range),
        push_constant_bytes_max: base.max_push_constants_size,
        dispatch_groups_max: base.max_compute_work_group_count,
        timestamp_period_ns: base.timestamp_period,
        device_memory_bytes: physical.info.device_memory_bytes,
    };
    (limits, can_ask, push.max_push_descriptors)
}

/// Features of the Vulkan versions that are used.
struct Features {
    v10: vk::PhysicalDeviceFeatures,
    v11: vk::PhysicalDeviceVulkan11Features<'static>,
    v12: vk::PhysicalDeviceVulkan12Features<'static>,
    v13: vk::PhysicalDeviceVulkan13Features<'static>,
}

/// Asks for the features; those that we cannot do without must be there.
fn features(instance: &Instance, physical: &Physical) -> Result<Features, GpuError> {
    let mut v11 = vk::PhysicalDeviceVulkan11Features::default();
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    let mut found: vk::PhysicalDeviceFeatures2<'_> = vk::PhysicalDeviceFeatures2::default()
        .push_next(&mut v11)
        .push_next(&mut v12)
        .push_next(&mut v13);
    // SAFETY: a query on a device of this instance that offers Vulkan 1.3.
    unsafe {
        instance
            .raw
            .get_physical_device_features2(physical.raw, &mut found);
    };
    let v10 = found.features;
    // The chain that they were asked in ends with this function.
    (v11.p_next, v12.p_next, v13.p_next) = (null_mut(), null_mut(), null_mut());
    let found = Features { v10, v11, v12, v13 };
    for (there, name) in [
        (v12.timeline_semaphore, "timelineSemaphore"),
        (v12.host_query_reset, "hostQueryReset"),
        (v12.scalar_block_layout, "scalarBlockLayout"),
        (v13.synchronization2, "synchronization2"),
        (v13.maintenance4, "maintenance4"),
    ] {
        if there == vk::FALSE {
            return Err(missing(physical, name));
        }
    }
    Ok(found)
}

impl Features {
    fn has_full_subgroups(&self) -> bool {
        self.v13.subgroup_size_control == vk::TRUE && self.v13.compute_full_subgroups == vk::TRUE
    }

    /// SPIR-V capabilities (numbers from the SPIR-V specification, section 3.31) that the device
    /// would refuse.
    fn missing_capabilities(&self) -> Vec<(u32, &'static str)> {
        let Self { v10, v11, v12, .. } = self;
        let optional = [
            (9, v12.shader_float16, "shaderFloat16"),
            (10, v10.shader_float64, "shaderFloat64"),
            (11, v10.shader_int64, "shaderInt64"),
            (
                12,
                v12.shader_buffer_int64_atomics,
                "shaderBufferInt64Atomics",
            ),
            (22, v10.shader_int16, "shaderInt16"),
            (39, v12.shader_int8, "shaderInt8"),
            (
                4433,
                v11.storage_buffer16_bit_access,
                "storageBuffer16BitAccess",
            ),
            (
                4448,
                v12.storage_buffer8_bit_access,
                "storageBuffer8BitAccess",
            ),
            (5345, v12.vulkan_memory_model, "vulkanMemoryModel"),
            (
                5346,
                v12.vulkan_memory_model_device_scope,
                "vulkanMemoryModelDeviceScope",
            ),
        ];
        optional
            .into_iter()
            .filter(|(_, there, _)| *there == vk::FALSE)
            .map(|(capability, _, name)| (capability, name))
            .collect()
    }

    /// Features to enable: all required ones, and optional ones only if shaders can use them.
    fn wanted(&self) -> Self {
        let Self { v10, v11, v12, v13 } = self;
        Self {
            v10: vk::PhysicalDeviceFeatures {
                shader_int64: v10.shader_int64,
                shader_float64: v10.shader_float64,
                shader_int16: v10.shader_int16,
                ..Default::default()
            },
            v11: vk::PhysicalDeviceVulkan11Features {
                storage_buffer16_bit_access: v11.storage_buffer16_bit_access,
                ..Default::default()
            },
            v12: vk::PhysicalDeviceVulkan12Features {
                timeline_semaphore: vk::TRUE,
                host_query_reset: vk::TRUE,
                scalar_block_layout: vk::TRUE,
                storage_buffer8_bit_access: v12.storage_buffer8_bit_access,
                shader_int8: v12.shader_int8,
                shader_float16: v12.shader_float16,
                shader_buffer_int64_atomics: v12.shader_buffer_int64_atomics,
                shader_shared_int64_atomics: v12.shader_shared_int64_atomics,
                shader_subgroup_extended_types: v12.shader_subgroup_extended_types,
                vulkan_memory_model: v12.vulkan_memory_model,
                vulkan_memory_model_device_scope: v12.vulkan_memory_model_device_scope,
                ..Default::default()
            },
            v13: vk::PhysicalDeviceVulkan13Features {
                synchronization2: vk::TRUE,
                maintenance4: vk::TRUE,
                subgroup_size_control: v13.subgroup_size_control,
                compute_full_subgroups: v13.compute_full_subgroups,
                ..Default::default()
            },
        }
    }
}

fn create_device(
    instance: &Instance,
    physical: &Physical,
    families: &[u32],
    extensions: &[*const c_char],
    found: &Features,
    kernel_reports: bool,
) -> Result<ash::Device, GpuError> {
    let mut executable = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default()
        .pipeline_executable_info(true);
    let mut wanted = found.wanted();
    let mut features = vk::PhysicalDeviceFeatures2::default().features(wanted.v10);
    features = features
        .push_next(&mut wanted.v11)
        .push_next(&mut wanted.v12)
        .push_next(&mut wanted.v13);
    if kernel_reports {
        features = features.push_next(&mut executable);
    }
    let queues: Vec<vk::DeviceQueueCreateInfo<'_>> = families
        .iter()
        .map(|&family| {
            vk::DeviceQueueCreateInfo::default()
                .queue_family_index(family)
                .queue_priorities(&[1.0])
        })
        .collect();
    let create = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(extensions)
        .push_next(&mut features);
    // SAFETY: all pointers in `create` outlive the call; extensions, features and families were
    // found to be present.
    unsafe { instance.raw.create_device(physical.raw, &create, None) }
        .map_err(failed("vkCreateDevice"))
}

fn missing(physical: &Physical, feature: &str) -> GpuError {
    GpuError::MissingFeature {
        device: physical.info.name.clone(),
        feature: feature.into(),
        needed_by: "this program".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn family(flags: vk::QueueFlags, timestamp_valid_bits: u32) -> vk::QueueFamilyProperties {
        vk::QueueFamilyProperties {
            queue_flags: flags,
            queue_count: 1,
            timestamp_valid_bits,
            ..Default::default()
        }
    }

    #[test]
    fn the_update_queue_is_the_family_that_computes_and_does_not_draw() {
        use vk::QueueFlags as Flags;
        let (draw, compute, copy) = (
            family(Flags::GRAPHICS | Flags::COMPUTE, 64),
            family(Flags::COMPUTE, 36),
            family(Flags::TRANSFER, 0),
        );
        let chosen =
            |families: &[_]| choose_families(families).map(|chosen| (chosen.main, chosen.update));
        assert_eq!(chosen(&[copy, draw, compute]), Some((1, Some(2))));
        assert_eq!(chosen(&[draw, copy]), Some((0, None)));
        // A device that only computes: its one family is the main one, and nothing is beside it.
        assert_eq!(chosen(&[copy, compute]), Some((1, None)));
        assert_eq!(chosen(&[copy]), None);
        let bits = choose_families(&[copy, draw, compute]).unwrap();
        assert_eq!(
            (bits.main_timestamp_bits, bits.update_timestamp_bits),
            (64, 36)
        );
    }
}
