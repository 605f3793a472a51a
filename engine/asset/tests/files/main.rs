//! Readers and writers as their users meet them: whole files, real files, broken files.

mod coded_asset;
mod coded_properties;
mod coded_python;
mod data;
mod errors;
mod exchange;
mod frozen;
mod hostile;
mod hugsim;
mod instant_nurec;
mod kitti;
mod lidar;
mod light_transfer;
mod nurec;
mod nurec_checkpoint;
mod nurec_parts;
mod properties;
mod real;
mod sample;
mod scene_cameras;
mod scene_files;
mod scene_imports;
mod scene_lidars;
mod scene_lights;
mod spz_round_trip;
mod text_properties;
