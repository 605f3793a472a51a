//! Tile binning: (coarse tile, record) pairs by depth slab, counted.

use bytemuck::bytes_of;
use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{RecordKind, Records, TileSortBuffers};
use crate::stages::{FrameCounters, IndirectArguments, kernel, push_constants};

push_constants! {
    struct Push {
        camera_count: u32,
        records_max: u32,
    }
}

/// `count_pairs.comp`.
pub struct CountPairs {
    kernel: Kernel,
}

impl CountPairs {
    /// The stage for records of one kind.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, kind: RecordKind) -> Result<Self, GpuError> {
        let constants = kind.constants();
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::COUNT_PAIRS, &constants)?,
        })
    }

    /// Counts the pairs of `records`, and finds the coarse tiles of each.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &TileSortBuffers,
    ) {
        let push = Push {
            camera_count: records.camera_count as u32,
            records_max: records.projected.room() as u32,
        };
        let bound = [
            ("cameras", records.cameras.binding()),
            ("required", counters.required.binding()),
            ("lists", buffers.lists.binding()),
            ("keys", records.projected.keys.binding()),
            ("footprints", records.projected.footprints.binding()),
            ("slab_counts", buffers.slab_counts.binding()),
            ("reaches", buffers.reaches.binding()),
            ("large_records", buffers.large_records.binding()),
        ];
        let offset = IndirectArguments::PairBlocks.byte_offset();
        recorder.dispatch_indirect(
            &self.kernel,
            &bound,
            bytes_of(&push),
            counters.arguments.binding(),
            offset,
        );
    }
}
