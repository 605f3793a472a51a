// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{BlendItem, Composite, RequiredCounts};

decouplegs_gpu::shader! {
    "plan_segments", decouplegs_shaders::PLAN_SEGMENTS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 required: RequiredCounts, ReadWrite, None;
        1 tile_lists: [u32; 2], Read, None;
        2 items: BlendItem, Write, None;
        3 composites: Composite, Write, None;
        4 arguments: [u32; 3], Write, None;
    }
    push 20 {
        0 bin_count: u32;
        4 pairs_max: u32;
        8 items_max: u32;
        12 partials_max: u32;
        16 composites_max: u32;
    }
    constants {
        0 SEGMENT_PAIRS segment_pairs: u32;
    }
}
