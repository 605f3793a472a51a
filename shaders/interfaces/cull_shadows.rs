// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Cluster, Shadow};

decouplegs_gpu::shader! {
    "cull_shadows", decouplegs_shaders::CULL_SHADOWS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 clusters: Cluster, Read, None;
        1 shadows: Shadow, Read, None;
        2 shadow_words: u32, Write, None;
    }
    push 8 {
        0 cluster_count: u32;
        4 shadow_count: u32;
    }
    constants {
    }
}
