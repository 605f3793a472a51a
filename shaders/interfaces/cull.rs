// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, Cluster, DetailNode, Lens};

decouplegs_gpu::shader! {
    "cull", decouplegs_shaders::CULL.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61];
    bindings {
        0 cameras: Camera, Read, Some(9600);
        1 clusters: Cluster, Read, None;
        2 means_m: [f32; 3], Read, None;
        3 shapes: [u32; 4], Read, None;
        4 rotations: [u32; 4], Read, None;
        5 visible_words: u32, Write, None;
        6 visible_counts: u32, Write, None;
        7 nodes: DetailNode, Read, None;
        32 lenses: Lens, Read, None;
    }
    push 16 {
        0 splat_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
        12 pitch_px: f32;
    }
    constants {
        0 NEAR_M near_m: f32;
        1 ANTIALIAS antialias: bool;
        16 LENSES lenses: bool;
        17 ROLLING rolling: bool;
        23 COMPACT compact: bool;
        40 LEAST_RESPONSE least_response: bool;
        41 LEAST_RESPONSE_SQUARES least_response_squares: f32;
    }
}
