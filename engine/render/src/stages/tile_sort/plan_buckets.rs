//! Stretches of the pair buffer for coarse tiles and their depth slabs, and the buckets that are
//! sorted.

use bytemuck::bytes_of;
use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::TileSortBuffers;
use crate::capacity::groups_for;
use crate::stages::{FrameCounters, kernel, push_constants};

push_constants! {
    struct Push {
        bin_count: u32,
        buckets_max: u32,
        pairs_max: u32,
        records_max: u32,
    }
}

/// `plan_buckets.comp`.
pub struct PlanBuckets {
    kernel: Kernel,
}

impl PlanBuckets {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::PLAN_BUCKETS, &[])?,
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
        let bound = [
            ("required", counters.required.binding()),
            ("slab_counts", buffers.slab_counts.binding()),
            ("tile_lists", buffers.tile_lists.binding()),
            ("buckets", buffers.buckets.binding()),
            ("arguments", counters.arguments.binding()),
        ];
        recorder.dispatch(
            &self.kernel,
            &bound,
            bytes_of(&push),
            groups_for(bins as usize),
        );
    }
}
