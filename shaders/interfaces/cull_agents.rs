// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Agent, Camera, Cluster, Lens};

decouplegs_gpu::shader! {
    "cull_agents", decouplegs_shaders::CULL_AGENTS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 agents: Agent, Read, None;
        1 agent_cameras: Camera, Read, None;
        2 coded_splats: [u32; 3], Read, None;
        3 coded_shapes: [f32; 4], Read, None;
        4 asset_clusters: Cluster, Read, None;
        5 visible_words: u32, Write, None;
        6 visible_counts: u32, Write, None;
        32 lenses: Lens, Read, None;
    }
    push 12 {
        0 agent_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
    }
    constants {
        0 NEAR_M near_m: f32;
        1 ANTIALIAS antialias: bool;
        16 LENSES lenses: bool;
        17 ROLLING rolling: bool;
        40 LEAST_RESPONSE least_response: bool;
        41 LEAST_RESPONSE_SQUARES least_response_squares: f32;
    }
}
