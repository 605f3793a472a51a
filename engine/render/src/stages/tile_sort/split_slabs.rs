//! Depth slabs that are too long for [`super::SortBuckets`], cut into pieces that are not.

use bytemuck::bytes_of;
use decouplegs_gpu::{Constant, Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::stages::{FrameCounters, IndirectArguments, kernel, push_constants};

push_constants! {
    struct Push {
        pairs_max: u32,
        buckets_max: u32,
        camera_count: u32,
    }
}

/// Bins of a slab, and threads at most.
const SLAB_BINS: u32 = 1024;

/// `split_slabs.comp`.
pub struct SplitSlabs {
    kernel: Kernel,
}

impl SplitSlabs {
    /// The stage; `radial` where keys are of distances.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, radial: bool) -> Result<Self, GpuError> {
        // A power of two. Devices have 128 at least.
        let threads = 1 << gpu.limits().workgroup_threads_max.min(SLAB_BINS).ilog2();
        Ok(Self {
            kernel: kernel::<Push>(
                gpu,
                &decouplegs_shaders::SPLIT_SLABS,
                &[
                    ("RADIAL", Constant::Bool(radial)),
                    ("WORKGROUP_THREADS", Constant::U32(threads)),
                ],
            )?,
        })
    }

    /// Writes the pieces as buckets. Depth keys of records are overwritten: the pairs have copies.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &TileSortBuffers,
    ) {
        let push = Push {
            pairs_max: buffers.pairs.len() as u32,
            buckets_max: buffers.buckets.len() as u32,
            camera_count: records.camera_count as u32,
        };
        let bound = [
            ("required", counters.required.binding()),
            ("buckets", buffers.buckets.binding()),
            ("pairs", buffers.pairs.binding()),
            ("other_keys", records.other_keys.binding()),
            ("sorted_records", buffers.sorted_records.binding()),
            ("cameras", records.cameras.binding()),
        ];
        let offset = IndirectArguments::Split.byte_offset();
        recorder.dispatch_indirect(
            &self.kernel,
            &bound,
            bytes_of(&push),
            counters.arguments.binding(),
            offset,
        );
    }
}
