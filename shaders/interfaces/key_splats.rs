// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera};

decouplegs_gpu::shader! {
    "key_splats", decouplegs_shaders::KEY_SPLATS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 cameras: Camera, Read, None;
        1 means_m: [f32; 3], Read, None;
        2 kept_keys: u32, Write, None;
    }
    push 12 {
        0 splat_count: u32;
        4 camera: u32;
        8 key_set: u32;
    }
    constants {
    }
}
