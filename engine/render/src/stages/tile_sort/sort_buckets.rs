//! Buckets of pairs, each sorted by depth key and record.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::interfaces::sort_buckets::{Bindings, Constants, Module, Push};
use crate::stages::{FrameCounters, IndirectArguments};

/// `sort_buckets.comp`.
pub struct SortBuckets {
    kernel: Kernel<Module>,
}

impl SortBuckets {
    /// The stage; `radial` where keys are of distances.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, radial: bool) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants { radial })?,
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
        let bindings = Bindings {
            required: counters.required.bound(),
            buckets: buffers.buckets.bound(),
            pairs: buffers.pairs.bound(),
            other_keys: records.other_keys.bound(),
            sorted_records: buffers.sorted_records.bound(),
            cameras: records.cameras.bound(),
            slab_ends: buffers.slab_counts.bound(),
        };
        let offset = IndirectArguments::Sort.byte_offset();
        recorder.dispatch_indirect(&self.kernel, bindings, push, &counters.arguments, offset);
    }
}
