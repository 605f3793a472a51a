//! CPU mirrors of the kernels, the oracle of the stage tests: sequential, f32, simple. The host
//! uses a few of them too, to decide what a frame holds: `agents.rs`, `lidar/sectors.rs`.
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
#![expect(
    clippy::too_many_arguments,
    reason = "one argument a buffer or constant of the shader"
)]

pub mod agent;
pub mod color_code;
pub mod depth_key;
pub mod fog;
pub mod footprint;
pub mod lens;
pub mod lidar;
pub mod mean_px;
pub mod output;
pub mod planes;
pub mod post_process;
pub mod projection;
pub mod record;
pub mod rolling;
pub mod sh;
pub mod shading;
pub mod shadow;
pub mod stored_splat;
pub mod visibility;

mod agents;
mod begin;
mod blend;
mod composite;
mod cull;
mod cull_shadows;
mod hash_images;
mod key_splats;
mod merge_lists;
mod plan_segments;
mod project;
mod relight;
mod scan;
mod tile_sort;
mod write_record;

pub use agents::{AgentInputs, ColorCodebooks, ListedSplats, cull_agents, project_agents};
pub use begin::begin;
pub use blend::{blend, finish_medians};
pub use composite::{Median, Unfinished, composite, composite_runs, medians};
pub use cull::{SplatBuffers, VisibleBits, cull};
pub use cull_shadows::cull_shadows;
pub use hash_images::hash_images;
pub use key_splats::key_splats;
pub use lens::cluster_overlaps_any_lens;
pub use merge_lists::{merge_lists, plan_merges};
pub use plan_segments::plan_segments;
pub use project::{ProjectBuffers, project};
pub use relight::relight;
pub use scan::scan;
pub use tile_sort::{bin_pairs, depth_slab, plan_buckets, slab_parts};
pub use visibility::cluster_overlaps;
pub use write_record::Records;
