// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Bucket, Camera, RequiredCounts};

decouplegs_gpu::shader! {
    "sort_buckets", decouplegs_shaders::SORT_BUCKETS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 required: RequiredCounts, Read, None;
        1 buckets: Bucket, Read, None;
        2 pairs: [u32; 2], ReadWrite, None;
        3 other_keys: u32, ReadWrite, None;
        4 sorted_records: u32, ReadWrite, None;
        5 cameras: Camera, Read, None;
        6 slab_ends: u32, Read, None;
    }
    push 8 {
        0 pairs_max: u32;
        4 camera_count: u32;
    }
    constants {
        0 RADIAL radial: bool;
    }
}
