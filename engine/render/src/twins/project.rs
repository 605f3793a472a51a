//! Footprint, depth key and color of every visible (camera, splat): `project.comp`.

use super::depth_key::{depth_key, scaled_depth};
use super::lens::{lens_of, project_splat_seen};
use super::projection::{Variant, axes_of, from_camera_m, to_camera_axes};
use super::record::Record;
use super::sh::{Stored, sh_color};
use super::shadow::shadow_factor;
use super::write_record::write_record;
use crate::layout::{CLUSTER_SPLATS, CameraRecord, LensRecord, NO_KEY_SET, ShadowRecord};

/// Share of a splat's light after all shadows that may lie on the cluster and that the camera sees.
fn light_left(
    cluster_index: usize,
    camera: usize,
    mean_m: [f32; 3],
    shadows: &[ShadowRecord],
    shadow_words: &[u32],
) -> f32 {
    let words = shadows.len().div_ceil(32);
    let may_lie =
        |index: usize| shadow_words[cluster_index * words + index / 32] >> (index % 32) & 1 == 1;
    let near = shadows
        .iter()
        .enumerate()
        .filter(|(index, shadow)| may_lie(*index) && shadow.cameras >> camera & 1 == 1);
    near.map(|(_, shadow)| shadow_factor(shadow, mean_m))
        .product()
}

/// Writes a record, its color and depth key for every bit of `visible_words`, the first of each
/// `[camera][cluster]` at `offsets`, as far as there is room. `instances` holds two 16-bit ids a
/// word, and is `None` where they are not asked for; with `splat_ids` the splat's index is written
/// instead. Cameras that have a key set read their keys from it.
pub fn project(
    cameras: &[CameraRecord],
    means_m: &[[f32; 3]],
    shapes: &[[f32; 4]],
    rotations: &[[f32; 4]],
    visible_words: &[u32],
    offsets: &[u32],
    sh: &Stored<'_>,
    instances: Option<&[u32]>,
    footprints: &mut [[f32; 4]],
    colors: &mut [[f32; 4]],
    keys: &mut [u32],
    key_sets: &[u32],
    kept_keys: &[u32],
    shadows: &[ShadowRecord],
    shadow_words: &[u32],
    lenses: &[LensRecord],
    variant: Variant,
    sh_degree: usize,
    radial: bool,
    splat_ids: bool,
) {
    let splat_count = means_m.len();
    let cluster_count = splat_count.div_ceil(CLUSTER_SPLATS);
    let records_max = colors.len();
    let visible = |list: usize, place: usize| {
        visible_words[(list * CLUSTER_SPLATS + place) / 32] >> (place % 32) & 1 == 1
    };
    for (camera_index, camera) in cameras.iter().enumerate() {
        let lens = lens_of(lenses, camera_index);
        for cluster_index in 0..cluster_count {
            let list = camera_index * cluster_count + cluster_index;
            let seen = (0..CLUSTER_SPLATS).filter(|&place| visible(list, place));
            for (slot, place) in (offsets[list] as usize..records_max).zip(seen) {
                let splat_index = cluster_index * CLUSTER_SPLATS + place;
                let offset = from_camera_m(means_m[splat_index], camera);
                let t = to_camera_axes(camera, offset);
                let shape = shapes[splat_index];
                let (splat, _) = project_splat_seen(
                    camera,
                    lens,
                    t,
                    axes_of(shape, rotations[splat_index]),
                    shape[3],
                    variant,
                );
                let id = instances.map_or(0, |ids| {
                    ids[splat_index / 2] >> (16 * (splat_index % 2)) & 0xffff
                });
                let record = Record {
                    splat,
                    depth_m: if radial { offset.length() } else { t.z },
                    instance: if splat_ids { splat_index as u32 } else { id },
                };
                let color = sh_color(sh, splat_index, splat_count, offset.normalize(), sh_degree);
                let color = light_left(
                    cluster_index,
                    camera_index,
                    means_m[splat_index],
                    shadows,
                    shadow_words,
                ) * color;
                write_record(slot, &record, color, footprints, colors);
                keys[slot] = if key_sets[camera_index] != NO_KEY_SET {
                    kept_keys[key_sets[camera_index] as usize * splat_count + splat_index]
                } else {
                    depth_key(scaled_depth(means_m[splat_index], camera, radial))
                };
            }
        }
    }
}
