//! Command slots: a command buffer with its pool, its timestamps, and hold of all that it uses.
//! Submitted again as it is, or recorded again.

use std::sync::Arc;

use ash::vk;

use crate::{
    GpuError,
    commands::{CommandList, Commands},
    context::Context,
    hazards,
};

/// Stages of one command buffer; a frame has about forty.
pub(crate) const STAGES_MAX: usize = 127;

/// Two timestamps for each stage, and two for the whole.
const QUERIES: u32 = 2 + 2 * STAGES_MAX as u32;

const QUERY_START: u32 = 0;
const QUERY_END: u32 = 1;

/// A timestamp's value, and a word that is not zero once it is there.
type Answer = [u64; 2];

pub(crate) struct CommandSlot {
    pub(crate) commands: vk::CommandBuffer,
    /// Commands that it was recorded from, with hold of all that they use until the device is done.
    /// None if recording failed.
    recorded: Option<CommandList>,
    /// Names of its stages.
    pub(crate) stages: Arc<[&'static str]>,
    pool: vk::CommandPool,
    /// Null where the queue has no timestamps.
    queries: vk::QueryPool,
    context: Arc<Context>,
}

impl CommandSlot {
    pub(crate) fn new(
        context: &Arc<Context>,
        family: u32,
        timestamps: bool,
    ) -> Result<Self, GpuError> {
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(family);
        // SAFETY: `family` is one that the device was opened with.
        let pool = context.call("vkCreateCommandPool", || unsafe {
            context.device.create_command_pool(&create, None)
        })?;
        // From here on a failure drops the slot, which destroys what there is; null handles are
        // allowed then.
        let mut slot = Self {
            commands: vk::CommandBuffer::null(),
            recorded: None,
            stages: Arc::new([]),
            pool,
            queries: vk::QueryPool::null(),
            context: context.clone(),
        };
        let allocate = vk::CommandBufferAllocateInfo::default()
            .command_pool(pool)
            .command_buffer_count(1);
        // SAFETY: the pool was made above and nobody else knows it.
        let commands = context.call("vkAllocateCommandBuffers", || unsafe {
            context.device.allocate_command_buffers(&allocate)
        })?;
        slot.commands = commands[0];
        if timestamps {
            let create = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(QUERIES);
            // SAFETY: a plain creation; the queue's family has timestamps.
            slot.queries = context.call("vkCreateQueryPool", || unsafe {
                context.device.create_query_pool(&create, None)
            })?;
        }
        Ok(slot)
    }

    /// True if it was recorded from `commands`.
    pub(crate) fn does(&self, commands: &Commands) -> bool {
        self.recorded
            .as_ref()
            .is_some_and(|recorded| recorded.commands == *commands)
    }

    /// True if what is recorded will not be submitted again.
    pub(crate) fn is_spent(&self) -> bool {
        self.recorded
            .as_ref()
            .is_none_or(|recorded| recorded.commands.only_once)
    }

    /// Prepares what is recorded for another submission, which `list`, an equal one, holds
    /// everything for. The device must be done with the submission before. Returns a list to use
    /// again.
    pub(crate) fn repeat(&mut self, mut list: CommandList) -> CommandList {
        self.reset_queries();
        if let Some(recorded) = &mut self.recorded {
            std::mem::swap(&mut recorded.held, &mut list.held);
        }
        list
    }

    /// Records `list`. The device must be done with what was recorded before.
    pub(crate) fn record(&mut self, list: CommandList) -> Result<(), GpuError> {
        self.recorded = None;
        let (context, device) = (self.context.clone(), &self.context.device);
        // SAFETY: the device is done with the pool's one command buffer, by this function's
        // contract.
        context.call("vkResetCommandPool", || unsafe {
            device.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty())
        })?;
        self.reset_queries();
        let begin = vk::CommandBufferBeginInfo::default();
        // SAFETY: the command buffer was just reset.
        context.call("vkBeginCommandBuffer", || unsafe {
            device.begin_command_buffer(self.commands, &begin)
        })?;
        hazards::barrier_at_start(&self.context, self.commands);
        self.timestamp(QUERY_START);
        let timed = list.commands.stage_times;
        list.encode(&self.context, self.commands, |edge| {
            if timed {
                self.timestamp(2 + edge);
            }
        });
        hazards::barrier_to_host(&self.context, self.commands);
        self.timestamp(QUERY_END);
        // SAFETY: the command buffer is being recorded, by us alone.
        context.call("vkEndCommandBuffer", || unsafe {
            device.end_command_buffer(self.commands)
        })?;
        self.stages = list.commands.stages().collect();
        self.recorded = Some(list);
        Ok(())
    }

    /// Gives back what the finished work held.
    pub(crate) fn release(&mut self) {
        if let Some(recorded) = &mut self.recorded {
            recorded.held.clear();
        }
    }

    /// True if its stages are timed.
    pub(crate) fn times_stages(&self) -> bool {
        self.recorded
            .as_ref()
            .is_some_and(|recorded| recorded.commands.stage_times)
    }

    fn reset_queries(&self) {
        if self.has_timestamps() {
            // SAFETY: the feature is required of every device, and no pending command buffer uses
            // the pool.
            unsafe {
                self.context
                    .device
                    .reset_query_pool(self.queries, 0, QUERIES);
            };
        }
    }

    /// Marks the time at which everything recorded so far is done, so that consecutive stages do
    /// not overlap.
    fn timestamp(&self, query: u32) {
        if self.has_timestamps() {
            let stage = vk::PipelineStageFlags2::ALL_COMMANDS;
            // SAFETY: recording, by us alone; the query is inside the pool, was reset, and is
            // written once.
            unsafe {
                self.context
                    .device
                    .cmd_write_timestamp2(self.commands, stage, self.queries, query);
            };
        }
    }

    fn has_timestamps(&self) -> bool {
        self.queries != vk::QueryPool::null()
    }

    /// The timestamps of the start, the end, and of start and end of each stage that is timed,
    /// `None` for those that the device has not written yet. Empty where the queue has none.
    pub(crate) fn ticks(&self) -> Vec<Option<u64>> {
        if !self.has_timestamps() {
            return Vec::new();
        }
        let timed = if self.times_stages() {
            self.stages.len()
        } else {
            0
        };
        let mut answers: Vec<Answer> = vec![[0; 2]; 2 + 2 * timed];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
        // Not ready, or a device lost, leaves the words of timestamps that are not there at zero:
        // that is the answer then.
        // SAFETY: the queries are inside the pool, and an answer has the two words that the flags
        // ask for.
        let _ = unsafe {
            self.context
                .device
                .get_query_pool_results(self.queries, 0, &mut answers, flags)
        };
        answers
            .into_iter()
            .map(|[value, there]| (there != 0).then_some(value))
            .collect()
    }
}

impl Drop for CommandSlot {
    fn drop(&mut self) {
        // SAFETY: a slot is dropped only when the device is done with it or never saw it; its
        // command buffer goes with the pool.
        unsafe { self.context.device.destroy_command_pool(self.pool, None) };
        // SAFETY: as above; null is allowed.
        unsafe { self.context.device.destroy_query_pool(self.queries, None) };
    }
}
