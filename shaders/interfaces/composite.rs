// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, Composite, PartialTiles, RequiredCounts};

decouplegs_gpu::shader! {
    "composite", decouplegs_shaders::COMPOSITE.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 cameras: Camera, Read, None;
        1 images_f32: [f32; 4], Write, None;
        2 planes: u32, Write, None;
        3 images_u8: u32, Write, None;
        5 required: RequiredCounts, Read, None;
        6 composites: Composite, Read, None;
        7 partial_colors: u32, ReadWrite, None;
        8 partial_planes: u32, ReadWrite, None;
        9 partial_unfinished: u32, ReadWrite, None;
        10 partial_tiles: PartialTiles, Read, None;
        11 partial_transmittances: u32, Read, None;
        12 partial_medians: u32, ReadWrite, None;
        13 medians_unfinished: u32, ReadWrite, None;
        14 depths: [f32; 2], Read, None;
    }
    push 20 {
        0 sky: [f32; 3];
        12 camera_count: u32;
        16 image_pixels: u32;
    }
    constants {
        0 COLOR_U8 color_u8: bool;
        1 DEPTH depth: bool;
        2 INSTANCE instance: bool;
        3 EARLY_STOP early_stop: bool;
        4 CONTRIBUTIONS contributions: bool;
        7 INCLUSIVE_STOP inclusive_stop: bool;
        30 RANGE range: bool;
        31 NORMAL normal: bool;
        32 FLOW_FORWARD flow_forward: bool;
        33 FLOW_BACKWARD flow_backward: bool;
        34 SCENE_FLOW scene_flow: bool;
        35 DEPTH_MEDIAN depth_median: bool;
        36 RANGE_MEDIAN range_median: bool;
    }
}
