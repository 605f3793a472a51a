//! How many (macro tile, record) pairs each block of depth-sorted records makes: `count_pairs.comp`.

use crate::layout::{Needs, PAIR_BLOCK};

/// Writes the pairs of each block of `order`.
pub fn count_pairs(needs: &Needs, order: &[u32], tile_counts: &[u32], pair_counts: &mut [u32], records_max: u32) {
    let records = if needs.records > records_max { 0 } else { needs.records as usize };
    for (pair_count, block) in pair_counts.iter_mut().zip(order[..records].chunks(PAIR_BLOCK)) {
        *pair_count = block.iter().map(|&record| tile_counts[record as usize]).sum();
    }
}
