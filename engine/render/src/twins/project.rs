//! Footprint, depth key and colour of every visible (camera, splat): `project.comp`.

use super::depth_key::{depth_key, scaled_depth};
use super::footprint::{Footprint, reached_macro_rows, reached_macro_tiles};
use super::projection::{Variant, axes_of, from_camera_m, project_splat, to_camera_axes};
use super::record::{Record, pack_record_high, pack_record_low};
use super::sh::{Stored, sh_colour};
use crate::layout::{CHUNK_SPLATS, CameraRecord};

/// Macro tiles of `camera` that the splat can reach.
#[must_use]
pub fn count_macro_tiles(splat: &Footprint, camera: &CameraRecord) -> u32 {
    let [first, last] = reached_macro_rows(splat, camera.size_px[1]);
    (first..=last)
        .map(|row| {
            let [left, right] = reached_macro_tiles(splat, row as u32, camera.size_px);
            (right - left + 1) as u32
        })
        .sum()
}

/// Writes a record, its colour, depth key, place and number of macro tiles for every bit of `visible_words`, the first of each
/// `[camera][chunk]` at `firsts`, as far as there is room. No order is kept. `instances` holds two 16-bit ids a word, and is `None` where
/// they are not asked for.
pub fn project(
    cameras: &[CameraRecord],
    means_m: &[[f32; 3]],
    shapes: &[[f32; 4]],
    rotations: &[[f32; 4]],
    visible_words: &[u32],
    firsts: &[u32],
    sh: &Stored<'_>,
    instances: Option<&[u32]>,
    footprints: &mut [[f32; 4]],
    colours: &mut [[f32; 4]],
    keys: &mut [u32],
    values: &mut [u32],
    tile_counts: &mut [u32],
    variant: Variant,
    sh_degree: usize,
    radial: bool,
) {
    let splat_count = means_m.len();
    let chunk_count = splat_count.div_ceil(CHUNK_SPLATS);
    for (camera_index, camera) in cameras.iter().enumerate() {
        for chunk_index in 0..chunk_count {
            let list = camera_index * chunk_count + chunk_index;
            let mut slot = firsts[list] as usize;
            for place in 0..CHUNK_SPLATS {
                let splat_index = chunk_index * CHUNK_SPLATS + place;
                if visible_words[(list * CHUNK_SPLATS + place) / 32] >> (place % 32) & 1 == 0 {
                    continue;
                }
                if slot < colours.len() {
                    let offset = from_camera_m(means_m[splat_index], camera);
                    let t = to_camera_axes(camera, offset);
                    let shape = shapes[splat_index];
                    let (splat, _) = project_splat(camera, t, axes_of(shape, rotations[splat_index]), shape[3], variant);
                    let record = Record {
                        splat,
                        depth_m: if radial { offset.length() } else { t.z },
                        instance: instances.map_or(0, |ids| ids[splat_index / 2] >> (16 * (splat_index % 2)) & 0xffff),
                    };
                    footprints[2 * slot] = pack_record_low(&record);
                    footprints[2 * slot + 1] = pack_record_high(&record);
                    colours[slot] = sh_colour(sh, splat_index, splat_count, offset.normalize(), sh_degree).extend(0.0).to_array();
                    keys[slot] = depth_key(scaled_depth(means_m[splat_index], camera, radial));
                    values[slot] = slot as u32;
                    tile_counts[slot] = count_macro_tiles(&splat, camera);
                }
                slot += 1;
            }
        }
    }
}
