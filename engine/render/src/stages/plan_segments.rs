//! Cuts each coarse tile's list into segments that are blended side by side.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::{FrameCounters, PURPOSE};
use crate::capacity::Capacity;
use crate::interfaces::plan_segments::{Bindings, Constants, Module, Push};
use crate::layout::{BlendItem, Composite};

/// The work of blend and composite.
pub struct Plan {
    /// Segments, in waves: those that are first in their coarse tile, then the second, then the
    /// third and fourth and so on.
    pub items: Buffer<BlendItem>,
    /// Coarse tiles that were cut, those with many segments in parts.
    pub composites: Buffer<Composite>,
}

impl Plan {
    /// Buffers for images of `bins` coarse tiles.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, capacity: &Capacity, bins: u32) -> Result<Self, GpuError> {
        Ok(Self {
            items: gpu.buffer("items", PURPOSE, capacity.items(bins), MemoryKind::Device)?,
            composites: gpu.buffer(
                "composites",
                PURPOSE,
                capacity.composites(bins),
                MemoryKind::Device,
            )?,
        })
    }
}

/// Sorted lists of coarse tiles.
#[derive(Clone, Copy)]
pub struct SortedLists<'a> {
    /// Entries of each.
    pub lists: TileLists<'a>,
    /// Records of the entries, front to back in each list.
    pub records: &'a Buffer<u32>,
}

/// Lists of coarse tiles.
#[derive(Clone, Copy)]
pub struct TileLists<'a> {
    /// First pair and length of each.
    pub lists: &'a Buffer<[u32; 2]>,
    /// Number of coarse tiles.
    pub count: u32,
}

/// `plan_segments.comp`.
pub struct PlanSegments {
    kernel: Kernel<Module>,
    segment_pairs: u32,
}

impl PlanSegments {
    /// The stage; lists longer than `segment_pairs` are cut, `u32::MAX` cuts none.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, segment_pairs: u32) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants { segment_pairs })?,
            segment_pairs,
        })
    }

    /// Writes `plan` for `lists`, and returns it.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        lists: TileLists<'_>,
        capacity: &Capacity,
        plan: &'a Plan,
    ) -> &'a Plan {
        let push = Push {
            bin_count: lists.count,
            pairs_max: capacity.pairs as u32,
            items_max: plan.items.len() as u32,
            partials_max: capacity.partials as u32,
            composites_max: plan.composites.len() as u32,
        };
        let bindings = Bindings {
            required: counters.required.bound(),
            tile_lists: lists.lists.bound(),
            items: plan.items.bound(),
            composites: plan.composites.bound(),
            arguments: counters.arguments.bound(),
        };
        let waves = waves_for(capacity.pairs.div_ceil(self.segment_pairs as usize));
        recorder.dispatch(
            &self.kernel,
            bindings,
            push,
            [lists.count.div_ceil(256), waves, 1],
        );
        plan
    }
}

/// Waves that hold `segments` of one coarse tile: wave 0 is segment 0, wave w the segments from
/// 2^(w - 1) to 2^w - 1.
fn waves_for(segments: usize) -> u32 {
    1 + segments.max(1).next_power_of_two().trailing_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_hold_all_segments() {
        assert_eq!(
            [0, 1, 2, 3, 4, 5, 8, 9].map(waves_for),
            [1, 1, 2, 3, 3, 4, 4, 5]
        );
    }
}
