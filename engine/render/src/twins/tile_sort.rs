//! Tile binning and the plan of its buckets: `count_pairs.comp`, `plan_buckets.comp` and
//! `depth_slab.glsl`.

use decouplegs_scene::{DepthOrder, Rules};
use decouplegs_shaders::constants::{SLAB_FIRST_M, SLAB_PART_PAIRS, SLAB_PARTS_MAX, SLAB_SHIFT};

use super::depth_key::depth_of_key;
use super::footprint::{reached_coarse_rows, reached_coarse_tiles};
use super::record::load_footprint;
use crate::layout::{BUCKET_PAIRS, CameraRecord, SLABS, ViewLists, response_squares_max};

/// The depth slab of a key, where the camera has the depth `camera_depth`, scaled as keys are by
/// `key_scale`.
#[must_use]
pub fn depth_slab(key: u32, camera_depth: f32, key_scale: f32) -> usize {
    let (distance, first) = (depth_of_key(key) - camera_depth, SLAB_FIRST_M * key_scale);
    let slab = (distance.max(first).to_bits() >> SLAB_SHIFT) - (first.to_bits() >> SLAB_SHIFT);
    (slab as usize).min(SLABS - 1)
}

/// The camera of a record: records of the background lie by camera, and behind them those of the
/// agents.
fn camera_of(record: u32, lists: &[ViewLists], camera_count: usize) -> usize {
    let moving = record >= lists[0].first_moving;
    let first = |camera: usize| {
        if moving {
            lists[camera].first_moving
        } else {
            lists[camera].first_static
        }
    };
    (1..camera_count).fold(
        0,
        |camera, next| if first(next) <= record { next } else { camera },
    )
}

/// Depth keys and records of all pairs, by `[coarse tile][depth slab]`, in the order of records.
#[must_use]
pub fn bin_pairs(
    cameras: &[CameraRecord],
    lists: &[ViewLists],
    keys: &[u32],
    footprints: &[[u32; 4]],
    rules: &Rules,
) -> Vec<Vec<[u32; 2]>> {
    let bins: u32 = cameras.iter().map(CameraRecord::bins).sum();
    let radial = rules.order == DepthOrder::Radial;
    let squares_max = response_squares_max(rules);
    let mut pairs = vec![Vec::new(); bins as usize * SLABS];
    for (record, &key) in (0u32..).zip(keys) {
        let camera = &cameras[camera_of(record, lists, cameras.len())];
        let splat = load_footprint(footprints, record as usize, camera.mean_shift, [0; 2]);
        let slab = depth_slab(
            key,
            if radial { 0.0 } else { camera.key_depth },
            camera.key_scale,
        );
        let [first_row, last_row] = reached_coarse_rows(&splat, squares_max, camera.size_px[1]);
        for row in first_row..=last_row {
            let [left, right] =
                reached_coarse_tiles(&splat, squares_max, row as u32, camera.size_px);
            for tile in left..=right {
                let bin = camera.first_bin + row as u32 * camera.coarse_tiles[0] + tile as u32;
                pairs[bin as usize * SLABS + slab].push([key, record]);
            }
        }
    }
    pairs
}

/// Lengths of the buckets of one coarse tile, some of them 0, whose slabs have `slab_counts` pairs.
#[must_use]
pub fn plan_buckets(slab_counts: &[u32]) -> Vec<u32> {
    let (mut buckets, mut index, mut begin) = (Vec::new(), 0u32, 0u32);
    for &count in slab_counts {
        let end = index + count;
        if count >= BUCKET_PAIRS as u32 {
            buckets.push(index - begin);
            begin = index;
        }
        if index / BUCKET_PAIRS as u32 != end / BUCKET_PAIRS as u32 {
            buckets.push(end - begin);
            begin = end;
        }
        index = end;
    }
    if index > begin {
        buckets.push(index - begin);
    }
    buckets
}

/// Workgroups that cut a depth slab of `pairs` pairs that is too long for a bucket.
#[must_use]
pub fn slab_parts(pairs: u32) -> u32 {
    let parts = pairs.div_ceil(SLAB_PART_PAIRS).next_power_of_two();
    parts.min(SLAB_PARTS_MAX)
}
