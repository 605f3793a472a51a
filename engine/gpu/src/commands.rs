//! Lists of commands: what a recorder writes, and what a command buffer is made of.
//!
//! A list is data, so two of them can be compared. Equal lists are one command buffer, which is
//! submitted again instead of recorded again.

use std::sync::Arc;

use ash::vk;

use crate::{
    Access,
    context::{Context, ShortName},
    device::BINDINGS_MAX,
    hazards::{self, Hazards},
    kernel::{KernelCore, descriptor_type},
    memory::BufferMemory,
};

/// A command; buffers, kernels and push constants stand in the lists beside it, in the order used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    BeginStage(&'static str),
    EndStage,
    /// Takes a kernel, its buffers and its push constants.
    Dispatch([u32; 3]),
    /// Takes what [`Command::Dispatch`] takes, and the buffer that has the number of workgroups at
    /// this byte.
    DispatchIndirect(u64),
    /// Takes a buffer.
    Fill {
        byte_offset: u64,
        byte_len: u64,
        value: u32,
    },
    /// Takes the buffer that is read and the one that is written.
    Copy {
        from_offset: u64,
        to_offset: u64,
        byte_len: u64,
    },
}

/// All that decides what a command buffer does. Ids of buffers and kernels are given once in a
/// process, so equal ids are the same buffer or kernel.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Commands {
    pub(crate) list: Vec<Command>,
    buffers: Vec<u64>,
    kernels: Vec<u64>,
    push: Vec<u8>,
    /// True if derived barriers are left out.
    pub(crate) without_barriers: bool,
    /// True if every stage is timed, not only the whole.
    pub(crate) stage_times: bool,
    /// True if no list that comes later will be equal.
    pub(crate) only_once: bool,
}

impl Commands {
    fn clear(&mut self) {
        self.list.clear();
        self.buffers.clear();
        self.kernels.clear();
        self.push.clear();
        (self.without_barriers, self.stage_times, self.only_once) = (false, false, false);
    }

    /// Names of the stages, in order.
    pub(crate) fn stages(&self) -> impl Iterator<Item = &'static str> {
        self.list.iter().filter_map(|command| match *command {
            Command::BeginStage(name) => Some(name),
            _ => None,
        })
    }
}

/// Buffers and kernels of a list, held until the device is done with them.
#[derive(Default)]
pub(crate) struct Held {
    buffers: Vec<Arc<BufferMemory>>,
    kernels: Vec<Arc<KernelCore>>,
}

impl Held {
    pub(crate) fn clear(&mut self) {
        self.buffers.clear();
        self.kernels.clear();
    }
}

/// A list of commands, with hold of all that it uses.
#[derive(Default)]
pub(crate) struct CommandList {
    pub(crate) commands: Commands,
    pub(crate) held: Held,
}

impl CommandList {
    /// Empties it; its vectors keep their room.
    pub(crate) fn clear(&mut self) {
        self.commands.clear();
        self.held.clear();
    }

    pub(crate) fn add(&mut self, command: Command) {
        self.commands.list.push(command);
    }

    pub(crate) fn use_buffer(&mut self, memory: &Arc<BufferMemory>) {
        self.commands.buffers.push(memory.id);
        self.held.buffers.push(memory.clone());
    }

    pub(crate) fn use_kernel(&mut self, kernel: &Arc<KernelCore>, push: &[u8]) {
        self.commands.kernels.push(kernel.id);
        self.held.kernels.push(kernel.clone());
        self.commands.push.extend_from_slice(push);
    }

    /// Records the list into `commands`, which is being recorded and is the caller's alone, with
    /// barriers where one command needs another's results. Calls `edge` with 2 i at the start of
    /// stage i, and with 2 i + 1 at its end.
    pub(crate) fn encode(
        &self,
        context: &Context,
        commands: vk::CommandBuffer,
        mut edge: impl FnMut(u32),
    ) {
        let mut encoder = Encoder {
            context,
            commands,
            barriers: !self.commands.without_barriers,
            hazards: Hazards::default(),
        };
        let mut buffers = &self.held.buffers[..];
        let mut push = &self.commands.push[..];
        let mut kernels = self.held.kernels.iter();
        let mut edges = 0;
        for command in &self.commands.list {
            match *command {
                Command::BeginStage(name) => {
                    encoder.begin_label(name);
                    edge(edges);
                    edges += 1;
                }
                Command::EndStage => {
                    edge(edges);
                    edges += 1;
                    encoder.end_label();
                }
                Command::Dispatch(groups) => {
                    let Some(kernel) = kernels.next() else { break };
                    let bound = take(&mut buffers, kernel.interface.bindings.len());
                    encoder.bind(kernel, bound, None, take(&mut push, kernel.push_len()));
                    encoder.dispatch(groups);
                }
                Command::DispatchIndirect(byte_offset) => {
                    let Some(kernel) = kernels.next() else { break };
                    let bound = take(&mut buffers, kernel.interface.bindings.len());
                    let arguments = &take(&mut buffers, 1)[0];
                    let push = take(&mut push, kernel.push_len());
                    encoder.bind(kernel, bound, Some(arguments), push);
                    encoder.dispatch_indirect(arguments, byte_offset);
                }
                Command::Fill {
                    byte_offset,
                    byte_len,
                    value,
                } => encoder.fill(&take(&mut buffers, 1)[0], byte_offset, byte_len, value),
                Command::Copy {
                    from_offset,
                    to_offset,
                    byte_len,
                } => {
                    let region = vk::BufferCopy {
                        src_offset: from_offset,
                        dst_offset: to_offset,
                        size: byte_len,
                    };
                    let pair = take(&mut buffers, 2);
                    encoder.copy(&pair[0], &pair[1], region);
                }
            }
        }
    }
}

/// Removes the first `count` elements.
fn take<'a, T>(rest: &mut &'a [T], count: usize) -> &'a [T] {
    let (taken, left) = rest.split_at(count);
    *rest = left;
    taken
}

/// Translation of a list into a Vulkan command buffer, which is being recorded by us alone. What it
/// is given is held until the device is done.
struct Encoder<'a> {
    context: &'a Context,
    commands: vk::CommandBuffer,
    barriers: bool,
    hazards: Hazards,
}

impl Encoder<'_> {
    /// Emits the barrier that a command on `used` needs.
    fn touch<'b>(&mut self, used: impl Iterator<Item = (&'b Arc<BufferMemory>, Access)> + Clone) {
        let needed = self
            .hazards
            .touch(used.map(|(memory, access)| (memory.id, access)));
        if needed && self.barriers {
            hazards::barrier_between(self.context, self.commands);
        }
    }

    /// Binds all that a dispatch of `kernel` needs: `buffers` in the order of its bindings.
    fn bind(
        &mut self,
        kernel: &KernelCore,
        buffers: &[Arc<BufferMemory>],
        arguments: Option<&Arc<BufferMemory>>,
        push: &[u8],
    ) {
        let accesses = kernel
            .interface
            .bindings
            .iter()
            .map(|binding| binding.access);
        let arguments = arguments.map(|arguments| (arguments, Access::Read));
        self.touch(buffers.iter().zip(accesses).chain(arguments));
        let (device, point) = (&self.context.device, vk::PipelineBindPoint::COMPUTE);
        // SAFETY: recording, by us alone; the kernel is held.
        unsafe { device.cmd_bind_pipeline(self.commands, point, kernel.pipeline) };
        self.push_descriptors(kernel, buffers);
        if !push.is_empty() {
            let stage = vk::ShaderStageFlags::COMPUTE;
            // SAFETY: the size is that of the layout's one range.
            unsafe { device.cmd_push_constants(self.commands, kernel.layout, stage, 0, push) };
        }
    }

    fn push_descriptors(&self, kernel: &KernelCore, buffers: &[Arc<BufferMemory>]) {
        let mut infos = [vk::DescriptorBufferInfo::default(); BINDINGS_MAX];
        for ((info, memory), binding) in infos
            .iter_mut()
            .zip(buffers)
            .zip(kernel.interface.bindings.iter())
        {
            *info = vk::DescriptorBufferInfo {
                buffer: memory.raw,
                offset: 0,
                range: (binding.uniform_bytes).map_or(memory.bound_bytes, u64::from),
            };
        }
        let mut writes = [vk::WriteDescriptorSet::default(); BINDINGS_MAX];
        for ((write, info), binding) in writes
            .iter_mut()
            .zip(infos.chunks_exact(1))
            .zip(kernel.interface.bindings.iter())
        {
            *write = vk::WriteDescriptorSet::default()
                .dst_binding(binding.number)
                .descriptor_type(descriptor_type(binding))
                .buffer_info(info);
        }
        let writes = &writes[..kernel.interface.bindings.len()];
        if !writes.is_empty() {
            let point = vk::PipelineBindPoint::COMPUTE;
            // SAFETY: every binding of the layout's set 0 is written with a live buffer that is
            // held, of both usages, and no longer than the limits of ranges; the recorder made
            // sure that uniform ranges lie inside their buffers.
            unsafe {
                self.context.push_descriptor.cmd_push_descriptor_set(
                    self.commands,
                    point,
                    kernel.layout,
                    0,
                    writes,
                );
            };
        }
    }

    fn dispatch(&self, [x, y, z]: [u32; 3]) {
        // SAFETY: pipeline, descriptors and push constants are bound; the recorder compared the
        // counts with the limits.
        unsafe { self.context.device.cmd_dispatch(self.commands, x, y, z) };
    }

    fn dispatch_indirect(&self, arguments: &BufferMemory, byte_offset: u64) {
        let device = &self.context.device;
        // SAFETY: pipeline, descriptors and push constants are bound; the arguments lie inside a
        // buffer with indirect usage that is held, and a barrier orders them behind their writer.
        unsafe { device.cmd_dispatch_indirect(self.commands, arguments.raw, byte_offset) };
    }

    fn fill(&mut self, buffer: &Arc<BufferMemory>, byte_offset: u64, byte_len: u64, value: u32) {
        self.touch(std::iter::once((buffer, Access::Write)));
        let (device, raw) = (&self.context.device, buffer.raw);
        // SAFETY: a range of whole words inside a buffer with transfer usage that is held, as the
        // recorder made sure.
        unsafe { device.cmd_fill_buffer(self.commands, raw, byte_offset, byte_len, value) };
    }

    fn copy(&mut self, from: &Arc<BufferMemory>, to: &Arc<BufferMemory>, region: vk::BufferCopy) {
        self.touch([(from, Access::Read), (to, Access::Write)].into_iter());
        let device = &self.context.device;
        // SAFETY: ranges inside their buffers that do not overlap, as the recorder made sure; both
        // have transfer usage and are held.
        unsafe { device.cmd_copy_buffer(self.commands, from.raw, to.raw, &[region]) };
    }

    fn begin_label(&self, name: &str) {
        if let Some(debug) = &self.context.debug {
            let name = ShortName::new(name);
            let label = vk::DebugUtilsLabelEXT::default().label_name(name.as_c_str());
            // SAFETY: recording, by us alone; a stage ends the label that it began.
            unsafe { debug.cmd_begin_debug_utils_label(self.commands, &label) };
        }
    }

    fn end_label(&self) {
        if let Some(debug) = &self.context.debug {
            // SAFETY: recording, by us alone, and the stage began a label in this command buffer.
            unsafe { debug.cmd_end_debug_utils_label(self.commands) };
        }
    }
}
