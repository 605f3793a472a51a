//! Depth slabs that are too long for [`super::SortBuckets`], cut into pieces that are not.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::interfaces::split_slabs::{Bindings, Constants, Module, Push};
use crate::stages::{FrameCounters, IndirectArguments};

/// Threads of a workgroup, at most. Two workgroups of 512 share a multiprocessor of NVIDIA, where
/// one of 1,024 has it to itself.
const THREADS_MAX: u32 = 512;

/// `split_slabs.comp`.
pub struct SplitSlabs {
    kernel: Kernel<Module>,
}

impl SplitSlabs {
    /// The stage; `radial` where keys are of distances.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, radial: bool) -> Result<Self, GpuError> {
        // A power of two. Devices have 128 at least.
        let workgroup_threads = 1 << gpu.limits().workgroup_threads_max.min(THREADS_MAX).ilog2();
        Ok(Self {
            kernel: gpu.kernel(&Constants {
                radial,
                workgroup_threads,
            })?,
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
        let bindings = Bindings {
            required: counters.required.bound(),
            buckets: buffers.buckets.bound(),
            pairs: buffers.pairs.bound(),
            other_keys: records.other_keys.bound(),
            sorted_records: buffers.sorted_records.bound(),
            cameras: records.cameras.bound(),
        };
        let offset = IndirectArguments::Split.byte_offset();
        recorder.dispatch_indirect(&self.kernel, bindings, push, &counters.arguments, offset);
    }
}
