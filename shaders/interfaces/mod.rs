// Written by `make shaders` from the SPIR-V. Changes here are lost.

mod records;

pub mod begin;
pub mod blend;
pub mod composite;
pub mod count_pairs;
pub mod cull;
pub mod cull_agents;
pub mod cull_shadows;
pub mod fill_pairs;
pub mod hash_images;
pub mod key_splats;
pub mod list_lidar;
pub mod merge_lists;
pub mod plan_buckets;
pub mod plan_lists;
pub mod plan_merges;
pub mod plan_segments;
pub mod post_process;
pub mod project;
pub mod project_agents;
pub mod project_lidar;
pub mod project_lidar_agents;
pub mod relight;
pub mod scan;
pub mod sort_buckets;
pub mod split_slabs;
pub mod trace_lidar;
