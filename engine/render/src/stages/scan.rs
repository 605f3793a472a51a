//! Where each (camera, chunk) begins in the list of records.

use bytemuck::{Pod, Zeroable, bytes_of};
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder};

use super::{Control, kernel};
use crate::capacity::groups_for;
use crate::layout::SCAN_BLOCK;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    count: u32,
    records_max: u32,
}

/// `scan.comp`.
pub struct Scan {
    kernel: Kernel,
}

impl Scan {
    /// The stage; `sort_block` is how many keys a workgroup of the sort takes.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sort_block: u32) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel(gpu, &decouplegs_shaders::SCAN, &[("SORT_BLOCK", Constant::U32(sort_block))])? })
    }

    /// Writes the exclusive sums of `counts` to `firsts`, and the total, which sizes the stages that follow.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counts: &Buffer<u32>,
        firsts: &Buffer<u32>,
        count: usize,
        records_max: usize,
        control: &Control,
    ) {
        let push = Push { count: count as u32, records_max: records_max as u32 };
        let buffers = [
            ("counts", counts.binding()),
            ("firsts", firsts.binding()),
            ("needs", control.needs.binding()),
            ("arguments", control.arguments.binding()),
        ];
        recorder.dispatch(&self.kernel, &buffers, bytes_of(&push), groups_for(count.div_ceil(SCAN_BLOCK)));
    }
}
