//! Kept orders: `key_splats.comp`, `rank_splats.comp` and `count_ranks.comp`.

use super::depth_key::{depth_key, scaled_depth};
use crate::layout::{CHUNK_SPLATS, CameraRecord};

/// Writes the depth keys of all splats along the direction of camera `camera`, and their indices.
pub fn key_splats(cameras: &[CameraRecord], means_m: &[[f32; 3]], keys: &mut [u32], values: &mut [u32], camera: usize) {
    for (splat, &mean_m) in means_m.iter().enumerate() {
        keys[splat] = depth_key(scaled_depth(mean_m, &cameras[camera], false));
        values[splat] = splat as u32;
    }
}

/// Writes the place of each splat in the order `values` to set `rank_set` of `ranks`.
pub fn rank_splats(values: &[u32], ranks: &mut [u32], splat_count: usize, rank_set: usize) {
    for (rank, &splat) in values[..splat_count].iter().enumerate() {
        ranks[rank_set * splat_count + splat as usize] = rank as u32;
    }
}

/// Writes how many bits are set for each of the first `count` stretches of 256 ranks.
pub fn count_ranks(rank_words: &[u32], rank_counts: &mut [u32], count: usize) {
    for (rank_count, words) in rank_counts[..count].iter_mut().zip(rank_words.chunks(CHUNK_SPLATS / 32)) {
        *rank_count = words.iter().map(|word| word.count_ones()).sum();
    }
}
