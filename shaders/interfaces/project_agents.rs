// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Agent, Camera, Lens, Shading};

decouplegs_gpu::shader! {
    "project_agents", decouplegs_shaders::PROJECT_AGENTS.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 agents: Agent, Read, None;
        1 agent_cameras: Camera, Read, None;
        2 coded_splats: [u32; 3], Read, None;
        3 coded_shapes: [f32; 4], Read, None;
        4 visible_words: u32, Read, None;
        5 offsets: u32, Read, None;
        6 coded_dc: [f32; 3], Read, None;
        7 coded_bands: [u32; 4], Read, None;
        8 static_offsets: u32, Read, None;
        9 relit_dc: [f32; 3], Read, None;
        10 relit_bands: [u32; 4], Read, None;
        11 footprints: [u32; 4], Write, None;
        12 attributes: [f32; 4], Write, None;
        13 keys: u32, Write, None;
        19 labels: [u32; 2], Write, None;
        20 shadings: Shading, Read, None;
        21 depths: [f32; 2], Write, None;
        32 lenses: Lens, Read, None;
    }
    push 40 {
        0 agent_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
        12 records_max: u32;
        16 static_lists: u32;
        20 flow_interval_s: f32;
        24 fog: [f32; 4];
    }
    constants {
        0 NEAR_M near_m: f32;
        1 ANTIALIAS antialias: bool;
        2 SH_DEGREE sh_degree: u32;
        3 RADIAL radial: bool;
        4 RELIT relit: bool;
        5 SHADED shaded: bool;
        9 LABELS labels: bool;
        16 LENSES lenses: bool;
        17 ROLLING rolling: bool;
        18 DEPTHS depths: bool;
        19 FOG fog: bool;
        30 RANGE range: bool;
        31 NORMAL normal: bool;
        32 FLOW_FORWARD flow_forward: bool;
        33 FLOW_BACKWARD flow_backward: bool;
        34 SCENE_FLOW scene_flow: bool;
    }
}
