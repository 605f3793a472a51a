//! Sorted lists of coarse tiles: from records in any order to one front-to-back list per coarse
//! tile.
//!
//! A radix sort by the most significant digits, coarse tile and depth slab, which counts
//! ([`CountPairs`]), plans ([`PlanBuckets`]) and fills ([`FillPairs`]). Then each bucket, a run of
//! slabs, is sorted by the rest of its digits in shared memory ([`SortBuckets`]). Slabs that are
//! too long for that are cut into pieces before ([`SplitSlabs`]). All that lies between is in
//! [`TileSortBuffers`]. Who replaces the sort needs to read this folder only.

mod count_pairs;
mod fill_pairs;
mod plan_buckets;
mod plan_lists;
mod sort_buckets;
mod split_slabs;

pub use count_pairs::CountPairs;
pub use fill_pairs::FillPairs;
pub use plan_buckets::PlanBuckets;
pub use plan_lists::PlanLists;
pub use sort_buckets::SortBuckets;
pub use split_slabs::SplitSlabs;

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind, Recorder};
use decouplegs_scene::{DepthOrder, Rules};

use super::{FrameCounters, PURPOSE, Projected, SortedLists, TileLists};
use crate::capacity::Capacity;
use crate::layout::{BUCKET_PAIRS, Bucket, CameraRecord, SLABS, ViewLists, response_squares_max};

/// Lists and scratch of the sort.
#[derive(Clone)]
pub struct TileSortBuffers {
    /// First records of each camera.
    pub lists: Buffer<ViewLists>,
    /// Pairs of each `[coarse tile][depth slab]`; zero before the frame. From the plan on, the next
    /// index in the pair buffer.
    pub slab_counts: Buffer<u32>,
    /// Coarse tiles of each record, where they are few.
    pub reaches: Buffer<u32>,
    /// Records with more.
    pub large_records: Buffer<u32>,
    /// First pair and length of each coarse tile's list.
    pub tile_lists: Buffer<[u32; 2]>,
    /// Runs of pairs that are sorted one by one; from the end, depth slabs that are cut into such
    /// runs.
    pub buckets: Buffer<Bucket>,
    /// Depth key and record of each pair.
    pub pairs: Buffer<[u32; 2]>,
    /// The result: records, front to back in each coarse tile's list.
    pub sorted_records: Buffer<u32>,
}

impl TileSortBuffers {
    /// Buffers for as many pairs as `capacity` says in `bins` coarse tiles.
    ///
    /// # Errors
    /// [`GpuError`]: the device is out of memory.
    pub fn new(gpu: &Gpu, capacity: &Capacity, bins: u32) -> Result<Self, GpuError> {
        let (device, bin_count) = (MemoryKind::Device, bins as usize);
        Ok(Self {
            lists: gpu.buffer("view_lists", PURPOSE, crate::layout::CAMERAS_MAX, device)?,
            slab_counts: gpu.buffer("slab_counts", PURPOSE, bin_count * SLABS, device)?,
            reaches: gpu.buffer("reaches", PURPOSE, capacity.records, device)?,
            large_records: gpu.buffer("large_records", PURPOSE, capacity.records, device)?,
            tile_lists: gpu.buffer("tile_lists", PURPOSE, bin_count, device)?,
            buckets: gpu.buffer(
                "buckets",
                PURPOSE,
                3 * capacity.pairs / BUCKET_PAIRS + bin_count,
                device,
            )?,
            pairs: gpu.buffer("pairs", PURPOSE, capacity.pairs, device)?,
            sorted_records: gpu.buffer("sorted_records", PURPOSE, capacity.pairs, device)?,
        })
    }

    /// The lists of `bins` coarse tiles.
    pub(crate) fn lists_of(&self, bins: u32) -> TileLists<'_> {
        TileLists {
            lists: &self.tile_lists,
            count: bins,
        }
    }

    /// Size of the slab counts of `bins` coarse tiles, bytes.
    pub(crate) fn slab_bytes(bins: u32) -> u64 {
        4 * u64::from(bins) * SLABS as u64
    }
}

/// Records to be sorted.
#[derive(Clone, Copy)]
pub struct Records<'a> {
    /// The frame's cameras.
    pub cameras: &'a Buffer<CameraRecord>,
    /// Number of cameras.
    pub camera_count: usize,
    /// Footprints and depth keys of the records.
    pub projected: &'a Projected,
    /// Records of the background before each `[camera][cluster]`, and their total.
    pub static_offsets: &'a Buffer<u32>,
    /// Clusters of the background.
    pub static_clusters: usize,
    /// Records of agents before each `[camera][cluster]`, and their total.
    pub moving_offsets: &'a Buffer<u32>,
    /// Clusters of agents; with none, records of the background alone are sorted.
    pub moving_clusters: usize,
    /// True if records of agents alone are sorted.
    pub moving_only: bool,
    /// Keys of pairs while they are sorted, as long as the list of pairs. Mostly the keys of the
    /// records themselves, which are then overwritten.
    pub other_keys: &'a Buffer<u32>,
}

/// Kind of records that are listed.
#[derive(Clone, Copy, Debug)]
pub struct RecordKind {
    /// True where keys are of distances.
    pub radial: bool,
    /// True where records have cells of beams instead of footprints.
    pub lidar: bool,
    /// Largest sum of squares at a pixel that a splat adds to.
    pub squares_max: f32,
}

/// The stages of the sort.
pub struct TileSort {
    plan_lists: PlanLists,
    count: CountPairs,
    plan_buckets: PlanBuckets,
    fill: FillPairs,
    split: SplitSlabs,
    sort: SortBuckets,
}

impl TileSort {
    /// The stages for depth keys as `rules` define them.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses a kernel.
    pub fn new(gpu: &Gpu, rules: &Rules) -> Result<Self, GpuError> {
        let kind = RecordKind {
            radial: rules.order == DepthOrder::Radial,
            lidar: false,
            squares_max: response_squares_max(rules),
        };
        Self::of_records(gpu, kind)
    }

    /// The stages for the records of a LiDAR, by distance.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses a kernel.
    pub fn for_lidar(gpu: &Gpu) -> Result<Self, GpuError> {
        let kind = RecordKind {
            radial: true,
            lidar: true,
            squares_max: f32::INFINITY,
        };
        Self::of_records(gpu, kind)
    }

    fn of_records(gpu: &Gpu, kind: RecordKind) -> Result<Self, GpuError> {
        let radial = kind.radial;
        Ok(Self {
            plan_lists: PlanLists::new(gpu)?,
            count: CountPairs::new(gpu, kind)?,
            plan_buckets: PlanBuckets::new(gpu)?,
            fill: FillPairs::new(gpu, kind)?,
            split: SplitSlabs::new(gpu, radial)?,
            sort: SortBuckets::new(gpu, radial)?,
        })
    }

    /// Writes the sorted lists of `bins` coarse tiles to `buffers`, and returns them.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        records: Records<'_>,
        buffers: &'a TileSortBuffers,
        bins: u32,
    ) -> SortedLists<'a> {
        recorder.stage("bin", |r| {
            self.plan_lists.record(r, counters, records, buffers);
            self.count.record(r, counters, records, buffers);
            self.plan_buckets.record(r, counters, buffers, bins);
            self.fill.record(r, counters, records, buffers);
        });
        recorder.stage("sort", |r| {
            self.split.record(r, counters, records, buffers);
            self.sort.record(r, counters, records, buffers);
        });
        SortedLists {
            lists: buffers.lists_of(bins),
            records: &buffers.sorted_records,
        }
    }
}
