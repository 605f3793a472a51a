// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, Photometry};

decouplegs_gpu::shader! {
    "post_process", decouplegs_shaders::POST_PROCESS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 cameras: Camera, Read, None;
        1 blended: [f32; 4], Read, None;
        2 rays: [f32; 3], Read, None;
        3 sky_texels: [f32; 3], Read, None;
        4 photometry: Photometry, Read, None;
        5 images_f32: [f32; 4], Write, None;
        6 images_u8: u32, Write, None;
    }
    push 68 {
        0 right: [f32; 3];
        12 down: [f32; 3];
        24 forward: [f32; 3];
        36 camera: u32;
        40 face_texels: u32;
        44 clamps_sky: u32;
        48 clamps_splats: u32;
        52 fog: [f32; 4];
    }
    constants {
        0 COLOR_U8 color_u8: bool;
        1 SKY sky: bool;
        2 LENS lens: bool;
    }
}
