//! Recording a command buffer: dispatches by name, copies and fills, in stages that are labeled and
//! timed.

pub(crate) mod hazards;

use std::sync::Arc;

use ash::vk;
use bytemuck::Pod;

use crate::{
    Access, Bound, Buffer, GpuError, Kernel,
    context::{Context, ShortName},
    device::BINDINGS_MAX,
    kernel::KernelCore,
    memory::BufferMemory,
    queue::Queue,
    slot::{CommandSlot, STAGES_MAX},
};

/// A command buffer being recorded. Commands run in the order recorded, with barriers where one
/// command needs another's results.
///
/// A recorder that could not be started (device lost, no memory) records nothing, and submitting it
/// gives the reason.
#[must_use = "a recorder does nothing until it is submitted"]
pub struct Recorder {
    pub(crate) context: Arc<Context>,
    pub(crate) queue: Arc<Queue>,
    slot: Result<CommandSlot, GpuError>,
    stages: Vec<&'static str>,
    in_stage: bool,
    barriers: bool,
}

impl Recorder {
    pub(crate) fn new(context: &Arc<Context>, queue: &Arc<Queue>) -> Self {
        let slot = queue.begin();
        Self {
            context: context.clone(),
            queue: queue.clone(),
            slot,
            stages: Vec::new(),
            in_stage: false,
            barriers: true,
        }
    }

    /// Records `body` as a stage: labeled in debuggers, timed, and named when the device is lost.
    ///
    /// # Panics
    /// For a stage inside a stage, and for more than 127 stages.
    pub fn stage(&mut self, name: &'static str, body: impl FnOnce(&mut Self)) {
        assert!(!self.in_stage, "stage {name}: stages do not nest");
        assert!(
            self.stages.len() < STAGES_MAX,
            "stage {name}: a command buffer has at most {STAGES_MAX} stages"
        );
        let index = self.stages.len();
        self.stages.push(name);
        self.in_stage = true;
        if let Ok(slot) = &self.slot {
            begin_label(&self.context, slot.commands, name);
            slot.stage_starts(index);
        }
        body(self);
        if let Ok(slot) = &self.slot {
            slot.stage_ends(index);
            end_label(&self.context, slot.commands);
        }
        self.in_stage = false;
    }

    /// Runs `groups` workgroups of `kernel` on `buffers`, each given with the name that the shader
    /// has for it, and with the push constants `push`.
    ///
    /// # Panics
    /// Panics if a name is not the kernel's, a binding is not given, the push constants have
    /// another size, or there are more workgroups than the device's limit.
    pub fn dispatch(
        &mut self,
        kernel: &Kernel,
        buffers: &[(&str, Bound<'_>)],
        push: &[u8],
        groups: [u32; 3],
    ) {
        let max = self.context.limits.dispatch_groups_max;
        let fits = groups.iter().zip(&max).all(|(groups, max)| groups <= max);
        assert!(
            fits,
            "kernel {}: {groups:?} workgroups, the device runs at most {max:?}",
            kernel.name()
        );
        let Some(commands) = self.bind(kernel, buffers, push, None) else {
            return;
        };
        let [x, y, z] = groups;
        // SAFETY: pipeline, descriptors and push constants are bound; counts are within the limits.
        unsafe { self.context.device.cmd_dispatch(commands, x, y, z) };
    }

    /// Like [`Recorder::dispatch`], with the number of workgroups read on the device: three `u32`
    /// at `byte_offset` of `arguments`. The writer keeps them within
    /// `dispatch_groups_max`.
    ///
    /// # Panics
    /// Panics as [`Recorder::dispatch`] does, and if the offset is not a multiple of 4 or reaches
    /// outside the buffer.
    pub fn dispatch_indirect(
        &mut self,
        kernel: &Kernel,
        buffers: &[(&str, Bound<'_>)],
        push: &[u8],
        arguments: Bound<'_>,
        byte_offset: u64,
    ) {
        let bytes = arguments.memory.byte_len;
        let fits = byte_offset.is_multiple_of(4)
            && byte_offset.checked_add(12).is_some_and(|end| end <= bytes);
        assert!(
            fits,
            "kernel {}: no indirect arguments at byte {byte_offset} of {arguments:?}",
            kernel.name()
        );
        let Some(commands) = self.bind(kernel, buffers, push, Some(arguments)) else {
            return;
        };
        // SAFETY: pipeline, descriptors and push constants are bound; the arguments lie inside a
        // buffer with indirect usage that the slot holds, and a barrier orders them behind their
        // writer.
        unsafe {
            self.context
                .device
                .cmd_dispatch_indirect(commands, arguments.memory.raw, byte_offset);
        };
    }

    /// Sets `byte_len` bytes from `byte_offset` on to repetitions of `value`.
    ///
    /// # Panics
    /// Panics if offset or length is not a multiple of 4, or the range is not inside the buffer.
    pub fn fill(&mut self, buffer: Bound<'_>, byte_offset: u64, byte_len: u64, value: u32) {
        let end = byte_offset.checked_add(byte_len);
        let fits = end.is_some_and(|end| end <= buffer.memory.byte_len.next_multiple_of(4));
        let words = byte_offset.is_multiple_of(4) && byte_len.is_multiple_of(4);
        assert!(
            fits && words,
            "fill of {buffer:?}: {byte_len} bytes at {byte_offset} are not whole words inside it"
        );
        let used = [(buffer.memory, Access::Write)];
        let Some(commands) = self.use_buffers(byte_len > 0, &used) else {
            return;
        };
        // SAFETY: a range of whole words inside a buffer with transfer usage that the slot holds.
        unsafe {
            self.context.device.cmd_fill_buffer(
                commands,
                buffer.memory.raw,
                byte_offset,
                byte_len,
                value,
            );
        };
    }

    /// Copies `count` values from element `from_first` on to element `to_first` on.
    ///
    /// # Panics
    /// Panics if the elements are not all inside their buffers, or are the same ones.
    pub fn copy<T: Pod>(
        &mut self,
        from: &Buffer<T>,
        from_first: usize,
        to: &Buffer<T>,
        to_first: usize,
        count: usize,
    ) {
        let (source, target) = (
            from.byte_range(from_first, count),
            to.byte_range(to_first, count),
        );
        self.copy_bytes(
            &from.memory,
            source.start as u64,
            &to.memory,
            target.start as u64,
            source.len() as u64,
        );
    }

    /// Like [`Recorder::copy`]; the ranges must be inside their buffers.
    pub(crate) fn copy_bytes(
        &mut self,
        from: &Arc<BufferMemory>,
        from_offset: u64,
        to: &Arc<BufferMemory>,
        to_offset: u64,
        byte_len: u64,
    ) {
        assert!(
            from_offset + byte_len <= from.byte_len,
            "copy from {}: outside of it",
            from.name
        );
        assert!(
            to_offset + byte_len <= to.byte_len,
            "copy to {}: outside of it",
            to.name
        );
        let apart = from.id != to.id
            || from_offset + byte_len <= to_offset
            || to_offset + byte_len <= from_offset;
        assert!(apart, "copy inside {}: the ranges overlap", from.name);
        let used = [(from, Access::Read), (to, Access::Write)];
        let Some(commands) = self.use_buffers(byte_len > 0, &used) else {
            return;
        };
        let regions = [vk::BufferCopy {
            src_offset: from_offset,
            dst_offset: to_offset,
            size: byte_len,
        }];
        // SAFETY: ranges inside their buffers that do not overlap; both have transfer usage and are
        // held by the slot.
        unsafe {
            self.context
                .device
                .cmd_copy_buffer(commands, from.raw, to.raw, &regions);
        };
    }

    /// Leaves the derived barriers out from here on. Only to prove that synchronization validation
    /// sees a missing barrier: what the device computes then is undefined.
    pub fn without_barriers(mut self) -> Self {
        self.barriers = false;
        self
    }

    /// Ends recording.
    pub(crate) fn finish(self) -> Result<(CommandSlot, Vec<&'static str>), GpuError> {
        let mut slot = self.slot?;
        slot.end()?;
        Ok((slot, self.stages))
    }

    /// Binds all that a dispatch needs. `None` when there is nothing to record into.
    fn bind(
        &mut self,
        kernel: &Kernel,
        buffers: &[(&str, Bound<'_>)],
        push: &[u8],
        arguments: Option<Bound<'_>>,
    ) -> Option<vk::CommandBuffer> {
        let core = &kernel.core;
        assert!(
            push.len() == core.push_bytes as usize,
            "kernel {}: {} bytes of push constants given, the shader declares {}",
            core.name,
            push.len(),
            core.push_bytes
        );
        // Binding 0 of the array is the kernel's first; one more for the arguments of an indirect
        // dispatch.
        let mut used = [None; BINDINGS_MAX + 1];
        for (slot, bound) in used.iter_mut().zip(resolve(core, buffers)) {
            *slot = Some(bound);
        }
        let count = core.bindings.len();
        used[count] = arguments.map(|arguments| (arguments.memory, Access::Read));
        let used = &used[..count + usize::from(arguments.is_some())];
        let slot = self.slot.as_mut().ok()?;
        note(
            &self.context,
            slot,
            self.barriers,
            used.iter().flatten().copied(),
        );
        slot.kernels.push(core.clone());
        let commands = slot.commands;
        let device = &self.context.device;
        // SAFETY: recording, by us alone; the slot holds the kernel.
        unsafe {
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, core.pipeline);
        };
        push_descriptors(&self.context, commands, core, &used[..count]);
        if !push.is_empty() {
            // SAFETY: the size is that of the layout's one range.
            unsafe {
                device.cmd_push_constants(
                    commands,
                    core.layout,
                    vk::ShaderStageFlags::COMPUTE,
                    0,
                    push,
                );
            };
        }
        Some(commands)
    }

    /// Command buffer for a transfer that uses `buffers`; `None` if there is nothing to do.
    fn use_buffers(
        &mut self,
        any: bool,
        buffers: &[(&Arc<BufferMemory>, Access)],
    ) -> Option<vk::CommandBuffer> {
        let slot = self.slot.as_mut().ok().filter(|_| any)?;
        note(&self.context, slot, self.barriers, buffers.iter().copied());
        Some(slot.commands)
    }
}

/// Emits the barrier that a command on `used` needs, and holds the buffers.
fn note<'a>(
    context: &Arc<Context>,
    slot: &mut CommandSlot,
    barriers: bool,
    used: impl Iterator<Item = (&'a Arc<BufferMemory>, Access)> + Clone,
) {
    for (memory, _) in used.clone() {
        assert!(
            Arc::ptr_eq(&memory.context, context),
            "buffer {} belongs to another device",
            memory.name
        );
        slot.buffers.push(memory.clone());
    }
    let needed = slot
        .hazards
        .touch(used.map(|(memory, access)| (memory.id, access)));
    if needed && barriers {
        hazards::barrier_between(context, slot.commands);
    }
}

/// The buffers in the order of the kernel's bindings.
///
/// # Panics
/// Panics if a name is not the kernel's, comes twice, or a binding is not given.
fn resolve<'a>(
    core: &KernelCore,
    buffers: &[(&str, Bound<'a>)],
) -> impl Iterator<Item = (&'a Arc<BufferMemory>, Access)> {
    if let Some((name, _)) = buffers
        .iter()
        .find(|(name, _)| core.bindings.iter().all(|binding| binding.name != *name))
    {
        panic!(
            "kernel {}: no binding '{name}', it has {:?}",
            core.name,
            core.binding_names()
        );
    }
    core.bindings.iter().map(|binding| {
        let mut given = buffers.iter().filter(|(name, _)| *name == binding.name);
        let (Some((_, bound)), None) = (given.next(), given.next()) else {
            panic!(
                "kernel {}: binding '{}' is not given exactly once",
                core.name, binding.name
            );
        };
        (bound.memory, binding.access)
    })
}

fn push_descriptors(
    context: &Context,
    commands: vk::CommandBuffer,
    core: &KernelCore,
    used: &[Option<(&Arc<BufferMemory>, Access)>],
) {
    let mut infos = [vk::DescriptorBufferInfo::default(); BINDINGS_MAX];
    for (info, (memory, _)) in infos.iter_mut().zip(used.iter().flatten()) {
        *info = vk::DescriptorBufferInfo {
            buffer: memory.raw,
            offset: 0,
            range: memory.bound_bytes,
        };
    }
    let mut writes = [vk::WriteDescriptorSet::default(); BINDINGS_MAX];
    for ((write, info), binding) in writes
        .iter_mut()
        .zip(infos.chunks_exact(1))
        .zip(&core.bindings)
    {
        *write = vk::WriteDescriptorSet::default()
            .dst_binding(binding.binding)
            .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
            .buffer_info(info);
    }
    let writes = &writes[..core.bindings.len()];
    if !writes.is_empty() {
        let point = vk::PipelineBindPoint::COMPUTE;
        // SAFETY: every binding of the layout's set 0 is written with a live storage buffer that
        // the slot holds, and no longer than the device's limit for ranges.
        unsafe {
            context.push_descriptor.cmd_push_descriptor_set(
                commands,
                point,
                core.layout,
                0,
                writes,
            );
        };
    }
}

fn begin_label(context: &Context, commands: vk::CommandBuffer, name: &str) {
    if let Some(debug) = &context.debug {
        let name = ShortName::new(name);
        let label = vk::DebugUtilsLabelEXT::default().label_name(name.as_c_str());
        // SAFETY: recording, by us alone; `stage` ends the label.
        unsafe { debug.cmd_begin_debug_utils_label(commands, &label) };
    }
}

fn end_label(context: &Context, commands: vk::CommandBuffer) {
    if let Some(debug) = &context.debug {
        // SAFETY: recording, by us alone, and `stage` began a label in this command buffer.
        unsafe { debug.cmd_end_debug_utils_label(commands) };
    }
}
