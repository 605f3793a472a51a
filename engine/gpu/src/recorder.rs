//! Recording commands: dispatches, copies and fills, in stages that are labeled and timed.

use std::sync::Arc;

use bytemuck::{Pod, bytes_of};

use crate::{
    Buffer, Kernel, Shader,
    commands::{Command, CommandList},
    context::Context,
    memory::BufferMemory,
    queue::Queue,
    slot::STAGES_MAX,
};

/// Commands being recorded. They run in the order recorded, with barriers where one command needs
/// another's results.
///
/// Submitting makes a command buffer of them, or takes one that was made of the same commands and
/// is free. So a frame that does what an earlier one did costs the driver no recording.
#[must_use = "a recorder does nothing until it is submitted"]
pub struct Recorder {
    pub(crate) context: Arc<Context>,
    pub(crate) queue: Arc<Queue>,
    list: CommandList,
    stages: usize,
    in_stage: bool,
}

impl Recorder {
    pub(crate) fn new(context: &Arc<Context>, queue: &Arc<Queue>) -> Self {
        Self {
            context: context.clone(),
            queue: queue.clone(),
            list: queue.spare_list(),
            stages: 0,
            in_stage: false,
        }
    }

    /// Times every stage ([`crate::Ticket::stage_times`]). Stages that are timed do not overlap; so
    /// a command buffer whose stages are not timed may take less time.
    pub fn time_stages(mut self) -> Self {
        self.list.commands.stage_times = true;
        self
    }

    /// Says that these commands will not be recorded a second time, so that they do not take the
    /// place of others that will.
    pub fn only_once(mut self) -> Self {
        self.list.commands.only_once = true;
        self
    }

    /// Records `body` as a stage, and returns what it returns. The stage is labeled in debuggers,
    /// timed where that is asked for, and then named when the device is lost.
    ///
    /// # Panics
    /// For a stage inside a stage, and for more than 127 stages.
    pub fn stage<T>(&mut self, name: &'static str, body: impl FnOnce(&mut Self) -> T) -> T {
        assert!(!self.in_stage, "stage {name}: stages do not nest");
        assert!(
            self.stages < STAGES_MAX,
            "stage {name}: a command buffer has at most {STAGES_MAX} stages"
        );
        self.stages += 1;
        self.in_stage = true;
        self.list.add(Command::BeginStage(name));
        let result = body(self);
        self.list.add(Command::EndStage);
        self.in_stage = false;
        result
    }

    /// Runs `groups` workgroups of `kernel` on `bindings`, with the push constants `push`.
    ///
    /// # Panics
    /// Panics if there are more workgroups than the device's limit, or a uniform buffer is shorter
    /// than the kernel's.
    pub fn dispatch<S: Shader>(
        &mut self,
        kernel: &Kernel<S>,
        bindings: S::Bindings<'_>,
        push: S::Push,
        groups: [u32; 3],
    ) {
        let max = self.context.limits.dispatch_groups_max;
        let fits = groups.iter().zip(&max).all(|(groups, max)| groups <= max);
        assert!(
            fits,
            "kernel {}: {groups:?} workgroups, the device runs at most {max:?}",
            kernel.name()
        );
        self.bind(kernel, bindings, push);
        self.list.add(Command::Dispatch(groups));
    }

    /// Like [`Recorder::dispatch`], with the number of workgroups read on the device: three
    /// `u32` at `byte_offset` of `arguments`. The writer keeps them within `dispatch_groups_max`.
    ///
    /// # Panics
    /// Panics as [`Recorder::dispatch`] does, and if the offset is not a multiple of 4 or
    /// reaches outside the buffer.
    pub fn dispatch_indirect<S: Shader, T>(
        &mut self,
        kernel: &Kernel<S>,
        bindings: S::Bindings<'_>,
        push: S::Push,
        arguments: &Buffer<T>,
        byte_offset: u64,
    ) {
        let bytes = arguments.memory.byte_len;
        let fits = byte_offset.is_multiple_of(4)
            && byte_offset.checked_add(12).is_some_and(|end| end <= bytes);
        assert!(
            fits,
            "kernel {}: no indirect arguments at byte {byte_offset} of {:?}",
            kernel.name(),
            arguments.bound().memory()
        );
        self.bind(kernel, bindings, push);
        self.use_buffer(&arguments.memory);
        self.list.add(Command::DispatchIndirect(byte_offset));
    }

    /// Sets `byte_len` bytes from `byte_offset` on to repetitions of `value`.
    ///
    /// # Panics
    /// Panics if offset or length is not a multiple of 4, or the range is not inside the buffer.
    pub fn fill<T>(&mut self, buffer: &Buffer<T>, byte_offset: u64, byte_len: u64, value: u32) {
        let end = byte_offset.checked_add(byte_len);
        let fits = end.is_some_and(|end| end <= buffer.memory.byte_len.next_multiple_of(4));
        let words = byte_offset.is_multiple_of(4) && byte_len.is_multiple_of(4);
        assert!(
            fits && words,
            "fill of {:?}: {byte_len} bytes at {byte_offset} are not whole words inside it",
            buffer.bound().memory()
        );
        if byte_len == 0 {
            return;
        }
        self.use_buffer(&buffer.memory);
        self.list.add(Command::Fill {
            byte_offset,
            byte_len,
            value,
        });
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
        if byte_len == 0 {
            return;
        }
        self.use_buffer(from);
        self.use_buffer(to);
        self.list.add(Command::Copy {
            from_offset,
            to_offset,
            byte_len,
        });
    }

    /// Leaves all derived barriers out. Only to prove that synchronization validation
    /// sees a missing barrier: what the device computes then is undefined.
    pub fn without_barriers(mut self) -> Self {
        self.list.commands.without_barriers = true;
        self
    }

    /// Returns all that was recorded.
    pub(crate) fn finish(self) -> CommandList {
        self.list
    }

    /// Notes all that a dispatch needs.
    fn bind<S: Shader>(&mut self, kernel: &Kernel<S>, bindings: S::Bindings<'_>, push: S::Push) {
        let core = &kernel.core;
        let buffers = S::buffers(&bindings);
        for (bound, binding) in buffers.as_ref().iter().zip(core.interface.bindings.iter()) {
            let memory = bound.memory;
            let wanted_bytes = u64::from(binding.uniform_bytes.unwrap_or(0));
            assert!(
                memory.bound_bytes >= wanted_bytes,
                "kernel {}: buffer {} of {} bytes, the shader reads {wanted_bytes} of '{}'",
                core.name,
                memory.name,
                memory.bound_bytes,
                binding.name
            );
            self.use_buffer(memory);
        }
        self.list.use_kernel(core, bytes_of(&push));
    }

    fn use_buffer(&mut self, memory: &Arc<BufferMemory>) {
        assert!(
            Arc::ptr_eq(&memory.context, &self.context),
            "buffer {} belongs to another device",
            memory.name
        );
        self.list.use_buffer(memory);
    }
}
