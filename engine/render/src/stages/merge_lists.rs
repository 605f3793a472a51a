//! Kept lists of the background, merged with those of the agents.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::{FrameCounters, IndirectArguments, Projected, SortedLists, TileLists, TileSortBuffers};
use crate::capacity::Capacity;
use crate::interfaces::{merge_lists, plan_merges};
use crate::layout::{MERGE_PAIRS, MergePiece, RequiredCounts};

/// Purpose under which the memory of kept lists is counted.
const KEPT_PURPOSE: &str = "kept lists";

/// Kept lists of the background, and what is merged of them and of agents.
pub struct MergeBuffers {
    /// Records of the background, front to back by coarse tile, and behind them, from half of the
    /// buffer on, those of merged lists.
    pub sorted_records: Buffer<u32>,
    /// First pair and length of each kept list.
    pub kept_lists: Buffer<[u32; 2]>,
    /// Counts of the sort of the background.
    pub kept_required: Buffer<RequiredCounts>,
    /// First pair and length of each list to be blended. Its length is
    /// [`crate::layout::NOT_BLENDED`] where the image has its pixels already.
    pub merged_lists: Buffer<[u32; 2]>,
    /// Runs of merged lists.
    pub pieces: Buffer<MergePiece>,
    /// Keys of pairs while they are sorted: those of the records are needed to merge.
    pub other_keys: Buffer<u32>,
}

impl MergeBuffers {
    /// Buffers for as many pairs as `capacity` says in `bins` coarse tiles.
    ///
    /// # Errors
    /// [`GpuError`]: the device is out of memory, or cannot address as much.
    pub fn new(gpu: &Gpu, capacity: &Capacity, bins: u32) -> Result<Self, GpuError> {
        let (device, bin_count) = (MemoryKind::Device, bins as usize);
        let pieces = capacity.pairs / MERGE_PAIRS + bin_count;
        Ok(Self {
            sorted_records: gpu.buffer(
                "merged_records",
                KEPT_PURPOSE,
                2 * capacity.pairs,
                device,
            )?,
            kept_lists: gpu.buffer("kept_lists", KEPT_PURPOSE, bin_count, device)?,
            kept_required: gpu.buffer("kept_required", KEPT_PURPOSE, 1, device)?,
            merged_lists: gpu.buffer("merged_lists", KEPT_PURPOSE, bin_count, device)?,
            pieces: gpu.buffer("merge_pieces", KEPT_PURPOSE, pieces, device)?,
            other_keys: gpu.buffer("other_keys", KEPT_PURPOSE, capacity.pairs, device)?,
        })
    }

    /// Size of the buffers, bytes.
    pub(crate) fn bytes(capacity: &Capacity, bins: u32) -> u64 {
        12 * capacity.pairs as u64 + 24 * u64::from(bins)
    }

    /// Buffers of a sort whose result are the kept lists, with the scratch of `sort`.
    #[must_use]
    pub fn kept_sort(&self, sort: &TileSortBuffers) -> TileSortBuffers {
        TileSortBuffers {
            sorted_records: self.sorted_records.clone(),
            tile_lists: self.kept_lists.clone(),
            ..sort.clone()
        }
    }

    /// The merged lists of `bins` coarse tiles.
    pub(crate) fn lists_of(&self, bins: u32) -> TileLists<'_> {
        TileLists {
            lists: &self.merged_lists,
            count: bins,
        }
    }
}

/// Coarse tiles of an image that were drawn from kept lists without agents.
#[derive(Clone, Copy)]
pub struct DrawnAlone<'a> {
    /// 1 for each such coarse tile, else 0; of length 0 where all coarse tiles are to be blended.
    pub tiles: &'a Buffer<u32>,
    /// True if the image was drawn from the same kept lists.
    pub holds: bool,
}

/// `plan_merges.comp` and `merge_lists.comp`.
pub struct MergeLists {
    plan: Kernel<plan_merges::Module>,
    merge: Kernel<merge_lists::Module>,
}

impl MergeLists {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses a kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            plan: gpu.kernel(&plan_merges::Constants {})?,
            merge: gpu.kernel(&merge_lists::Constants {})?,
        })
    }

    /// Plans the merged lists: kept ones and those of agents, which `moving` holds for as many
    /// coarse tiles as it says. Adds the pairs of the kept lists to the counts.
    pub fn record_plan(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        moving: TileLists<'_>,
        buffers: &MergeBuffers,
        drawn: DrawnAlone<'_>,
    ) {
        let push = plan_merges::Push {
            bin_count: moving.count,
            pairs_max: buffers.other_keys.len() as u32,
            pieces_max: buffers.pieces.len() as u32,
            drawn_count: moving.count.min(drawn.tiles.len() as u32),
            drawn_holds: u32::from(drawn.holds),
        };
        let bindings = plan_merges::Bindings {
            required: counters.required.bound(),
            kept_required: buffers.kept_required.bound(),
            kept_lists: buffers.kept_lists.bound(),
            moving_lists: moving.lists.bound(),
            merged_lists: buffers.merged_lists.bound(),
            pieces: buffers.pieces.bound(),
            arguments: counters.arguments.bound(),
            drawn_alone: drawn.tiles.bound(),
        };
        let groups = [moving.count.div_ceil(256), 1, 1];
        recorder.dispatch(&self.plan, bindings, push, groups);
    }

    /// Merges the lists of `moving`, those of agents, with kept ones as it was planned, and returns
    /// what is to be blended. Their records are `projected`.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        moving: SortedLists<'_>,
        projected: &Projected,
        buffers: &'a MergeBuffers,
    ) -> SortedLists<'a> {
        let push = merge_lists::Push {
            pieces_max: buffers.pieces.len() as u32,
        };
        let bindings = merge_lists::Bindings {
            required: counters.required.bound(),
            kept_lists: buffers.kept_lists.bound(),
            moving_lists: moving.lists.lists.bound(),
            merged_lists: buffers.merged_lists.bound(),
            pieces: buffers.pieces.bound(),
            moving_records: moving.records.bound(),
            keys: projected.keys.bound(),
            sorted_records: buffers.sorted_records.bound(),
        };
        let offset = IndirectArguments::Merge.byte_offset();
        recorder.dispatch_indirect(&self.merge, bindings, push, &counters.arguments, offset);
        SortedLists {
            lists: buffers.lists_of(moving.lists.count),
            records: &buffers.sorted_records,
        }
    }
}
