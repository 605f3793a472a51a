//! The stages of a frame. A stage of one kernel shares its stem with it: `shaders/NAME.comp`,
//! `stages/NAME.rs`, its twin in `twins/NAME.rs` and a case in `tests/stages/`. Four have several
//! kernels: `agents`, `lidar`, `merge_lists` and `tile_sort`. Kernels are built once, buffers once
//! per capacity, commands every frame.
//!
//! Each stage takes the buffers that it reads and those that it writes, which are made beforehand,
//! records its commands, and returns what it wrote: the next stage takes it.

mod agents;
mod begin;
mod blend;
mod composite;
mod cull;
mod cull_shadows;
mod hash_images;
mod key_splats;
mod lidar;
mod merge_lists;
mod plan_segments;
mod post_process;
mod project;
mod relight;
mod scan;
mod staged;
mod tile_sort;

pub use agents::{AgentBuffers, AgentCounts, AgentVariant, CullAgents, ProjectAgents, SeenAgents};
pub use begin::{Begin, Counted, FrameData, HostWritten};
pub use blend::{
    Blend, BlendPass, BlendVariant, ListedSplats, PartialResults, PixelEnd, Segments, Target,
    finishes,
};
pub use composite::CompositeSegments;
pub use cull::{Cull, Visible};
pub use cull_shadows::{CullShadows, ShadowBuffers, words_for};
pub use hash_images::{HashImages, HashedImage, ImageSums, LANES};
pub(crate) use hash_images::{PIECE_BYTES, pieces, units_of, units_of_piece};
pub use key_splats::{KeptKeys, KeySplats, WantedKeys};
pub use lidar::{
    LidarAgents, LidarBuffers, LidarPass, LidarRoom, LidarVariant, ListLidar, ProjectLidar,
    ProjectLidarAgents, SectorBuffers, SectorTables, TraceLidar, beam_lanes,
};
pub use merge_lists::{DrawnAlone, MergeBuffers, MergeLists};
pub use plan_segments::{Plan, PlanSegments, SortedLists, TileLists};
pub use post_process::{PostProcess, PostProcessInputs};
pub use project::{Project, ProjectInputs, ProjectVariant, Projected, RecordContents};
pub use relight::{RELIGHT_BLOCK, Relight, RelightWork, RelitColors};
pub use scan::Scan;
pub use staged::Staged;
pub use tile_sort::{
    CountPairs, FillPairs, PlanBuckets, PlanLists, RecordKind, Records, SortBuckets, SplitSlabs,
    TileSort, TileSortBuffers,
};

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind};
use decouplegs_shaders::constants;

use crate::layout::{ARGUMENT_SETS, CameraRecord, LensRecord, RequiredCounts};

/// Purpose under which the memory of a frame's lists is counted.
pub const PURPOSE: &str = "frame";

/// The counts that a frame finds and the sizes of the dispatches that follow from them.
pub struct FrameCounters {
    /// One [`RequiredCounts`].
    pub required: Buffer<RequiredCounts>,
    /// Arguments of the indirect dispatches.
    pub arguments: Buffer<[u32; 3]>,
}

impl FrameCounters {
    /// Buffers for one frame.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            required: gpu.buffer("required", PURPOSE, 1, MemoryKind::Device)?,
            arguments: gpu.buffer("arguments", PURPOSE, ARGUMENT_SETS, MemoryKind::Device)?,
        })
    }
}

/// Cameras of a frame, on the device.
#[derive(Clone, Copy)]
pub struct Views<'a> {
    /// The cameras, as long as a uniform buffer of kernels ([`crate::layout::CAMERAS_MAX`]).
    pub cameras: &'a Buffer<CameraRecord>,
    /// One per camera, where some camera is no pinhole.
    pub lenses: &'a Buffer<LensRecord>,
    /// Number of cameras.
    pub count: usize,
}

/// Indirect dispatches, by their index in [`FrameCounters::arguments`]; the twins of `ARGUMENTS_*`
/// in `frame.glsl`.
#[derive(Clone, Copy, Debug)]
pub enum IndirectArguments {
    /// Blocks of records to be binned.
    PairBlocks = constants::ARGUMENTS_PAIR_BLOCKS as isize,
    /// Segments to be blended.
    Blend = constants::ARGUMENTS_BLEND as isize,
    /// Cut coarse tiles to be joined.
    Composite = constants::ARGUMENTS_COMPOSITE as isize,
    /// Depth slabs to be cut into pieces.
    Split = constants::ARGUMENTS_SPLIT as isize,
    /// Records whose pairs are written.
    Fill = constants::ARGUMENTS_FILL as isize,
    /// Buckets to be sorted.
    Sort = constants::ARGUMENTS_SORT as isize,
    /// Pieces of lists to be merged.
    Merge = constants::ARGUMENTS_MERGE as isize,
}

impl IndirectArguments {
    /// Offset in bytes.
    #[must_use]
    pub fn byte_offset(self) -> u64 {
        self as u64 * 12
    }
}

/// Specialization of a projection to the cameras of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CameraVariant {
    /// True if some camera is not a pinhole.
    pub lenses: bool,
    /// True if splats move in some image while it is exposed.
    pub rolling: bool,
}

impl CameraVariant {
    /// The variant for the cameras of a frame, as the splats' frame has them, and their lenses.
    #[must_use]
    pub fn for_cameras(cameras: &[CameraRecord], lenses: &[LensRecord]) -> Self {
        Self {
            lenses: !lenses.is_empty(),
            rolling: cameras.iter().any(CameraRecord::rolls),
        }
    }
}

/// True, and the sum, where splats add to pixels up to a sum of squares; else false and 0
/// ([`crate::layout::response_squares_max`]).
fn least_response(squares_max: f32) -> (bool, f32) {
    match squares_max.is_finite() {
        true => (true, squares_max),
        false => (false, 0.0),
    }
}
