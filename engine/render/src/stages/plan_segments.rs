//! Cuts each macro tile's list into segments that are blended side by side.

use bytemuck::{Pod, Zeroable, bytes_of};
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{Control, PURPOSE, kernel};
use crate::capacity::{Capacity, groups_for};
use crate::layout::{Composite, Item};

/// The work of blend and composite.
pub struct Plan {
    /// Segments, by macro tile and front to back within one.
    pub items: Buffer<Item>,
    /// Macro tiles that were cut.
    pub composites: Buffer<Composite>,
}

impl Plan {
    /// Buffers for pictures of `bins` macro tiles.
    ///
    /// # Errors
    /// When the device is out of memory.
    pub fn new(gpu: &Gpu, capacity: &Capacity, bins: u32) -> Result<Self, GpuError> {
        Ok(Self {
            items: gpu.buffer("items", PURPOSE, capacity.items(bins), Residence::Device)?,
            composites: gpu.buffer("composites", PURPOSE, capacity.composites(bins), Residence::Device)?,
        })
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    bin_count: u32,
    pairs_max: u32,
    items_max: u32,
    partials_max: u32,
}

/// `plan_segments.comp`.
pub struct PlanSegments {
    kernel: Kernel,
}

impl PlanSegments {
    /// The stage; lists longer than `segment_pairs` are cut, `u32::MAX` cuts none.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu, segment_pairs: u32) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel(gpu, &decouplegs_shaders::PLAN_SEGMENTS, &[("SEGMENT_PAIRS", Constant::U32(segment_pairs))])? })
    }

    /// Writes `plan` for the lists that begin at `range_firsts`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        control: &Control,
        range_firsts: &Buffer<u32>,
        bin_count: u32,
        capacity: &Capacity,
        plan: &Plan,
    ) {
        let push = Push {
            bin_count,
            pairs_max: capacity.pairs as u32,
            items_max: plan.items.len() as u32,
            partials_max: capacity.partials as u32,
        };
        let buffers = [
            ("needs", control.needs.binding()),
            ("range_firsts", range_firsts.binding()),
            ("items", plan.items.binding()),
            ("composites", plan.composites.binding()),
            ("arguments", control.arguments.binding()),
        ];
        recorder.dispatch(&self.kernel, &buffers, bytes_of(&push), groups_for((bin_count as usize).div_ceil(256)));
    }
}
