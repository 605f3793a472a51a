//! The buffers of a frame that only the device sees, and what their size depends on.

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind};

use crate::capacity::Capacity;
use crate::kept_lists::KeptLists;
use crate::layout::{CAMERAS_MAX, CameraRecord, LensRecord};
use crate::options::RenderOptions;
use crate::post_processing::PhotometryRecord;
use crate::stages::{
    FrameCounters, PURPOSE, PartialResults, Plan, Projected, RecordContents, TileSortBuffers,
    Visible,
};

/// Counts that determine the size of a frame's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameShape {
    pub capacity: Capacity,
    pub cameras: usize,
    /// Clusters of the background.
    pub clusters: usize,
    pub bins: u32,
    /// Pixels whose splats are blended before post-processing; 0 without it.
    pub blended_pixels: usize,
}

impl FrameShape {
    /// True if buffers of this shape can serve a frame of shape `other`.
    pub fn covers(&self, other: &Self) -> bool {
        self.capacity == other.capacity && self.with(other) == *self
    }

    /// The smallest shape, with the capacity of `other`, that covers both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            capacity: other.capacity,
            cameras: self.cameras.max(other.cameras),
            clusters: self.clusters.max(other.clusters),
            bins: self.bins.max(other.bins),
            blended_pixels: self.blended_pixels.max(other.blended_pixels),
        }
    }
}

/// The buffers of a frame that only the device sees: frames in flight share them, as they run one
/// after the other.
pub(crate) struct FrameBuffers {
    /// Shape that the buffers were allocated for: upper limits of cameras, splats and so on, so
    /// that different frames can share them.
    room: FrameShape,
    /// The frame that is recorded.
    pub shape: FrameShape,
    pub counters: FrameCounters,
    pub cameras: Buffer<CameraRecord>,
    pub lenses: Buffer<LensRecord>,
    pub visible: Visible,
    pub offsets: Buffer<u32>,
    /// The set of each camera in the persistent key buffer.
    pub key_sets: Buffer<u32>,
    pub projected: Projected,
    pub tile_sort: TileSortBuffers,
    pub plan: Plan,
    pub partials: PartialResults,
    /// Color of splats over black, and alpha, that is post-processed.
    pub blended: Buffer<[f32; 4]>,
    pub photometry: Buffer<PhotometryRecord>,
    pub kept_lists: KeptLists,
}

impl FrameBuffers {
    pub fn new(gpu: &Gpu, shape: FrameShape, options: &RenderOptions) -> Result<Self, GpuError> {
        let FrameShape {
            capacity,
            cameras,
            clusters,
            bins,
            blended_pixels,
        } = shape;
        let device = MemoryKind::Device;
        Ok(Self {
            room: shape,
            shape,
            counters: FrameCounters::new(gpu)?,
            cameras: gpu.buffer("cameras", PURPOSE, CAMERAS_MAX, device)?,
            lenses: gpu.buffer("lenses", PURPOSE, cameras, device)?,
            visible: Visible::new(gpu, cameras, clusters)?,
            offsets: gpu.buffer("offsets", PURPOSE, cameras * clusters + 1, device)?,
            key_sets: gpu.buffer("key_sets", PURPOSE, CAMERAS_MAX, device)?,
            projected: Projected::new(
                gpu,
                capacity.records,
                capacity.pairs,
                RecordContents::for_outputs(&options.outputs),
            )?,
            tile_sort: TileSortBuffers::new(gpu, &capacity, bins)?,
            plan: Plan::new(gpu, &capacity, bins)?,
            partials: PartialResults::new(gpu, &capacity, &options.rules, &options.outputs)?,
            blended: gpu.buffer("blended", PURPOSE, blended_pixels, device)?,
            photometry: gpu.buffer("photometry", PURPOSE, cameras, device)?,
            kept_lists: KeptLists::default(),
        })
    }

    /// Shape that the buffers were allocated for.
    pub fn room(&self) -> &FrameShape {
        &self.room
    }
}
