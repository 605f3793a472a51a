// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, RequiredCounts};

decouplegs_gpu::shader! {
    "list_lidar", decouplegs_shaders::LIST_LIDAR.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 64];
    bindings {
        0 cameras: Camera, Read, None;
        1 tile_lists: [u32; 2], Read, None;
        2 sorted_records: u32, Read, None;
        3 footprints: [u32; 4], Read, None;
        4 tile_words: u32, Write, None;
        5 pairs: [u32; 2], Write, None;
        6 required: RequiredCounts, ReadWrite, None;
    }
    push 16 {
        0 camera_count: u32;
        4 bin_count: u32;
        8 records_max: u32;
        12 pairs_max: u32;
    }
    constants {
        5 LANES lanes: u32;
    }
}
