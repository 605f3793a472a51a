// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{MergePiece, RequiredCounts};

decouplegs_gpu::shader! {
    "plan_merges", decouplegs_shaders::PLAN_MERGES.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 required: RequiredCounts, ReadWrite, None;
        1 kept_required: RequiredCounts, Read, None;
        2 kept_lists: [u32; 2], Read, None;
        3 moving_lists: [u32; 2], Read, None;
        4 merged_lists: [u32; 2], Write, None;
        5 pieces: MergePiece, Write, None;
        6 arguments: [u32; 3], Write, None;
        7 drawn_alone: u32, ReadWrite, None;
    }
    push 20 {
        0 bin_count: u32;
        4 pairs_max: u32;
        8 pieces_max: u32;
        12 drawn_count: u32;
        16 drawn_holds: u32;
    }
    constants {
    }
}
