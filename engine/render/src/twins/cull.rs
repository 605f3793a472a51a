//! Frustum culling of the splats of a cluster by camera: `cull.comp`.

use super::lens::{cluster_overlaps_any_lens, lens_of};
use super::projection::{Variant, axes_of};
use super::rolling::{see_splat, swept};
use super::visibility::splat_overlaps;
use crate::layout::{CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord};

const CLUSTER_WORDS: usize = CLUSTER_SPLATS / 32;

/// Splats of the background, one entry each.
#[derive(Clone, Copy)]
pub struct SplatBuffers<'a> {
    /// Means, meters.
    pub means_m: &'a [[f32; 3]],
    /// Scales and opacities.
    pub shapes: &'a [[f32; 4]],
    /// Rotation quaternions, w first.
    pub rotations: &'a [[f32; 4]],
}

/// Visibility that culling writes.
pub struct VisibleBits<'a> {
    /// One bit per splat, `[camera][cluster][8 words]`.
    pub words: &'a mut [u32],
    /// Number of bits, `[camera][cluster]`.
    pub counts: &'a mut [u32],
}

impl VisibleBits<'_> {
    /// Starts without visible splats.
    pub(super) fn clear(&mut self) {
        self.words.fill(0);
        self.counts.fill(0);
    }

    /// Marks the splat at `index` of a cluster as visible; `list` counts `[camera][cluster]`.
    pub(super) fn mark(&mut self, list: usize, index: usize) {
        self.words[list * CLUSTER_WORDS + index / 32] |= 1 << (index % 32);
        self.counts[list] += 1;
    }
}

/// Culls the splats of the background for all cameras.
pub fn cull(
    cameras: &[CameraRecord],
    lenses: &[LensRecord],
    clusters: &[ClusterRecord],
    splats: SplatBuffers<'_>,
    visible: &mut VisibleBits<'_>,
    variant: Variant,
) {
    visible.clear();
    for (camera_index, camera) in cameras.iter().enumerate() {
        let lens = lens_of(lenses, camera_index);
        for (splat_index, &mean_m) in splats.means_m.iter().enumerate() {
            let cluster_index = splat_index / CLUSTER_SPLATS;
            let cluster = swept(&clusters[cluster_index], camera);
            if !cluster_overlaps_any_lens(&cluster, camera, lens, variant.near_m) {
                continue;
            }
            let shape = splats.shapes[splat_index];
            let seen = see_splat(
                camera,
                lens,
                mean_m,
                axes_of(shape, splats.rotations[splat_index]),
                shape[3],
                variant,
            );
            if seen.drawn && splat_overlaps(&seen.splat, variant.squares_max, camera) {
                let list = camera_index * clusters.len() + cluster_index;
                visible.mark(list, splat_index % CLUSTER_SPLATS);
            }
        }
    }
}
