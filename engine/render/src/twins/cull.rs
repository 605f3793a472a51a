//! Frustum culling of the splats of a cluster by camera: `cull.comp`.

use super::lens::{chunk_reaches_seen, lens_of, project_splat_seen};
use super::projection::{Variant, axes_of, from_camera_m, to_camera_axes};
use super::visibility::splat_reaches;
use crate::layout::{CHUNK_SPLATS, CameraRecord, ChunkRecord, LensRecord};

const CHUNK_WORDS: usize = CHUNK_SPLATS / 32;

/// Writes one bit a splat, `[camera][chunk][8 words]`, and the count a `[camera][chunk]`.
pub fn cull(
    cameras: &[CameraRecord],
    chunks: &[ChunkRecord],
    means_m: &[[f32; 3]],
    shapes: &[[f32; 4]],
    rotations: &[[f32; 4]],
    visible_words: &mut [u32],
    visible_counts: &mut [u32],
    lenses: &[LensRecord],
    variant: Variant,
) {
    visible_words.fill(0);
    visible_counts.fill(0);
    for (camera_index, camera) in cameras.iter().enumerate() {
        let lens = lens_of(lenses, camera_index);
        for (splat_index, &mean_m) in means_m.iter().enumerate() {
            let chunk_index = splat_index / CHUNK_SPLATS;
            if !chunk_reaches_seen(&chunks[chunk_index], camera, lens, variant.near_m) {
                continue;
            }
            let shape = shapes[splat_index];
            let t = to_camera_axes(camera, from_camera_m(mean_m, camera));
            let (splat, drawn) = project_splat_seen(camera, lens, t, axes_of(shape, rotations[splat_index]), shape[3], variant);
            if drawn && splat_reaches(&splat, camera) {
                let list = camera_index * chunks.len() + chunk_index;
                visible_words[list * CHUNK_WORDS + splat_index % CHUNK_SPLATS / 32] |= 1 << (splat_index % 32);
                visible_counts[list] += 1;
            }
        }
    }
}
