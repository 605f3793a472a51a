// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Bucket, Camera, RequiredCounts};

decouplegs_gpu::shader! {
    "split_slabs", decouplegs_shaders::SPLIT_SLABS.spirv;
    entry_point: "main";
    workgroup: [(1, Some(1)), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 required: RequiredCounts, ReadWrite, None;
        1 buckets: Bucket, ReadWrite, None;
        2 pairs: [u32; 2], Read, None;
        3 other_keys: u32, Write, None;
        4 sorted_records: u32, Write, None;
        5 cameras: Camera, Read, None;
    }
    push 12 {
        0 pairs_max: u32;
        4 buckets_max: u32;
        8 camera_count: u32;
    }
    constants {
        0 RADIAL radial: bool;
        1 WORKGROUP_THREADS workgroup_threads: u32;
    }
}
