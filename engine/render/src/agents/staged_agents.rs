//! Agents of a frame or a sweep: what the host writes of them, and the buffers of the device.

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind, Recorder};

use crate::agents::AgentList;
use crate::layout::{AgentRecord, CameraRecord, ShadingRecord};
use crate::stages::{AgentBuffers, AgentCounts, PURPOSE};

/// Agents that the host writes, and the buffers that kernels make of them.
pub(crate) struct StagedAgents {
    records: Buffer<AgentRecord>,
    cameras: Buffer<CameraRecord>,
    shadings: Buffer<ShadingRecord>,
    pub buffers: AgentBuffers,
    room: AgentCounts,
}

impl StagedAgents {
    /// Buffers for no agents yet.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Self::with_room(gpu, AgentCounts::default())
    }

    fn with_room(gpu: &Gpu, room: AgentCounts) -> Result<Self, GpuError> {
        let cameras = room.agents * room.cameras;
        Ok(Self {
            records: gpu.buffer("staged_agents", PURPOSE, room.agents, MemoryKind::Upload)?,
            cameras: gpu.buffer("staged_agent_cameras", PURPOSE, cameras, MemoryKind::Upload)?,
            shadings: gpu.buffer(
                "staged_shadings",
                PURPOSE,
                room.shadings,
                MemoryKind::Upload,
            )?,
            buffers: AgentBuffers::new(gpu, room)?,
            room,
        })
    }

    /// Makes room for `counts`, with some to spare: agents come into view and leave it all the
    /// time.
    pub fn fit(&mut self, gpu: &Gpu, counts: AgentCounts) -> Result<(), GpuError> {
        let room = self.room;
        if counts.agents <= room.agents
            && counts.clusters <= room.clusters
            && counts.shadings <= room.shadings
            && counts.cameras == room.cameras
        {
            return Ok(());
        }
        let spare = |wanted: usize, had: usize| match wanted <= had {
            true => had,
            false => wanted + wanted / 4,
        };
        *self = Self::with_room(
            gpu,
            AgentCounts {
                agents: spare(counts.agents, room.agents),
                clusters: spare(counts.clusters, room.clusters),
                cameras: counts.cameras,
                shadings: spare(counts.shadings, room.shadings),
            },
        )?;
        Ok(())
    }

    /// Writes `list`, which there is room for.
    pub fn write(&self, list: &AgentList) {
        self.records.write_host(0, &list.records);
        self.cameras.write_host(0, &list.cameras);
        self.shadings.write_host(0, &list.shadings);
    }

    /// Records the copy of `counts` agents to the device.
    pub fn copy(&self, recorder: &mut Recorder, counts: AgentCounts) {
        let cameras = counts.agents * counts.cameras;
        recorder.copy(&self.records, 0, &self.buffers.agents, 0, counts.agents);
        recorder.copy(&self.cameras, 0, &self.buffers.cameras, 0, cameras);
        let shadings = &self.buffers.shadings;
        recorder.copy(&self.shadings, 0, shadings, 0, counts.shadings);
    }
}
