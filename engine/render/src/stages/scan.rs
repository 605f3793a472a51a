//! Prefix sum (exclusive scan) of counts: the offset of each list.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{kernel, push_constants};
use crate::capacity::groups_for;
use crate::layout::SCAN_BLOCK;

push_constants! {
    struct Push {
        count: u32,
    }
}

/// `scan.comp`.
pub struct Scan {
    kernel: Kernel,
}

impl Scan {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::SCAN, &[])?,
        })
    }

    /// Writes the exclusive sums of the first `count` of `counts` to `offsets`, and their total
    /// behind them.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counts: &Buffer<u32>,
        offsets: &Buffer<u32>,
        count: usize,
    ) {
        let push = Push {
            count: count as u32,
        };
        let buffers = [("counts", counts.binding()), ("offsets", offsets.binding())];
        recorder.dispatch(
            &self.kernel,
            &buffers,
            bytes_of(&push),
            groups_for(count.div_ceil(SCAN_BLOCK).max(1)),
        );
    }
}
