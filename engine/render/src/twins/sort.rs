//! Stable radix sort of lists of keys with values: `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`.

use crate::layout::SortSegment;

/// Orders each list of `segments` by the low `key_bits` of the key, rounded up to whole digits of 8 bits. Keys that are equal
/// there stay in order; what no list holds stays as it is.
pub fn sort(segments: &[SortSegment], keys: &mut [u32], values: &mut [u32], key_bits: u32) {
    let bits = key_bits.div_ceil(8) * 8;
    let mask = if bits >= 32 { u32::MAX } else { (1 << bits) - 1 };
    for segment in segments {
        let range = segment.first as usize..(segment.first + segment.count) as usize;
        let mut list: Vec<(u32, u32)> = range.clone().map(|place| (keys[place], values[place])).collect();
        list.sort_by_key(|(key, _)| key & mask);
        for (place, (key, value)) in range.zip(list) {
            (keys[place], values[place]) = (key, value);
        }
    }
}
