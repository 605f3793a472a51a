//! Stretches of the pair buffer for coarse tiles and their depth slabs, and the buckets that are
//! sorted.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::TileSortBuffers;
use crate::capacity::groups_for;
use crate::interfaces::plan_buckets::{Bindings, Constants, Module, Push};
use crate::stages::FrameCounters;

/// `plan_buckets.comp`.
pub struct PlanBuckets {
    kernel: Kernel<Module>,
}

impl PlanBuckets {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Turns the counts of `bins` coarse tiles into offsets, and writes their lists and buckets,
    /// and the dispatches that fill and sort them.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        buffers: &TileSortBuffers,
        bins: u32,
    ) {
        let push = Push {
            bin_count: bins,
            buckets_max: buffers.buckets.len() as u32,
            pairs_max: buffers.pairs.len() as u32,
            records_max: buffers.reaches.len() as u32,
        };
        let bindings = Bindings {
            required: counters.required.bound(),
            slab_counts: buffers.slab_counts.bound().cast(),
            tile_lists: buffers.tile_lists.bound(),
            buckets: buffers.buckets.bound(),
            arguments: counters.arguments.bound(),
        };
        recorder.dispatch(&self.kernel, bindings, push, groups_for(bins as usize));
    }
}
