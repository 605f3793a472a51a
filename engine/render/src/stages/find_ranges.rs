//! Where each macro tile's list begins in the sorted pairs.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{Arguments, Control, kernel, push_constants};

push_constants! {
    struct Push {
        pairs_max: u32,
        bin_count: u32,
    }
}

/// `find_ranges.comp`.
pub struct FindRanges {
    kernel: Kernel,
}

impl FindRanges {
    /// The stage.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::FIND_RANGES, &[])? })
    }

    /// Writes to `range_firsts`, of one entry more than there are macro tiles, where each list of `bins` begins.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        control: &Control,
        bins: &Buffer<u32>,
        range_firsts: &Buffer<u32>,
        bin_count: u32,
    ) {
        let push = Push { pairs_max: bins.len() as u32, bin_count };
        let buffers = [("needs", control.needs.binding()), ("bins", bins.binding()), ("range_firsts", range_firsts.binding())];
        recorder.dispatch_indirect(
            &self.kernel,
            &buffers,
            bytes_of(&push),
            control.arguments.binding(),
            Arguments::Ranges.byte_offset(),
        );
    }
}
