//! Buckets of pairs, each sorted by depth key and record.

use bytemuck::bytes_of;
use decouplegs_gpu::{Constant, Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::stages::{FrameCounters, IndirectArguments, kernel, push_constants};

push_constants! {
    struct Push {
        pairs_max: u32,
        camera_count: u32,
    }
}

/// `sort_buckets.comp`.
pub struct SortBuckets {
    kernel: Kernel,
}

impl SortBuckets {
    /// The stage; `radial` where keys are of distances.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, radial: bool) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(
                gpu,
                &decouplegs_shaders::SORT_BUCKETS,
                &[("RADIAL", Constant::Bool(radial))],
            )?,
        })
    }

    /// Writes the sorted records.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &TileSortBuffers,
    ) {
        let push = Push {
            pairs_max: buffers.pairs.len() as u32,
            camera_count: records.camera_count as u32,
        };
        let bound = [
            ("required", counters.required.binding()),
            ("buckets", buffers.buckets.binding()),
            ("pairs", buffers.pairs.binding()),
            ("other_keys", records.other_keys.binding()),
            ("sorted_records", buffers.sorted_records.binding()),
            ("cameras", records.cameras.binding()),
            ("slab_ends", buffers.slab_counts.binding()),
        ];
        let offset = IndirectArguments::Sort.byte_offset();
        recorder.dispatch_indirect(
            &self.kernel,
            &bound,
            bytes_of(&push),
            counters.arguments.binding(),
            offset,
        );
    }
}
