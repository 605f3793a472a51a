// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{RequiredCounts, ViewLists};

decouplegs_gpu::shader! {
    "plan_lists", decouplegs_shaders::PLAN_LISTS.spirv;
    entry_point: "main";
    workgroup: [(64, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 static_offsets: u32, Read, None;
        1 moving_offsets: u32, Read, None;
        2 lists: ViewLists, Write, None;
        3 required: RequiredCounts, ReadWrite, None;
        4 arguments: [u32; 3], Write, None;
    }
    push 20 {
        0 camera_count: u32;
        4 static_clusters: u32;
        8 moving_clusters: u32;
        12 records_max: u32;
        16 moving_only: u32;
    }
    constants {
    }
}
