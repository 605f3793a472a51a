// Written by `make shaders` from the SPIR-V. Changes here are lost.

use crate::interfaces::*;

decouplegs_gpu::same_layout! {
    Agent, 160 {
        0 row_x: [f32; 3];
        12 row_y: [f32; 3];
        24 row_z: [f32; 3];
        36 box_min_m: [f32; 3];
        48 box_step_m: [f32; 3];
        60 dc_residual_step: [f32; 3];
        72 log2_size_min: f32;
        76 log2_size_step: f32;
        80 first_cluster: u32;
        84 first_bounds: u32;
        88 first_splat: u32;
        92 splat_count: u32;
        96 first_shape: u32;
        100 first_color: u32;
        104 cameras: u32;
        108 instance: u32;
        112 colors_in_world: u32;
        116 colors_relit: u32;
        120 shading: u32;
        124 dc_residual_gain: [f32; 3];
        136 velocity_mps: [f32; 3];
        148 turn_rad_per_s: [f32; 3];
    }
}

decouplegs_gpu::same_layout! {
    BeamEchoes, 52 {
        0 open: Echo;
        16 open_strongest: f32;
        20 strongest: Echo;
        36 last: Echo;
    }
}

decouplegs_gpu::same_layout! {
    BeamState, 28 {
        0 transmittance: f32;
        4 range_sum_m: f32;
        8 intensity_sum: f32;
        12 median_m: f32;
        16 strongest_weight: f32;
        20 strongest_m: f32;
        24 instances: u32;
    }
}

decouplegs_gpu::same_layout! {
    BlendItem, 20 {
        0 bin: u32;
        4 first_pair: u32;
        8 pairs: u32;
        12 partial: u32;
        16 segment: u32;
    }
}

decouplegs_gpu::same_layout! {
    Bucket, 16 {
        0 first_pair: u32;
        4 pairs: u32;
        8 bin: u32;
        12 part: u32;
    }
}

decouplegs_gpu::same_layout! {
    Camera, 300 {
        0 row_x: [f32; 3];
        12 row_y: [f32; 3];
        24 row_z: [f32; 3];
        36 row_z_low: [f32; 3];
        48 center_high_m: [f32; 3];
        60 center_low_m: [f32; 3];
        72 row_x_coarse: [f32; 3];
        84 row_y_coarse: [f32; 3];
        96 row_z_coarse: [f32; 3];
        108 row_x_fine: [f32; 3];
        120 row_y_fine: [f32; 3];
        132 row_z_fine: [f32; 3];
        144 focal_px: [f32; 2];
        152 principal_px: [f32; 2];
        160 focal_coarse_px: [f32; 2];
        168 focal_fine_px: [f32; 2];
        176 principal_coarse_px: [f32; 2];
        184 principal_fine_px: [f32; 2];
        192 mean_shift: u32;
        196 slope_min: [f32; 2];
        204 slope_max: [f32; 2];
        212 size_px: [u32; 2];
        220 coarse_tiles: [u32; 2];
        228 key_offset: [f32; 2];
        236 key_scale: f32;
        240 key_depth: f32;
        244 first_bin: u32;
        248 first_pixel: u32;
        252 turn_rad_per_s: [f32; 3];
        264 frame_turn_rad_per_s: [f32; 3];
        276 frame_velocity_mps: [f32; 3];
        288 shutter_first_s: f32;
        292 shutter_s_per_px: [f32; 2];
    }
}

decouplegs_gpu::same_layout! {
    Cluster, 28 {
        0 center_m: [f32; 3];
        12 half_extent_m: [f32; 3];
        24 splat_radius_m: f32;
    }
}

decouplegs_gpu::same_layout! {
    Composite, 16 {
        0 bin: u32;
        4 first_partial: u32;
        8 partials: u32;
        12 part: u32;
    }
}

decouplegs_gpu::same_layout! {
    DetailNode, 24 {
        0 center_m: [f32; 3];
        12 radius_m: f32;
        16 error_m: f32;
        20 parent: u32;
    }
}

decouplegs_gpu::same_layout! {
    Echo, 16 {
        0 weight: f32;
        4 range_sum_m: f32;
        8 intensity_sum: f32;
        12 instance: u32;
    }
}

decouplegs_gpu::same_layout! {
    Firing, 16 {
        0 offset_m: [f32; 3];
        12 time_s: f32;
    }
}

decouplegs_gpu::same_layout! {
    Lens, 1760 {
        0 kind: u32;
        4 tan_limit: f32;
        8 chord_limit: f32;
        12 slope_beyond: f32;
        16 pixels_per_rad: f32;
        20 chord_intervals: f32;
        24 matrix: [f32; 4];
        40 radial: [f32; 6];
        64 tangential: [f32; 2];
        72 thin_prism: [f32; 4];
        88 table: [[f32; 2]; 64];
        600 bend_limit: [f32; 2];
        608 bending: [[f32; 2]; 144];
    }
}

decouplegs_gpu::same_layout! {
    LidarBeam, 20 {
        0 direction: [f32; 3];
        12 firing: u32;
        16 index: u32;
    }
}

decouplegs_gpu::same_layout! {
    MergePiece, 8 {
        0 bin: u32;
        4 piece: u32;
    }
}

decouplegs_gpu::same_layout! {
    PartialTiles, 8 {
        0 first: u32;
        4 tiles: u32;
    }
}

decouplegs_gpu::same_layout! {
    Photometry, 240 {
        0 matrix: [[f32; 3]; 3];
        36 offset: [f32; 3];
        48 gamma: [f32; 3];
        60 vignetting: [[f32; 3]; 3];
        96 vignetting_center_px: [[f32; 2]; 3];
        120 vignetting_scale: [f32; 2];
        128 gain: f32;
        132 balance: [[f32; 3]; 3];
        168 response: [[f32; 3]; 5];
        228 has_gamma: u32;
        232 has_balance: u32;
        236 has_response: u32;
    }
}

decouplegs_gpu::same_layout! {
    Relight, 400 {
        0 gain: [f32; 48];
        192 summand: [f32; 48];
        384 first_color: u32;
        388 colors: u32;
        392 first_relit: u32;
        396 first_group: u32;
    }
}

decouplegs_gpu::same_layout! {
    RequiredCounts, 68 {
        0 records: u32;
        4 pairs: u32;
        8 pairs_low: u32;
        12 pairs_high: u32;
        16 large: u32;
        20 buckets: u32;
        24 long_slabs: u32;
        28 pieces: u32;
        32 planned: u32;
        36 items: u32;
        40 partials: u32;
        44 composites: u32;
        48 longest: u32;
        52 tiles: u32;
        56 next_tile: u32;
        60 first_binned: u32;
        64 merges: u32;
    }
}

decouplegs_gpu::same_layout! {
    Sector, 28 {
        0 velocity_mps: [f32; 3];
        12 half_time_s: f32;
        16 residual_m: f32;
        20 first_column: u32;
        24 first_row: u32;
    }
}

decouplegs_gpu::same_layout! {
    Shading, 160 {
        0 up: [f32; 3];
        12 upright: [f32; 3];
        24 upward: [f32; 3];
        36 outward: [f32; 3];
        48 towards: [[f32; 3]; 4];
        96 rgb: [[f32; 3]; 4];
        144 first_slope_per_m: [f32; 3];
        156 first_middle: f32;
    }
}

decouplegs_gpu::same_layout! {
    Shadow, 84 {
        0 center_high_m: [f32; 3];
        12 center_low_m: [f32; 3];
        24 along: [f32; 3];
        36 across: [f32; 3];
        48 normal: [f32; 3];
        60 strength: f32;
        64 log2_decay: f32;
        68 sharpness: u32;
        72 cutoff: f32;
        76 slab_m: f32;
        80 cameras: u32;
    }
}

decouplegs_gpu::same_layout! {
    ViewLists, 8 {
        0 first_static: u32;
        4 first_moving: u32;
    }
}
