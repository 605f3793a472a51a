// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{BeamEchoes, BeamState, Camera, Firing, LidarBeam, RequiredCounts};

decouplegs_gpu::shader! {
    "trace_lidar", decouplegs_shaders::TRACE_LIDAR.spirv;
    entry_point: "main";
    workgroup: [(64, None), (1, None), (1, None)];
    capabilities: [1, 61, 62, 63, 64, 65];
    bindings {
        0 cameras: Camera, Read, None;
        1 tile_lists: [u32; 2], Read, None;
        2 pairs: [u32; 2], Read, None;
        3 footprints: [u32; 4], Read, None;
        4 looks: [f32; 3], Read, None;
        5 lidar_shapes: [f32; 4], Read, None;
        6 beams: LidarBeam, Read, None;
        7 firings: Firing, Read, None;
        8 states: BeamState, ReadWrite, None;
        9 echoes: BeamEchoes, ReadWrite, None;
        10 tile_words: u32, Read, None;
        11 required: RequiredCounts, Read, None;
    }
    push 28 {
        0 camera_count: u32;
        4 bin_count: u32;
        8 first_entry: u32;
        12 entries_max: u32;
        16 range_min_m: f32;
        20 records_max: u32;
        24 pairs_max: u32;
    }
    constants {
        2 ALPHA_MAX alpha_max: f32;
        5 LANES lanes: u32;
        6 BEAM_LANES beam_lanes: u32;
        21 MOVING moving: bool;
        22 ECHOES echoes: bool;
    }
}
