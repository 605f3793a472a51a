// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::{Camera, Cluster, Sector};

decouplegs_gpu::shader! {
    "project_lidar", decouplegs_shaders::PROJECT_LIDAR.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 cameras: Camera, Read, None;
        1 means_m: [f32; 3], Read, None;
        2 shapes: [u32; 4], Read, None;
        3 rotations: [u32; 4], Read, None;
        4 visible_words: u32, ReadWrite, None;
        5 visible_counts: u32, ReadWrite, None;
        6 offsets: u32, Read, None;
        7 clusters: Cluster, Read, None;
        8 sh_dc: u32, Read, None;
        9 instances: u32, Read, None;
        11 footprints: [u32; 4], Write, None;
        12 looks: [f32; 3], Write, None;
        13 keys: u32, Write, None;
        14 lidar_shapes: [f32; 4], Write, None;
        15 sectors: Sector, Read, None;
        16 column_bounds: [f32; 2], Read, None;
        17 row_bounds: [f32; 2], Read, None;
    }
    push 16 {
        0 splat_count: u32;
        4 camera_count: u32;
        8 cluster_count: u32;
        12 records_max: u32;
    }
    constants {
        1 ANTIALIAS antialias: bool;
        2 WRITE write: bool;
        4 INSTANCES instances: bool;
        20 DILATION_RAD dilation_rad: f32;
        21 MOVING moving: bool;
        23 COMPACT compact: bool;
    }
}
