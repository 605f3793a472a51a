//! Tile binning: (coarse tile, record) pairs by depth slab, counted and then written.

use bytemuck::bytes_of;
use decouplegs_gpu::{Constant, Gpu, GpuError, Kernel, Recorder};

use super::{Records, TileSortBuffers};
use crate::stages::{FrameCounters, IndirectArguments, kernel, push_constants};

/// Purpose of a run of [`BinPairs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BinPass {
    /// Counts the pairs of each coarse tile and depth slab.
    Count,
    /// Writes them to the indices that were planned.
    Fill,
}

push_constants! {
    struct Push {
        camera_count: u32,
        records_max: u32,
        pairs_max: u32,
    }
}

/// `bin_pairs.comp`.
pub struct BinPairs {
    kernel: Kernel,
}

impl BinPairs {
    /// The stage; `radial` where keys are of distances, `lidar` where records have cells of beams
    /// instead of footprints.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, pass: BinPass, radial: bool, lidar: bool) -> Result<Self, GpuError> {
        let constants = [
            ("FILL", Constant::Bool(pass == BinPass::Fill)),
            ("RADIAL", Constant::Bool(radial)),
            ("LIDAR", Constant::Bool(lidar)),
        ];
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::BIN_PAIRS, &constants)?,
        })
    }

    /// Counts or writes the pairs of `records`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &TileSortBuffers,
    ) {
        let push = Push {
            camera_count: records.camera_count as u32,
            records_max: records.projected.room() as u32,
            pairs_max: buffers.sorted_records.len() as u32,
        };
        let bound = [
            ("cameras", records.cameras.binding()),
            ("required", counters.required.binding()),
            ("lists", buffers.lists.binding()),
            ("keys", records.projected.keys.binding()),
            ("footprints", records.projected.footprints.binding()),
            ("slab_counts", buffers.slab_counts.binding()),
            ("pairs", buffers.pairs.binding()),
        ];
        let offset = IndirectArguments::PairBlocks.byte_offset();
        recorder.dispatch_indirect(
            &self.kernel,
            &bound,
            bytes_of(&push),
            counters.arguments.binding(),
            offset,
        );
    }
}
