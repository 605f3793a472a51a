//! The buffers of a frame that only the device sees, and what their size depends on.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Residence};

use crate::capacity::{Capacity, SortShape};
use crate::layout::{CameraRecord, LensRecord, SortSegment};
use crate::options::RenderOptions;
use crate::stages::{Control, OrderPlan, PURPOSE, Partials, Plan, Projected, RankLists, SortScratch, StaticLists, Visible};

/// What the size of a frame's buffers depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameShape {
    pub capacity: Capacity,
    pub cameras: usize,
    /// Splats of the background.
    pub splats: usize,
    /// Its chunks.
    pub chunks: usize,
    pub bins: u32,
    /// Whether orders are kept.
    pub ranked: bool,
}

impl FrameShape {
    /// Whether buffers of this shape serve a frame of shape `other`.
    pub fn covers(&self, other: &Self) -> bool {
        self.capacity == other.capacity && self.with(other) == *self
    }

    /// The smallest shape, with the capacity of `other`, that covers both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            capacity: other.capacity,
            cameras: self.cameras.max(other.cameras),
            splats: self.splats.max(other.splats),
            chunks: self.chunks.max(other.chunks),
            bins: self.bins.max(other.bins),
            ranked: self.ranked || other.ranked,
        }
    }
}

/// All splats of a background, as the radix sort takes them.
pub(crate) struct AllSplats {
    splats: usize,
    pub segment: Buffer<SortSegment>,
    /// The workgroups that the sort needs for them.
    pub blocks: Buffer<[u32; 3]>,
}

impl AllSplats {
    fn new(gpu: &Gpu, splats: usize, sort: SortShape) -> Result<Self, GpuError> {
        let all = SortSegment { first: 0, count: splats as u32, first_block: 0 };
        let blocks = crate::capacity::groups_for(splats.div_ceil(sort.block() as usize));
        let segment = gpu.upload("all_splats", PURPOSE, &[all])?;
        Ok(Self { splats, segment, blocks: gpu.upload("all_splat_blocks", PURPOSE, &[blocks])? })
    }
}

/// Backgrounds that frames may take turns with before they wait for a small upload.
const WORLDS_REMEMBERED: usize = 16;

/// The buffers of a frame that only the device sees: frames in flight share them, as they run one after the other.
pub(crate) struct FrameBuffers {
    /// What they are made for: as many cameras, splats and so on at most, so that frames that take turns share them.
    room: FrameShape,
    /// The frame that is recorded.
    pub shape: FrameShape,
    pub control: Control,
    pub cameras: Buffer<CameraRecord>,
    pub lenses: Buffer<LensRecord>,
    pub visible: Visible,
    pub firsts: Buffer<u32>,
    pub rank_lists: RankLists,
    pub order_plan: OrderPlan,
    /// All splats of a background, by their number: that of the frame is the first.
    pub all_splats: Vec<AllSplats>,
    pub projected: Projected,
    /// First records by depth, then pairs by macro tile.
    pub sort: SortScratch,
    pub pair_counts: Buffer<u32>,
    pub range_firsts: Buffer<u32>,
    pub plan: Plan,
    pub partials: Partials,
}

impl FrameBuffers {
    pub fn new(gpu: &Gpu, shape: FrameShape, options: &RenderOptions, sort: SortShape) -> Result<Self, GpuError> {
        let FrameShape { capacity, cameras, splats, chunks, bins, ranked } = shape;
        let device = Residence::Device;
        let keys = capacity.records.max(capacity.pairs).max(if ranked { splats } else { 0 });
        Ok(Self {
            room: shape,
            shape,
            control: Control::new(gpu)?,
            cameras: gpu.buffer("cameras", PURPOSE, cameras, device)?,
            lenses: gpu.buffer("lenses", PURPOSE, cameras, device)?,
            visible: Visible::new(gpu, cameras, chunks)?,
            firsts: gpu.buffer("firsts", PURPOSE, cameras * chunks + 1, device)?,
            rank_lists: if ranked { RankLists::new(gpu, cameras, chunks)? } else { RankLists::new(gpu, 0, 0)? },
            order_plan: OrderPlan::new(gpu)?,
            all_splats: vec![AllSplats::new(gpu, splats, sort)?],
            projected: Projected::new(gpu, capacity.records)?,
            sort: SortScratch::new(gpu, sort, keys)?,
            pair_counts: gpu.buffer("pair_counts", PURPOSE, capacity.pair_blocks(), device)?,
            range_firsts: gpu.buffer("range_firsts", PURPOSE, bins as usize + 1, device)?,
            plan: Plan::new(gpu, &capacity, bins)?,
            partials: Partials::new(gpu, capacity.partials, &options.rules, &options.outputs)?,
        })
    }

    /// Makes them those of a frame of `shape`, which they cover.
    pub fn set(&mut self, gpu: &Gpu, shape: FrameShape, sort: SortShape) -> Result<(), GpuError> {
        match self.all_splats.iter().position(|all| all.splats == shape.splats) {
            Some(place) => self.all_splats.swap(0, place),
            None => {
                self.all_splats.truncate(WORLDS_REMEMBERED - 1);
                self.all_splats.insert(0, AllSplats::new(gpu, shape.splats, sort)?);
            }
        }
        self.shape = shape;
        Ok(())
    }

    /// What they are made for.
    pub fn room(&self) -> &FrameShape {
        &self.room
    }

    /// The lists of the background, as the repair of orders takes them.
    pub fn static_lists(&self) -> StaticLists<'_> {
        StaticLists {
            camera_count: self.shape.cameras,
            chunk_count: self.shape.chunks,
            firsts: &self.firsts,
            records_max: self.shape.capacity.records,
        }
    }
}
