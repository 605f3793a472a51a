//! Readers and writers as their users meet them: whole files, real files, broken files.

mod errors;
mod frozen;
mod hostile;
mod properties;
mod real;
mod sample;
mod scene_files;
mod spz_round_trip;
mod text_properties;
