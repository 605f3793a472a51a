//! Where each macro tile's list begins in the sorted pairs: `find_ranges.comp`.

use crate::layout::Needs;

/// Writes, for each macro tile and one past the last, the first pair of it or of a later one. Nothing for no pairs.
pub fn find_ranges(needs: &Needs, bins: &[u32], range_firsts: &mut [u32], pairs_max: u32, bin_count: u32) {
    let pairs = needs.pairs.min(pairs_max) as usize;
    if pairs == 0 {
        return;
    }
    for bin in 0..=bin_count {
        range_firsts[bin as usize] = bins[..pairs].partition_point(|&other| other < bin) as u32;
    }
}
