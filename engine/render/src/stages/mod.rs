//! The stages of a frame. A stage of one kernel shares its stem with it: `shaders/NAME.comp`,
//! `stages/NAME.rs`, its twin in `twins/NAME.rs` and a case in `tests/stages/`. Four have several
//! kernels: `agents`, `lidar`, `merge_lists` and `tile_sort`. Kernels are built once, buffers once
//! per capacity, commands every frame.
//!
//! Each stage takes the buffers it reads and returns nothing but commands: what it writes is a
//! named struct of buffers, made beforehand, that the next stage takes.

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
pub use plan_segments::{Plan, PlanSegments, TileLists};
pub use post_process::{PostProcess, PostProcessInputs};
pub use project::{Project, ProjectInputs, ProjectVariant, Projected, RecordContents};
pub use relight::{RELIGHT_BLOCK, Relight, RelightWork, RelitColors};
pub use scan::Scan;
pub use staged::Staged;
pub use tile_sort::{
    CountPairs, FillPairs, PlanBuckets, PlanLists, RecordKind, Records, SortBuckets, SplitSlabs,
    TileSort, TileSortBuffers,
};

use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Member, MemoryKind};
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

/// Members of a kernel's push constants: names and byte offsets, in order.
trait PushConstants: bytemuck::Pod {
    const MEMBERS: &'static [(&'static str, usize)];
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

    /// Specialization constants of the kernels.
    fn constants(self) -> [(&'static str, Constant); 2] {
        [
            ("LENSES", Constant::Bool(self.lenses)),
            ("ROLLING", Constant::Bool(self.rolling)),
        ]
    }
}

/// Declares the push constants of a kernel. [`kernel`] compares them with the shader's.
macro_rules! push_constants {
    (struct $name:ident { $($member:ident: $type:ty,)* }) => {
        #[repr(C)]
        #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
        struct $name {
            $($member: $type,)*
        }

        impl crate::stages::PushConstants for $name {
            const MEMBERS: &'static [(&'static str, usize)] = &[$((stringify!($member), std::mem::offset_of!($name, $member)),)*];
        }
    };
}
use push_constants;

/// For kernels without push constants.
type NoPush = ();

impl PushConstants for NoPush {
    const MEMBERS: &'static [(&'static str, usize)] = &[];
}

/// Specialization constants of rules whose splats add to pixels up to a sum of squares
/// ([`crate::layout::response_squares_max`]).
fn least_response(squares_max: f32) -> [(&'static str, Constant); 2] {
    let bounded = squares_max.is_finite();
    let squares = if bounded { squares_max } else { 0.0 };
    [
        ("LEAST_RESPONSE", Constant::Bool(bounded)),
        ("LEAST_RESPONSE_SQUARES", Constant::F32(squares)),
    ]
}

/// Builds `shader`, whose push constants are `P`.
///
/// # Errors
/// [`GpuError`]: the driver refuses it, or the shader declares other push constants than the host.
fn kernel<P: PushConstants>(
    gpu: &Gpu,
    shader: &'static decouplegs_shaders::Kernel,
    constants: &[(&str, Constant)],
) -> Result<Kernel, GpuError> {
    let kernel = gpu.kernel(shader.name, shader.spirv, constants)?;
    match push_fault::<P>(kernel.push_members(), kernel.push_bytes()) {
        Some(reason) => Err(GpuError::Kernel {
            kernel: shader.name,
            reason,
        }),
        None => Ok(kernel),
    }
}

/// Difference between the push constants of host and shader, if there is one.
fn push_fault<P: PushConstants>(members: &[Member], bytes: u32) -> Option<String> {
    let shader = members
        .iter()
        .map(|member| (&*member.name, member.offset as usize));
    let same = shader.eq(P::MEMBERS.iter().copied()) && bytes as usize == size_of::<P>();
    (!same).then(|| {
        let (host, host_bytes) = (P::MEMBERS, size_of::<P>());
        format!("push constants are {members:?} of {bytes} bytes in the shader, and {host:?} of {host_bytes} bytes on the host")
    })
}

#[cfg(test)]
mod tests {
    use super::{Member, push_fault};

    push_constants! {
        struct Push {
            sky: [f32; 3],
            count: u32,
        }
    }

    #[test]
    fn other_push_constants_are_refused() {
        let members = |members: [(&'static str, u32); 2]| {
            members.map(|(name, offset)| Member {
                name: name.into(),
                holds: "u32".into(),
                offset,
            })
        };
        assert_eq!(
            push_fault::<Push>(&members([("sky", 0), ("count", 12)]), 16),
            None
        );
        for (wrong, bytes) in [
            ([("sky", 0), ("count", 16)], 20),
            ([("sky", 0), ("sum", 12)], 16),
            ([("count", 12), ("sky", 0)], 16),
            ([("sky", 0), ("count", 12)], 32),
        ] {
            assert!(
                push_fault::<Push>(&members(wrong), bytes)
                    .unwrap()
                    .contains("on the host"),
                "{wrong:?}"
            );
        }
        assert!(push_fault::<()>(&members([("sky", 0), ("count", 12)]), 16).is_some());
    }
}
