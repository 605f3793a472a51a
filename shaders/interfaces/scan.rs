// Written by `make shaders` from the SPIR-V. Changes here are lost.

decouplegs_gpu::shader! {
    "scan", decouplegs_shaders::SCAN.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 63];
    bindings {
        0 counts: u32, Read, None;
        1 offsets: u32, Write, None;
    }
    push 4 {
        0 count: u32;
    }
    constants {
    }
}
