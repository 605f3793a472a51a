//! Depth keys of a whole background: `key_splats.comp`.

use super::depth_key::{depth_key, scaled_depth};
use crate::layout::CameraRecord;

/// Writes the depth keys of all splats along the direction of camera `camera` to set `key_set` of
/// `kept_keys`, `[set][splat]`.
pub fn key_splats(
    cameras: &[CameraRecord],
    means_m: &[[f32; 3]],
    kept_keys: &mut [u32],
    camera: usize,
    key_set: usize,
) {
    let set = &mut kept_keys[key_set * means_m.len()..(key_set + 1) * means_m.len()];
    for (key, &mean_m) in set.iter_mut().zip(means_m) {
        *key = depth_key(scaled_depth(mean_m, &cameras[camera], false));
    }
}
