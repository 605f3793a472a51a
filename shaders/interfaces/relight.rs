// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Relight};

decouplegs_gpu::shader! {
    "relight", decouplegs_shaders::RELIGHT.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 relights: Relight, Read, None;
        1 coded_dc: [f32; 3], Read, None;
        2 coded_bands: u32, Read, None;
        3 relit_dc: [f32; 3], Write, None;
        4 relit_bands: u32, Write, None;
    }
    push 4 {
        0 relight_count: u32;
    }
    constants {
        2 SH_DEGREE sh_degree: u32;
    }
}
