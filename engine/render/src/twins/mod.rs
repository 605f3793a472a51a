//! CPU mirrors of the kernels, the oracle of the stage tests: sequential, f32, simple. Programs are
//! built without them (feature `twins`), except for those that the host uses too, to decide what a
//! frame holds: `agents/mod.rs`, `lidar/sectors.rs`.
//!
//! `twins/NAME.rs` computes what `shaders/NAME.comp` does. The modules `agent`, `depth_key`,
//! `footprint`, `lens`, `lidar`, `mean_px`, `output`, `planes`, `projection`, `record`, `rolling`,
//! `sh`, `shadow`, `stored_splat`, `visibility`, `color_code` and `write_record` correspond to the
//! shared GLSL of the same name. Arguments have the shader's names; outputs are written in place,
//! as there. The stage tests feed both sides the same bytes. Twins use no workgroups and no shared
//! memory.
//!
//! A twin shares the shader's formulas, so it shows that a kernel is implemented right, not that
//! the formulas are right: that is measured against [`crate::reference`].
#![cfg_attr(
    any(test, feature = "twins"),
    expect(
        clippy::too_many_arguments,
        reason = "one argument a buffer or constant of the shader"
    )
)]

#[cfg(any(test, feature = "twins"))]
pub mod agent;
#[cfg(any(test, feature = "twins"))]
pub mod color_code;
#[cfg(any(test, feature = "twins"))]
pub mod depth_key;
#[cfg(any(test, feature = "twins"))]
pub mod fog;
pub mod footprint;
pub mod lens;
pub mod lidar;
#[cfg(any(test, feature = "twins"))]
pub mod mean_px;
#[cfg(any(test, feature = "twins"))]
pub mod output;
#[cfg(any(test, feature = "twins"))]
pub mod planes;
#[cfg(any(test, feature = "twins"))]
pub mod post_process;
pub mod projection;
#[cfg(any(test, feature = "twins"))]
pub mod record;
pub mod rolling;
#[cfg(any(test, feature = "twins"))]
pub mod sh;
#[cfg(any(test, feature = "twins"))]
pub mod shading;
#[cfg(any(test, feature = "twins"))]
pub mod shadow;
#[cfg(any(test, feature = "twins"))]
pub mod stored_splat;
pub mod visibility;

#[cfg(any(test, feature = "twins"))]
mod agents;
#[cfg(any(test, feature = "twins"))]
mod begin;
#[cfg(any(test, feature = "twins"))]
mod blend;
#[cfg(any(test, feature = "twins"))]
mod composite;
#[cfg(any(test, feature = "twins"))]
mod cull;
#[cfg(any(test, feature = "twins"))]
mod cull_shadows;
#[cfg(any(test, feature = "twins"))]
mod hash_images;
#[cfg(any(test, feature = "twins"))]
mod key_splats;
#[cfg(any(test, feature = "twins"))]
mod merge_lists;
#[cfg(any(test, feature = "twins"))]
mod plan_segments;
#[cfg(any(test, feature = "twins"))]
mod project;
#[cfg(any(test, feature = "twins"))]
mod relight;
#[cfg(any(test, feature = "twins"))]
mod scan;
#[cfg(any(test, feature = "twins"))]
mod tile_sort;
#[cfg(any(test, feature = "twins"))]
mod write_record;

#[cfg(any(test, feature = "twins"))]
pub use agents::{AgentInputs, ColorCodebooks, ListedSplats, cull_agents, project_agents};
#[cfg(any(test, feature = "twins"))]
pub use begin::begin;
#[cfg(any(test, feature = "twins"))]
pub use blend::{blend, finish_medians};
#[cfg(any(test, feature = "twins"))]
pub use composite::{Median, Unfinished, composite, composite_runs, medians};
#[cfg(any(test, feature = "twins"))]
pub use cull::{SplatBuffers, VisibleBits, cull};
#[cfg(any(test, feature = "twins"))]
pub use cull_shadows::cull_shadows;
#[cfg(any(test, feature = "twins"))]
pub use hash_images::hash_images;
#[cfg(any(test, feature = "twins"))]
pub use key_splats::key_splats;
pub use lens::cluster_overlaps_any_lens;
#[cfg(any(test, feature = "twins"))]
pub use merge_lists::{merge_lists, plan_merges};
#[cfg(any(test, feature = "twins"))]
pub use plan_segments::plan_segments;
#[cfg(any(test, feature = "twins"))]
pub use project::{ProjectBuffers, project};
#[cfg(any(test, feature = "twins"))]
pub use relight::relight;
#[cfg(any(test, feature = "twins"))]
pub use scan::scan;
#[cfg(any(test, feature = "twins"))]
pub use tile_sort::{bin_pairs, depth_slab, plan_buckets, slab_parts};
pub use visibility::cluster_overlaps;
#[cfg(any(test, feature = "twins"))]
pub use write_record::Records;
