// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{MergePiece, RequiredCounts};

decouplegs_gpu::shader! {
    "merge_lists", decouplegs_shaders::MERGE_LISTS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 required: RequiredCounts, Read, None;
        1 kept_lists: [u32; 2], Read, None;
        2 moving_lists: [u32; 2], Read, None;
        3 merged_lists: [u32; 2], Read, None;
        4 pieces: MergePiece, Read, None;
        5 moving_records: u32, Read, None;
        6 keys: u32, Read, None;
        7 sorted_records: u32, ReadWrite, None;
    }
    push 4 {
        0 pieces_max: u32;
    }
    constants {
    }
}
