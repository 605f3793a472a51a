//! Statistics of a finished frame, collected from its slot.

use std::time::{Duration, Instant};

use crate::RenderError;
use crate::layout::RequiredCounts;
use crate::options::{FrameStatistics, QueueTrace};
use crate::slot::{FrameInFlight, Pending};

impl FrameInFlight {
    /// Statistics of the frame `pending` of this slot: `required` are its required counts,
    /// `redrawn` its repeated attempts, and `awaited` the time at which the host began to wait.
    pub fn statistics(
        &self,
        pending: &Pending,
        required: RequiredCounts,
        redrawn: u32,
        awaited: Instant,
    ) -> Result<FrameStatistics, RenderError> {
        let list = self.list.as_ref();
        let mut queues = vec![QueueTrace::of("main", &pending.frame)?];
        if let Some(update) = &pending.update {
            queues.push(QueueTrace::of("update", update)?);
        }
        Ok(FrameStatistics {
            required,
            capacity: pending.capacity,
            redrawn,
            keys: pending.keys.sources.clone(),
            agents: list.map_or(0, |list| list.agents),
            agent_splats: list.map_or(0, |list| list.splats),
            relit: list.map_or(0, |_| self.relit.to_make.0),
            gpu_time: Duration::from_nanos(queues[0].total_ns),
            stages: queues[0].stages.clone(),
            update_time: queues
                .get(1)
                .map(|update| Duration::from_nanos(update.total_ns)),
            queues,
            submitted: (pending.since, pending.submitted),
            awaited: (awaited, Instant::now()),
            wall_time: pending.since.elapsed(),
            record_time: pending.record_time,
            repeated: pending.frame.is_repeated(),
        })
    }
}
