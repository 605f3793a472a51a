// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, RequiredCounts, ViewLists};

decouplegs_gpu::shader! {
    "count_pairs", decouplegs_shaders::COUNT_PAIRS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 cameras: Camera, Read, None;
        1 required: RequiredCounts, ReadWrite, None;
        2 lists: ViewLists, Read, None;
        3 keys: u32, Read, None;
        4 footprints: [u32; 4], Read, None;
        5 slab_counts: u32, ReadWrite, None;
        6 reaches: u32, Write, None;
        7 large_records: u32, Write, None;
    }
    push 8 {
        0 camera_count: u32;
        4 records_max: u32;
    }
    constants {
        1 RADIAL radial: bool;
        2 LIDAR lidar: bool;
        40 LEAST_RESPONSE least_response: bool;
        41 LEAST_RESPONSE_SQUARES least_response_squares: f32;
    }
}
