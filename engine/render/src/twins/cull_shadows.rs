//! `cull_shadows.comp`.

use super::shadow::shadow_overlaps;
use crate::layout::{ClusterRecord, ShadowRecord};

/// A bit each shadow that may lie on a cluster, `[cluster][word]`.
pub fn cull_shadows(
    clusters: &[ClusterRecord],
    shadows: &[ShadowRecord],
    shadow_words: &mut [u32],
) {
    let words = shadows.len().div_ceil(32);
    for (index, word) in shadow_words
        .iter_mut()
        .enumerate()
        .take(clusters.len() * words)
    {
        let own = shadows.iter().skip(index % words * 32).take(32);
        *word = own.enumerate().fold(0, |bits, (bit, shadow)| {
            bits | u32::from(shadow_overlaps(shadow, &clusters[index / words])) << bit
        });
    }
}
