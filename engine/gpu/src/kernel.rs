//! Kernels: compute pipelines of shaders, whose buffers and constants are types.

mod shared;

use std::marker::PhantomData;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use ash::vk;
use decouplegs_spirv::{Binding, Interface, SpecConstant};

use crate::{
    GpuError, KernelReport, Limits,
    context::{Context, ShortName},
    device::BINDINGS_MAX,
    error::failed,
};
pub(crate) use shared::Kernels;

/// The value of a specialization constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Constant {
    /// `uint`
    U32(u32),
    /// `int`
    I32(i32),
    /// `float`
    F32(f32),
    /// `bool`
    Bool(bool),
}

impl Constant {
    /// A value of the same type from text; `None` if it is none.
    pub(crate) fn parsed_alike(self, text: &str) -> Option<Self> {
        match self {
            Self::U32(_) => text.parse().ok().map(Self::U32),
            Self::I32(_) => text.parse().ok().map(Self::I32),
            Self::F32(_) => text.parse().ok().map(Self::F32),
            Self::Bool(_) => text.parse().ok().map(Self::Bool),
        }
    }

    fn bits(self) -> u32 {
        match self {
            Self::U32(value) => value,
            Self::I32(value) => value as u32,
            Self::F32(value) => value.to_bits(),
            Self::Bool(value) => u32::from(value),
        }
    }
}

/// Size of a uniform buffer: what Vulkan guarantees (`maxUniformBufferRange`).
const UNIFORM_BYTES_MAX: u32 = 16_384;

/// Kind of descriptor of a buffer.
pub(crate) fn descriptor_type(binding: &Binding) -> vk::DescriptorType {
    match binding.uniform_bytes {
        Some(_) => vk::DescriptorType::UNIFORM_BUFFER,
        None => vk::DescriptorType::STORAGE_BUFFER,
    }
}

/// A compute pipeline of the shader `S`, ready to be dispatched. Clones share it.
pub struct Kernel<S> {
    pub(crate) core: Arc<KernelCore>,
    shader: PhantomData<fn() -> S>,
}

impl<S> Kernel<S> {
    fn from_core(core: Arc<KernelCore>) -> Self {
        Self {
            core,
            shader: PhantomData,
        }
    }

    /// The name it was made with.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.core.name
    }

    /// Invocations of a workgroup along x, y and z, after specialization.
    #[must_use]
    pub fn workgroup_size(&self) -> [u32; 3] {
        self.core.workgroup_size
    }

    /// True if its subgroups have exactly [`Limits::subgroup_size`] invocations, all of them
    /// active.
    #[must_use]
    pub fn subgroups_pinned(&self) -> bool {
        self.core.subgroups_pinned
    }
}

impl<S> Clone for Kernel<S> {
    fn clone(&self) -> Self {
        Self::from_core(self.core.clone())
    }
}

impl<S> std::fmt::Debug for Kernel<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:?}", self.core.name, self.core.workgroup_size)
    }
}

pub(crate) struct KernelCore {
    /// Different for each kernel of this process.
    pub(crate) id: u64,
    pub(crate) name: &'static str,
    pub(crate) interface: Interface,
    pub(crate) pipeline: vk::Pipeline,
    pub(crate) layout: vk::PipelineLayout,
    set_layout: vk::DescriptorSetLayout,
    workgroup_size: [u32; 3],
    subgroups_pinned: bool,
    /// Figures of the driver, where it was asked.
    report: Option<KernelReport>,
    context: Arc<Context>,
}

impl KernelCore {
    /// Builds the kernel called `name` from `spirv`, whose interface is `interface`.
    fn new(
        context: &Arc<Context>,
        name: &'static str,
        spirv: &[u32],
        interface: Interface,
        constants: &[(&str, Constant)],
    ) -> Result<Self, GpuError> {
        let refuse = |reason| GpuError::Kernel {
            kernel: name,
            reason,
        };
        // A kernel on trial may have constants of its own, which keep their values.
        let given = |declared: &SpecConstant| {
            let mut constants = constants.iter();
            let (_, value) = constants.find(|(name, _)| *name == declared.name)?;
            Some((declared.spec_id, value.bits()))
        };
        let specialized: Vec<(u32, u32)> = interface.constants.iter().filter_map(given).collect();
        let workgroup_size = interface.workgroup_size(&specialized);
        check_capabilities(context, name, &interface)?;
        check_sizes(&context.limits, &interface, workgroup_size).map_err(refuse)?;
        // Handles stay null until they are made, and destroying null does nothing: so a failure
        // half way leaks nothing.
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        let mut core = Self {
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            name,
            interface,
            pipeline: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            workgroup_size,
            subgroups_pinned: pins_subgroups(context, workgroup_size),
            report: None,
            context: context.clone(),
        };
        core.make_layout()?;
        core.make_pipeline(spirv, &specialized)?;
        core.report = context
            .executables
            .as_ref()
            .map(|executables| KernelReport {
                name,
                workgroup_threads: workgroup_size.iter().product(),
                constants: (constants.iter())
                    .map(|&(name, constant)| (name.to_owned(), constant))
                    .collect(),
                figures: executables.figures(core.pipeline),
            });
        Ok(core)
    }

    pub(crate) fn push_len(&self) -> usize {
        self.interface.push_bytes as usize
    }

    fn make_layout(&mut self) -> Result<(), GpuError> {
        let device = &self.context.device;
        let bindings: Vec<vk::DescriptorSetLayoutBinding<'_>> = self
            .interface
            .bindings
            .iter()
            .map(|found| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(found.number)
                    .descriptor_type(descriptor_type(found))
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let create = vk::DescriptorSetLayoutCreateInfo::default()
            .flags(vk::DescriptorSetLayoutCreateFlags::PUSH_DESCRIPTOR_KHR)
            .bindings(&bindings);
        // SAFETY: the device has push descriptors; binding numbers differ, as the reader of SPIR-V
        // made sure, and are few.
        self.set_layout = self
            .context
            .call("vkCreateDescriptorSetLayout", || unsafe {
                device.create_descriptor_set_layout(&create, None)
            })?;
        let sets = [self.set_layout];
        let push = [vk::PushConstantRange {
            stage_flags: vk::ShaderStageFlags::COMPUTE,
            offset: 0,
            size: self.interface.push_bytes,
        }];
        let ranges = if self.interface.push_bytes == 0 {
            &[][..]
        } else {
            &push[..]
        };
        let create = vk::PipelineLayoutCreateInfo::default()
            .set_layouts(&sets)
            .push_constant_ranges(ranges);
        // SAFETY: the set layout is of this device, and the push constants were checked against its
        // limit.
        self.layout = self.context.call("vkCreatePipelineLayout", || unsafe {
            device.create_pipeline_layout(&create, None)
        })?;
        Ok(())
    }

    fn make_pipeline(&mut self, spirv: &[u32], specialized: &[(u32, u32)]) -> Result<(), GpuError> {
        let context = self.context.clone();
        let entries: Vec<vk::SpecializationMapEntry> = (0_u32..)
            .zip(specialized)
            .map(|(i, (spec_id, _))| vk::SpecializationMapEntry {
                constant_id: *spec_id,
                offset: 4 * i,
                size: 4,
            })
            .collect();
        let values: Vec<u32> = specialized.iter().map(|(_, bits)| *bits).collect();
        let specialization = vk::SpecializationInfo::default()
            .map_entries(&entries)
            .data(bytemuck::cast_slice(&values));
        let create = vk::ShaderModuleCreateInfo::default().code(spirv);
        // SAFETY: the shader compiler, which made `spirv`, promises that it is valid; what is on
        // trial was read as SPIR-V before.
        let module = context.call("vkCreateShaderModule", || unsafe {
            context.device.create_shader_module(&create, None)
        })?;
        let entry_point = ShortName::new(&self.interface.entry_point);
        let mut subgroups = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default()
            .required_subgroup_size(context.limits.subgroup_size);
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(entry_point.as_c_str())
            .specialization_info(&specialization);
        if self.subgroups_pinned {
            stage = stage
                .flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS)
                .push_next(&mut subgroups);
        }
        let mut built = vk::PipelineCreationFeedback::default();
        let mut feedback = vk::PipelineCreationFeedbackCreateInfo::default()
            .pipeline_creation_feedback(&mut built);
        let flags = match context.executables {
            Some(_) => vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR,
            None => vk::PipelineCreateFlags::empty(),
        };
        let create = vk::ComputePipelineCreateInfo::default()
            .flags(flags)
            .stage(stage)
            .layout(self.layout)
            .push_next(&mut feedback);
        // SAFETY: module and layout are live and of this device, what `create` points to outlives
        // the call, and the layout is that of the module's interface.
        let pipelines = context.code_of("vkCreateComputePipelines", || unsafe {
            let (device, cache) = (&context.device, context.pipelines.cache);
            let pipelines = device.create_compute_pipelines(cache, &[create], None);
            pipelines.map_err(|(_, code)| code)
        });
        // SAFETY: a module may go as soon as its pipelines are made.
        unsafe { context.device.destroy_shader_module(module, None) };
        self.pipeline = match pipelines {
            Ok(pipelines) => {
                context.pipelines.count(built.flags);
                pipelines[0]
            }
            Err(vk::Result::ERROR_DEVICE_LOST) => {
                return Err(failed("vkCreateComputePipelines")(
                    vk::Result::ERROR_DEVICE_LOST,
                ));
            }
            Err(code) => {
                return Err(GpuError::Kernel {
                    kernel: self.name,
                    reason: format!("the driver could not build it: {code:?}"),
                });
            }
        };
        context.set_name(self.pipeline, self.name);
        Ok(())
    }
}

impl Drop for KernelCore {
    fn drop(&mut self) {
        let device = &self.context.device;
        // SAFETY: submitted work holds its kernels until it is done, so nothing uses the pipeline;
        // null is allowed.
        unsafe { device.destroy_pipeline(self.pipeline, None) };
        // SAFETY: as above.
        unsafe { device.destroy_pipeline_layout(self.layout, None) };
        // SAFETY: as above.
        unsafe { device.destroy_descriptor_set_layout(self.set_layout, None) };
    }
}

fn check_capabilities(
    context: &Context,
    kernel: &'static str,
    interface: &Interface,
) -> Result<(), GpuError> {
    let missing = &context.abilities.missing_capabilities;
    match missing
        .iter()
        .find(|(capability, _)| interface.capabilities.contains(capability))
    {
        Some((_, feature)) => Err(GpuError::MissingFeature {
            device: context.info.name.clone(),
            feature: (*feature).into(),
            needed_by: format!("kernel {kernel}"),
        }),
        None => Ok(()),
    }
}

fn check_sizes(limits: &Limits, interface: &Interface, workgroup: [u32; 3]) -> Result<(), String> {
    let threads: u64 = workgroup.iter().map(|&size| u64::from(size)).product();
    if threads == 0 || threads > u64::from(limits.workgroup_threads_max) {
        return Err(format!(
            "a workgroup of {workgroup:?} has {threads} invocations, this device runs 1 to {}",
            limits.workgroup_threads_max
        ));
    }
    if interface.bindings.len() > BINDINGS_MAX {
        return Err(format!(
            "{} buffers bound, at most {BINDINGS_MAX} can be",
            interface.bindings.len()
        ));
    }
    for binding in interface.bindings.iter() {
        if let Some(bytes) = binding
            .uniform_bytes
            .filter(|bytes| *bytes > UNIFORM_BYTES_MAX)
        {
            return Err(format!(
                "{} has {bytes} bytes, a uniform buffer at most {UNIFORM_BYTES_MAX}",
                binding.name
            ));
        }
    }
    let push_bytes = interface.push_bytes;
    if push_bytes > limits.push_constant_bytes_max || !push_bytes.is_multiple_of(4) {
        let max = limits.push_constant_bytes_max;
        return Err(format!(
            "{push_bytes} bytes of push constants, this device has at most {max}, in whole words"
        ));
    }
    Ok(())
}

/// Full subgroups of the size that [`Limits`] promises, wherever Vulkan lets us ask for it
/// (VUID-VkPipelineShaderStageCreateInfo-pNext-02756 and -02757).
fn pins_subgroups(context: &Context, workgroup: [u32; 3]) -> bool {
    let size = context.limits.subgroup_size;
    let threads: u32 = workgroup.iter().product();
    context.abilities.pinned_subgroups
        && workgroup[0].is_multiple_of(size)
        && threads / size <= context.limits.workgroup_subgroups_max
}
