//! First records of each camera, and the dispatch that bins them.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::interfaces::plan_lists::{Bindings, Constants, Module, Push};
use crate::stages::FrameCounters;

/// `plan_lists.comp`.
pub struct PlanLists {
    kernel: Kernel<Module>,
}

impl PlanLists {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Writes the lists of `records`, how many records there are, and the dispatch that bins them.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &TileSortBuffers,
    ) {
        let push = Push {
            camera_count: records.camera_count as u32,
            static_clusters: records.static_clusters as u32,
            moving_clusters: records.moving_clusters as u32,
            records_max: records.projected.room() as u32,
            moving_only: u32::from(records.moving_only),
        };
        let bindings = Bindings {
            static_offsets: records.static_offsets.bound(),
            moving_offsets: records.moving_offsets.bound(),
            lists: buffers.lists.bound(),
            required: counters.required.bound(),
            arguments: counters.arguments.bound(),
        };
        recorder.dispatch(&self.kernel, bindings, push, [1, 1, 1]);
    }
}
