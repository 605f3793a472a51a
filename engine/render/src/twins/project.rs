//! Footprint, depth key and color of every visible (camera, splat): `project.comp`.

use decouplegs_scene::{DepthOrder, Rules};

use super::cull::SplatBuffers;
use super::depth_key::{depth_key, scaled_depth};
use super::fog::in_fog;
use super::lens::lens_of;
use super::projection::{Variant, axes_of};
use super::record::Record;
use super::rolling::see_splat;
use super::sh::{Stored, sh_color};
use super::shadow::shadow_factor;
use super::write_record::{Records, code_of_mean};
use crate::layout::{CLUSTER_SPLATS, CameraRecord, LensRecord, NO_KEY_SET, ShadowRecord};
use crate::stages::ProjectVariant;

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

/// Inputs of [`project`], by the names of the kernel's buffers.
pub struct ProjectBuffers<'a> {
    /// Cameras of the frame.
    pub cameras: &'a [CameraRecord],
    /// One per camera, or none at all.
    pub lenses: &'a [LensRecord],
    /// Splats of the background.
    pub splats: SplatBuffers<'a>,
    /// Spherical harmonics of the splats.
    pub sh: Stored<'a>,
    /// Two 16-bit instance ids per word; `None` if they are not requested.
    pub instances: Option<&'a [u32]>,
    /// Visibility, as culling wrote it.
    pub visible_words: &'a [u32],
    /// First record of each `[camera][cluster]`.
    pub offsets: &'a [u32],
    /// Key set of each camera in `kept_keys`, or [`NO_KEY_SET`].
    pub key_sets: &'a [u32],
    /// The persistent key buffer, `[set][splat]`.
    pub kept_keys: &'a [u32],
    /// Shadows on the ground.
    pub shadows: &'a [ShadowRecord],
    /// One bit per (cluster, shadow).
    pub shadow_words: &'a [u32],
    /// Color of the air and extinction per meter, where the variant has fog.
    pub fog: [f32; 4],
}

/// Writes a record, its color and depth key for every visible bit, as far as `records` have
/// capacity. With [`ProjectVariant::splat_ids`], a record has the index of its splat instead of an
/// instance id.
pub fn project(
    input: &ProjectBuffers<'_>,
    records: &mut Records<'_>,
    rules: &Rules,
    variant: &ProjectVariant,
) {
    let SplatBuffers {
        means_m,
        shapes,
        rotations,
    } = input.splats;
    let radial = rules.order == DepthOrder::Radial;
    let splat_count = means_m.len();
    let cluster_count = splat_count.div_ceil(CLUSTER_SPLATS);
    let records_max = records.labels.len();
    let visible = |list: usize, index: usize| {
        input.visible_words[(list * CLUSTER_SPLATS + index) / 32] >> (index % 32) & 1 == 1
    };
    for (camera_index, camera) in input.cameras.iter().enumerate() {
        let lens = lens_of(input.lenses, camera_index);
        for cluster_index in 0..cluster_count {
            let list = camera_index * cluster_count + cluster_index;
            let seen = (0..CLUSTER_SPLATS).filter(|&index| visible(list, index));
            for (slot, index) in (input.offsets[list] as usize..records_max).zip(seen) {
                let splat_index = cluster_index * CLUSTER_SPLATS + index;
                let shape = shapes[splat_index];
                let seen = see_splat(
                    camera,
                    lens,
                    means_m[splat_index],
                    axes_of(shape, rotations[splat_index]),
                    shape[3],
                    Variant::for_rules(rules),
                );
                let id = input.instances.map_or(0, |ids| {
                    ids[splat_index / 2] >> (16 * (splat_index % 2)) & 0xffff
                });
                let degree = usize::from(variant.sh_degree);
                let color = sh_color(
                    &input.sh,
                    splat_index,
                    splat_count,
                    seen.offset_m.normalize(),
                    degree,
                );
                let color = light_left(
                    cluster_index,
                    camera_index,
                    means_m[splat_index],
                    input.shadows,
                    input.shadow_words,
                ) * color;
                let color = match variant.fog {
                    true => in_fog(color, seen.offset_m.length(), input.fog),
                    false => color,
                };
                let record = Record {
                    splat: seen.splat,
                    mean: code_of_mean(camera, lens, means_m[splat_index], seen.splat.mean_px),
                    color,
                    depth_m: if radial {
                        seen.offset_m.length()
                    } else {
                        seen.t.z
                    },
                    instance: if variant.splat_ids {
                        splat_index as u32
                    } else {
                        id
                    },
                };
                let key = match input.key_sets[camera_index] {
                    NO_KEY_SET => depth_key(scaled_depth(means_m[splat_index], camera, radial)),
                    set => input.kept_keys[set as usize * splat_count + splat_index],
                };
                records.write(slot, &record, key);
            }
        }
    }
}
