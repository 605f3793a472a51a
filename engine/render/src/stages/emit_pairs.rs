//! Writes a (macro tile, record) pair for every macro tile that a record reaches, records in depth order.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder};

use super::{Arguments, Control, Projected, kernel, push_constants};
use crate::layout::{CameraRecord, ViewLists};

/// Where the pairs go.
pub struct Pairs<'a> {
    /// Macro tile of each pair.
    pub bins: &'a Buffer<u32>,
    /// Record of each pair.
    pub records: &'a Buffer<u32>,
}

push_constants! {
    struct Push {
        camera_count: u32,
        records_max: u32,
        pairs_max: u32,
    }
}

/// `emit_pairs.comp`.
pub struct EmitPairs {
    kernel: Kernel,
}

impl EmitPairs {
    /// The stage; `sort_block` is how many keys a workgroup of the sort takes.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sort_block: u32) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::EMIT_PAIRS, &[("SORT_BLOCK", Constant::U32(sort_block))])? })
    }

    /// Writes `pairs`; `lists` tells which camera a record belongs to.
    #[expect(clippy::too_many_arguments, reason = "one argument a buffer that the stage reads or writes")]
    pub fn record(
        &self,
        recorder: &mut Recorder,
        control: &Control,
        cameras: &Buffer<CameraRecord>,
        camera_count: usize,
        lists: &Buffer<ViewLists>,
        order: &Buffer<u32>,
        projected: &Projected,
        pair_counts: &Buffer<u32>,
        pairs: &Pairs<'_>,
    ) {
        let push = Push {
            camera_count: camera_count as u32,
            records_max: projected.colours.len() as u32,
            pairs_max: pairs.bins.len() as u32,
        };
        let buffers = [
            ("cameras", cameras.binding()),
            ("needs", control.needs.binding()),
            ("order", order.binding()),
            ("tile_counts", projected.tile_counts.binding()),
            ("pair_counts", pair_counts.binding()),
            ("lists", lists.binding()),
            ("footprints", projected.footprints.binding()),
            ("bins", pairs.bins.binding()),
            ("records", pairs.records.binding()),
            ("arguments", control.arguments.binding()),
            ("segments", control.pair_segment.binding()),
        ];
        let offset = Arguments::PairBlocks.byte_offset();
        recorder.dispatch_indirect(&self.kernel, &buffers, bytes_of(&push), control.arguments.binding(), offset);
    }
}
