//! Lists of splats, their parts and what blending leaves between them: structures of `frame.glsl`.

use bytemuck::{Pod, Zeroable};
use decouplegs_shaders::constants;

/// `RequiredCounts` of `frame.glsl`: how many of each were wanted, whatever the capacity.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable, serde::Serialize)]
pub struct RequiredCounts {
    /// Visible (camera, splat).
    pub records: u32,
    /// (Coarse tile, record); `u32::MAX` where there are more.
    pub pairs: u32,
    /// Checksum of the pairs: the sum of the lower 16 bits of each coarse tile's number.
    pub pairs_low: u32,
    /// Checksum of the pairs: the sum of the upper 16 bits of each coarse tile's number.
    pub pairs_high: u32,
    /// Records with more coarse tiles than a word says.
    pub large: u32,
    /// Buckets of pairs, sorted one by one.
    pub buckets: u32,
    /// Depth slabs that are cut into pieces before they are sorted.
    pub long_slabs: u32,
    /// Pieces of those, at most; they become buckets too.
    pub pieces: u32,
    /// Coarse tiles whose buckets are planned.
    pub planned: u32,
    /// (Coarse tile, segment of its list).
    pub items: u32,
    /// Items of coarse tiles that were cut into more than one segment.
    pub partials: u32,
    /// Coarse tiles that were cut.
    pub composites: u32,
    /// Pairs of the coarse tile that has most.
    pub longest: u32,
    /// Fine tiles with partial results, at most in any blending of the frame.
    pub tiles: u32,
    /// Fine tiles with partial results of the last blending. The kernel counts with it.
    pub next_tile: u32,
    /// First record that is binned: that of the agents where lists of the background are kept.
    pub first_binned: u32,
    /// Pieces of merged lists.
    pub merges: u32,
}

/// `Bucket` of `frame.glsl`: a run of one coarse tile's pairs that is sorted by itself.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
pub struct Bucket {
    /// First pair.
    pub first_pair: u32,
    /// Number of entries.
    pub pairs: u32,
    /// Coarse tile, or [`NO_BIN`] where the bucket is a piece of a depth slab.
    pub bin: u32,
    /// Index of the workgroup among those that share a slab that is cut; 0 elsewhere.
    pub part: u32,
}

/// The bucket is a piece of a depth slab.
pub const NO_BIN: u32 = constants::NO_BIN;

/// `MergePiece` of `frame.glsl`: a run of one coarse tile's merged list.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MergePiece {
    /// Coarse tile.
    pub bin: u32,
    /// Index of the run in the list.
    pub piece: u32,
}

/// Length of the list of a coarse tile that is not blended: its pixels are in the image already.
pub const NOT_BLENDED: u32 = constants::NOT_BLENDED;

/// `ViewLists` of `frame.glsl`: first records of a camera.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ViewLists {
    /// First record of the background.
    pub first_static: u32,
    /// First record of the agents.
    pub first_moving: u32,
}

/// `BlendItem` of `frame.glsl`: one segment of one coarse tile's list.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct BlendItem {
    /// Coarse tile.
    pub bin: u32,
    /// First entry of the segment in the sorted pairs.
    pub first_pair: u32,
    /// Number of entries.
    pub pairs: u32,
    /// Slot of its partial result, or [`NO_PARTIAL`].
    pub partial: u32,
    /// Index in its coarse tile's list; the slots before it belong to the segments before it.
    pub segment: u32,
}

/// The segment is its tile's only one and writes pixels itself.
pub const NO_PARTIAL: u32 = constants::NO_PARTIAL;

/// `PartialTiles` of `frame.glsl`: the fine tiles of a segment that have a partial result.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PartialTiles {
    /// Index of the first among the results of all segments; the others follow.
    pub first: u32,
    /// One bit per fine tile.
    pub tiles: u32,
}

/// `Composite` of `frame.glsl`: a coarse tile whose partial results are joined, or a part of its
/// pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Composite {
    /// Coarse tile.
    pub bin: u32,
    /// First partial result.
    pub first_partial: u32,
    /// Number of partial results.
    pub partials: u32,
    /// The part of its pixels, of as many as `twins::composite_runs` says.
    pub part: u32,
}
