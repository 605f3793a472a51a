//! First records of each camera, and the dispatch that bins them.

use bytemuck::bytes_of;
use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::stages::{FrameCounters, kernel, push_constants};

push_constants! {
    struct Push {
        camera_count: u32,
        static_clusters: u32,
        moving_clusters: u32,
        records_max: u32,
        moving_only: u32,
    }
}

/// `plan_lists.comp`.
pub struct PlanLists {
    kernel: Kernel,
}

impl PlanLists {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::PLAN_LISTS, &[])?,
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
        let bound = [
            ("static_offsets", records.static_offsets.binding()),
            ("moving_offsets", records.moving_offsets.binding()),
            ("lists", buffers.lists.binding()),
            ("required", counters.required.binding()),
            ("arguments", counters.arguments.binding()),
        ];
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), [1, 1, 1]);
    }
}
