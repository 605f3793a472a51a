//! Agents of a frame or a sweep: what the host writes of them, and the buffers of the device.

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind, Recorder};

use crate::agents::AgentList;
use crate::layout::{AgentRecord, CameraRecord};
use crate::stages::{AgentBuffers, AgentCounts, PURPOSE};

/// Agents that the host writes, and the buffers that kernels make of them.
pub(crate) struct StagedAgents {
    records: Buffer<AgentRecord>,
    cameras: Buffer<CameraRecord>,
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
            buffers: AgentBuffers::new(gpu, room.agents, room.clusters, room.cameras)?,
            room,
        })
    }

    /// Makes room for `counts`, with some to spare: agents come into view and leave it all the
    /// time.
    pub fn fit(&mut self, gpu: &Gpu, counts: AgentCounts) -> Result<(), GpuError> {
        let room = self.room;
        if counts.agents <= room.agents
            && counts.clusters <= room.clusters
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
            },
        )?;
        Ok(())
    }

    /// Writes `list`, which there is room for.
    pub fn write(&self, list: &AgentList) {
        self.records.write_host(0, &list.records);
        self.cameras.write_host(0, &list.cameras);
    }

    /// Records the copy of `counts` agents to the device.
    pub fn copy(&self, recorder: &mut Recorder, counts: AgentCounts) {
        let cameras = counts.agents * counts.cameras;
        recorder.copy(&self.records, 0, &self.buffers.agents, 0, counts.agents);
        recorder.copy(&self.cameras, 0, &self.buffers.cameras, 0, cameras);
    }
}
