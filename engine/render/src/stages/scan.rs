//! Prefix sum (exclusive scan) of counts: the offset of each list.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use crate::capacity::groups_for;
use crate::interfaces::scan::{Bindings, Constants, Module, Push};
use crate::layout::SCAN_BLOCK;

/// `scan.comp`.
pub struct Scan {
    kernel: Kernel<Module>,
}

impl Scan {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Writes the exclusive sums of the first `count` of `counts` to `offsets`, and their total
    /// behind them. Returns `offsets`.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        counts: &Buffer<u32>,
        offsets: &'a Buffer<u32>,
        count: usize,
    ) -> &'a Buffer<u32> {
        let bindings = Bindings {
            counts: counts.bound(),
            offsets: offsets.bound(),
        };
        let push = Push {
            count: count as u32,
        };
        let groups = groups_for(count.div_ceil(SCAN_BLOCK).max(1));
        recorder.dispatch(&self.kernel, bindings, push, groups);
        offsets
    }
}
