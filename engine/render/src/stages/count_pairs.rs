//! How many (macro tile, record) pairs each block of depth-sorted records makes.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{Arguments, Control, Projected, kernel, push_constants};

push_constants! {
    struct Push {
        records_max: u32,
    }
}

/// `count_pairs.comp`.
pub struct CountPairs {
    kernel: Kernel,
}

impl CountPairs {
    /// The stage.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::COUNT_PAIRS, &[])? })
    }

    /// Writes to `pair_counts` the pairs of each block of `order`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        control: &Control,
        order: &Buffer<u32>,
        projected: &Projected,
        pair_counts: &Buffer<u32>,
    ) {
        let push = Push { records_max: projected.colours.len() as u32 };
        let buffers = [
            ("needs", control.needs.binding()),
            ("order", order.binding()),
            ("tile_counts", projected.tile_counts.binding()),
            ("pair_counts", pair_counts.binding()),
        ];
        let offset = Arguments::PairBlocks.byte_offset();
        recorder.dispatch_indirect(&self.kernel, &buffers, bytes_of(&push), control.arguments.binding(), offset);
    }
}
