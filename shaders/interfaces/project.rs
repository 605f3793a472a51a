// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, Lens, Shadow};

decouplegs_gpu::shader! {
    "project", decouplegs_shaders::PROJECT.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 cameras: Camera, Read, Some(9600);
        1 means_m: [f32; 3], Read, None;
        2 shapes: [u32; 4], Read, None;
        3 rotations: [u32; 4], Read, None;
        4 visible_words: u32, Read, None;
        5 offsets: u32, Read, None;
        6 sh_dc: u32, Read, None;
        7 sh_band1: u32, Read, None;
        8 sh_band2: u32, Read, None;
        9 sh_band3: u32, Read, None;
        10 instances: u32, Read, None;
        11 footprints: [u32; 4], Write, None;
        12 attributes: [f32; 4], Write, None;
        13 keys: u32, Write, None;
        14 key_sets: u32, Read, None;
        15 kept_keys: u32, Read, None;
        16 shadows: Shadow, Read, None;
        17 shadow_words: u32, Read, None;
        19 labels: [u32; 2], Write, None;
        21 depths: [f32; 2], Write, None;
        32 lenses: Lens, Read, None;
    }
    push 40 {
        0 splat_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
        12 records_max: u32;
        16 shadow_word_count: u32;
        20 flow_interval_s: f32;
        24 fog: [f32; 4];
    }
    constants {
        0 NEAR_M near_m: f32;
        1 ANTIALIAS antialias: bool;
        2 SH_DEGREE sh_degree: u32;
        3 RADIAL radial: bool;
        4 INSTANCES instances: bool;
        6 SPLAT_IDS splat_ids: bool;
        7 SHADOWS shadows: bool;
        8 SHADOWS_BY_CAMERA shadows_by_camera: bool;
        9 LABELS labels: bool;
        16 LENSES lenses: bool;
        17 ROLLING rolling: bool;
        18 DEPTHS depths: bool;
        19 FOG fog: bool;
        23 COMPACT compact: bool;
        30 RANGE range: bool;
        31 NORMAL normal: bool;
        32 FLOW_FORWARD flow_forward: bool;
        33 FLOW_BACKWARD flow_backward: bool;
        34 SCENE_FLOW scene_flow: bool;
    }
}
