//! All barriers: which are needed follows from what kernels declare they do with their buffers.
//!
//! Since the last barrier, the buffers written and the buffers read are kept. A command that reads
//! what was written, or writes what was read or written, needs a barrier first; the barrier covers
//! all memory, so both sets start empty after it. One buffer is one resource: two kernels writing
//! different parts of it are kept apart although they need not be.

use ash::vk;

use crate::{Access, context::Context};

/// The stages that our commands run in.
fn stages() -> vk::PipelineStageFlags2 {
    vk::PipelineStageFlags2::COMPUTE_SHADER
        | vk::PipelineStageFlags2::ALL_TRANSFER
        | vk::PipelineStageFlags2::DRAW_INDIRECT
}

/// Buffers touched since the last barrier, by id.
#[derive(Debug, Default)]
pub(crate) struct Hazards {
    written: Vec<u64>,
    read: Vec<u64>,
}

impl Hazards {
    /// Forgets everything, as a new command buffer does: it starts with a barrier.
    pub(crate) fn clear(&mut self) {
        self.written.clear();
        self.read.clear();
    }

    /// Notes that a command touches `buffers`; whether it needs a barrier before it.
    pub(crate) fn touch(&mut self, buffers: impl Iterator<Item = (u64, Access)> + Clone) -> bool {
        let conflicts = |(id, access): (u64, Access)| match access {
            Access::Read => self.written.contains(&id),
            Access::Write | Access::ReadWrite => {
                self.written.contains(&id) || self.read.contains(&id)
            }
        };
        let needed = buffers.clone().any(conflicts);
        if needed {
            self.clear();
        }
        for (id, access) in buffers {
            if access != Access::Write && !self.read.contains(&id) {
                self.read.push(id);
            }
            if access != Access::Read && !self.written.contains(&id) {
                self.written.push(id);
            }
        }
        needed
    }
}

/// Full barrier between two commands of one command buffer.
pub(crate) fn barrier_between(context: &Context, commands: vk::CommandBuffer) {
    use vk::AccessFlags2 as Flags;
    let written = Flags::SHADER_STORAGE_WRITE | Flags::TRANSFER_WRITE;
    let touched = written
        | Flags::SHADER_STORAGE_READ
        | Flags::UNIFORM_READ
        | Flags::TRANSFER_READ
        | Flags::INDIRECT_COMMAND_READ;
    emit(context, commands, (stages(), written), (stages(), touched));
}

/// Barrier at the start, behind earlier command buffers of the same queue and whatever a semaphore
/// waited for.
pub(crate) fn barrier_at_start(context: &Context, commands: vk::CommandBuffer) {
    use vk::{AccessFlags2 as Flags, PipelineStageFlags2 as Stages};
    emit(
        context,
        commands,
        (Stages::ALL_COMMANDS, Flags::MEMORY_WRITE),
        (
            Stages::ALL_COMMANDS,
            Flags::MEMORY_READ | Flags::MEMORY_WRITE,
        ),
    );
}

/// Barrier at the end: what the device wrote becomes visible to the host that waits for the ticket.
pub(crate) fn barrier_to_host(context: &Context, commands: vk::CommandBuffer) {
    use vk::{AccessFlags2 as Flags, PipelineStageFlags2 as Stages};
    emit(
        context,
        commands,
        (Stages::ALL_COMMANDS, Flags::MEMORY_WRITE),
        (Stages::HOST, Flags::HOST_READ),
    );
}

type Scope = (vk::PipelineStageFlags2, vk::AccessFlags2);

fn emit(context: &Context, commands: vk::CommandBuffer, from: Scope, to: Scope) {
    let barriers = [vk::MemoryBarrier2::default()
        .src_stage_mask(from.0)
        .src_access_mask(from.1)
        .dst_stage_mask(to.0)
        .dst_access_mask(to.1)];
    let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
    // SAFETY: `commands` is being recorded by the one recorder that owns it, outside any render
    // pass.
    unsafe { context.device.cmd_pipeline_barrier2(commands, &dependency) };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds the accesses one command at a time; the commands before which a barrier came.
    fn barriers(commands: &[&[(u64, Access)]]) -> Vec<usize> {
        let mut hazards = Hazards::default();
        let needed = |(i, command): (usize, &&[(u64, Access)])| {
            hazards.touch(command.iter().copied()).then_some(i)
        };
        commands.iter().enumerate().filter_map(needed).collect()
    }

    #[test]
    fn each_kind_of_hazard_needs_a_barrier_and_reads_do_not() {
        use Access::{Read, ReadWrite, Write};
        assert_eq!(
            barriers(&[&[(1, Write)], &[(1, Read)]]),
            [1],
            "read after write"
        );
        assert_eq!(
            barriers(&[&[(1, Read)], &[(1, Write)]]),
            [1],
            "write after read"
        );
        assert_eq!(
            barriers(&[&[(1, Write)], &[(1, Write)]]),
            [1],
            "write after write"
        );
        assert_eq!(barriers(&[&[(1, ReadWrite)], &[(1, ReadWrite)]]), [1]);
        assert_eq!(barriers(&[&[(1, Read)], &[(1, Read)]]), []);
        assert_eq!(barriers(&[&[(1, Write)], &[(2, Write)], &[(3, Read)]]), []);
    }

    #[test]
    fn one_barrier_serves_all_that_came_before_it() {
        use Access::{Read, Write};
        assert_eq!(
            barriers(&[
                &[(1, Write)],
                &[(2, Write)],
                &[(1, Read), (3, Write)],
                &[(2, Read)]
            ]),
            [2]
        );
        // The command behind the barrier counts again.
        assert_eq!(
            barriers(&[&[(1, Write)], &[(1, Read), (3, Write)], &[(3, Read)]]),
            [1, 2]
        );
        // A read behind the barrier is still in the way of a later write.
        assert_eq!(
            barriers(&[&[(1, Write)], &[(1, Read)], &[(1, Write)]]),
            [1, 2]
        );
    }
}
