// Written by `make shaders` from the SPIR-V. Changes here are lost.

decouplegs_gpu::shader! {
    "hash_images", decouplegs_shaders::HASH_IMAGES.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 pixels: u32, Read, None;
        1 keys: [u32; 2], Read, None;
        2 sums: [u32; 2], Write, None;
    }
    push 16 {
        0 first_pixel: u32;
        4 pixel_count: u32;
        8 first_unit: u32;
        12 unit_count: u32;
    }
    constants {
    }
}
