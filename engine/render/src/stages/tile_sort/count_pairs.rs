//! Tile binning: (coarse tile, record) pairs by depth slab, counted.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{RecordKind, Records, TileSortBuffers};
use crate::interfaces::count_pairs::{Bindings, Constants, Module, Push};
use crate::stages::{FrameCounters, IndirectArguments, least_response};

/// `count_pairs.comp`.
pub struct CountPairs {
    kernel: Kernel<Module>,
}

impl CountPairs {
    /// The stage for records of one kind.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu, kind: RecordKind) -> Result<Self, GpuError> {
        let (least_response, least_response_squares) = least_response(kind.squares_max);
        let constants = Constants {
            radial: kind.radial,
            lidar: kind.lidar,
            least_response,
            least_response_squares,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Counts the pairs of `records`, and finds the coarse tiles of each.
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
        };
        let bindings = Bindings {
            cameras: records.cameras.bound(),
            required: counters.required.bound(),
            lists: buffers.lists.bound(),
            keys: records.projected.keys.bound(),
            footprints: records.projected.footprints.bound(),
            slab_counts: buffers.slab_counts.bound(),
            reaches: buffers.reaches.bound(),
            large_records: buffers.large_records.bound(),
        };
        let offset = IndirectArguments::PairBlocks.byte_offset();
        recorder.dispatch_indirect(&self.kernel, bindings, push, &counters.arguments, offset);
    }
}
