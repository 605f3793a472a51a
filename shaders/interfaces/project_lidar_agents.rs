// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Agent, Camera, Cluster, Sector};

decouplegs_gpu::shader! {
    "project_lidar_agents", decouplegs_shaders::PROJECT_LIDAR_AGENTS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 agents: Agent, Read, None;
        1 agent_cameras: Camera, Read, None;
        2 coded_splats: [u32; 3], Read, None;
        3 coded_shapes: [f32; 4], Read, None;
        4 visible_words: u32, ReadWrite, None;
        5 visible_counts: u32, ReadWrite, None;
        6 offsets: u32, Read, None;
        7 asset_clusters: Cluster, Read, None;
        8 coded_dc: [f32; 3], Read, None;
        9 static_offsets: u32, Read, None;
        11 footprints: [u32; 4], Write, None;
        12 looks: [f32; 3], Write, None;
        13 keys: u32, Write, None;
        14 lidar_shapes: [f32; 4], Write, None;
        15 sectors: Sector, Read, None;
        16 column_bounds: [f32; 2], Read, None;
        17 row_bounds: [f32; 2], Read, None;
    }
    push 20 {
        0 agent_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
        12 records_max: u32;
        16 static_lists: u32;
    }
    constants {
        1 ANTIALIAS antialias: bool;
        2 WRITE write: bool;
        20 DILATION_RAD dilation_rad: f32;
        21 MOVING moving: bool;
    }
}
