//! Frustum culling of the splats of a cluster by camera: `cull.comp`.

use super::lens::{cluster_overlaps_any_lens, lens_of, project_splat_seen};
use super::projection::{Variant, axes_of, from_camera_m, to_camera_axes};
use super::visibility::splat_overlaps;
use crate::layout::{CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord};

const CLUSTER_WORDS: usize = CLUSTER_SPLATS / 32;

/// Writes one bit per splat, `[camera][cluster][8 words]`, and the count a `[camera][cluster]`.
pub fn cull(
    cameras: &[CameraRecord],
    clusters: &[ClusterRecord],
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
            let cluster_index = splat_index / CLUSTER_SPLATS;
            if !cluster_overlaps_any_lens(&clusters[cluster_index], camera, lens, variant.near_m) {
                continue;
            }
            let shape = shapes[splat_index];
            let t = to_camera_axes(camera, from_camera_m(mean_m, camera));
            let (splat, drawn) = project_splat_seen(
                camera,
                lens,
                t,
                axes_of(shape, rotations[splat_index]),
                shape[3],
                variant,
            );
            if drawn && splat_overlaps(&splat, camera) {
                let list = camera_index * clusters.len() + cluster_index;
                visible_words[list * CLUSTER_WORDS + splat_index % CLUSTER_SPLATS / 32] |=
                    1 << (splat_index % 32);
                visible_counts[list] += 1;
            }
        }
    }
}
