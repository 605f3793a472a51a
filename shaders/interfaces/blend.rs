// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{BlendItem, Camera, PartialTiles, RequiredCounts};

decouplegs_gpu::shader! {
    "blend", decouplegs_shaders::BLEND.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1, 61, 62, 63, 64, 65];
    bindings {
        0 cameras: Camera, Read, None;
        1 images_f32: [f32; 4], Write, None;
        2 planes: u32, Write, None;
        3 images_u8: u32, Write, None;
        5 required: RequiredCounts, ReadWrite, None;
        6 items: BlendItem, Read, None;
        7 records: u32, Read, None;
        8 footprints: [u32; 4], Read, None;
        9 attributes: [f32; 4], Read, None;
        10 partial_colors: u32, ReadWrite, None;
        11 partial_planes: u32, ReadWrite, None;
        12 labels: [u32; 2], Read, None;
        13 partial_transmittances: u32, ReadWrite, None;
        14 contributions: u32, ReadWrite, None;
        15 partial_unfinished: u32, Read, None;
        16 partial_tiles: PartialTiles, ReadWrite, None;
        17 depths: [f32; 2], Read, None;
        18 partial_medians: u32, ReadWrite, None;
    }
    push 32 {
        0 sky: [f32; 3];
        12 camera_count: u32;
        16 items_max: u32;
        20 tiles_max: u32;
        24 contribution_scale: f32;
        28 image_pixels: u32;
    }
    constants {
        0 COLOR_U8 color_u8: bool;
        1 DEPTH depth: bool;
        2 INSTANCE instance: bool;
        3 ALPHA_MAX alpha_max: f32;
        4 EARLY_STOP early_stop: bool;
        5 LANES lanes: u32;
        6 CONTRIBUTIONS contributions: bool;
        7 FINISH finish: bool;
        8 ONE_BATCH one_batch: bool;
        9 FINISH_MEDIANS finish_medians: bool;
        11 INCLUSIVE_STOP inclusive_stop: bool;
        12 LOG2_ALPHA_MAX log2_alpha_max: f32;
        30 RANGE range: bool;
        31 NORMAL normal: bool;
        32 FLOW_FORWARD flow_forward: bool;
        33 FLOW_BACKWARD flow_backward: bool;
        34 SCENE_FLOW scene_flow: bool;
        35 DEPTH_MEDIAN depth_median: bool;
        36 RANGE_MEDIAN range_median: bool;
        40 LEAST_RESPONSE least_response: bool;
        41 LEAST_RESPONSE_SQUARES least_response_squares: f32;
    }
}
