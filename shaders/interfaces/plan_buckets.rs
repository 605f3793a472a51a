// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Bucket, RequiredCounts};

decouplegs_gpu::shader! {
    "plan_buckets", decouplegs_shaders::PLAN_BUCKETS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 required: RequiredCounts, ReadWrite, None;
        1 slab_counts: [u32; 4], ReadWrite, None;
        2 tile_lists: [u32; 2], Write, None;
        3 buckets: Bucket, Write, None;
        4 arguments: [u32; 3], Write, None;
    }
    push 16 {
        0 bin_count: u32;
        4 buckets_max: u32;
        8 pairs_max: u32;
        12 records_max: u32;
    }
    constants {
    }
}
