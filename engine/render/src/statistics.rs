//! Statistics of a finished frame.

use std::time::{Duration, Instant};

use crate::RenderError;
use crate::layout::RequiredCounts;
use crate::options::{FrameStatistics, QueueTrace};
use crate::submitted::SubmittedFrame;

impl SubmittedFrame {
    /// Statistics of the frame, which is done: `required` are its required counts, `redrawn` its
    /// repeated attempts, and `awaited` the time at which the host began to wait.
    pub fn statistics(
        &self,
        required: RequiredCounts,
        redrawn: u32,
        awaited: Instant,
    ) -> Result<FrameStatistics, RenderError> {
        let list = self.contents.agents.as_ref();
        let mut queues = vec![QueueTrace::from_ticket("main", &self.frame)?];
        if let Some(update) = &self.update {
            queues.push(QueueTrace::from_ticket("update", update)?);
        }
        Ok(FrameStatistics {
            required,
            capacity: self.capacity,
            redrawn,
            keys: self.keys.sources.clone(),
            lists: self.lists,
            agents: list.map_or(0, |list| list.agents),
            agent_splats: list.map_or(0, |list| list.splats),
            relit: self.contents.relights.count,
            gpu_time: Duration::from_nanos(queues[0].total_ns),
            stages: queues[0].stages.clone(),
            update_time: queues
                .get(1)
                .map(|update| Duration::from_nanos(update.total_ns)),
            queues,
            submitted: (self.since, self.submitted),
            awaited: (awaited, Instant::now()),
            wall_time: self.since.elapsed(),
            record_time: self.record_time,
            repeated: self.frame.is_repeated(),
        })
    }
}
