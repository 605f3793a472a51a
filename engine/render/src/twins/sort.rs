//! Stable radix sort of keys with values: `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`.

/// The first `count` keys and values ordered by the low `key_bits` of the key, rounded up to whole digits of 8 bits. Keys
/// that are equal there stay in order. Without `values`, the values are the keys' places.
#[must_use]
pub fn sort(count: usize, keys: &[u32], values: Option<&[u32]>, key_bits: u32) -> (Vec<u32>, Vec<u32>) {
    let bits = key_bits.div_ceil(8) * 8;
    let mask = if bits >= 32 { u32::MAX } else { (1 << bits) - 1 };
    let mut places: Vec<usize> = (0..count).collect();
    places.sort_by_key(|&place| keys[place] & mask);
    let value_at = |place: &usize| values.map_or(*place as u32, |values| values[*place]);
    (places.iter().map(|&place| keys[place]).collect(), places.iter().map(value_at).collect())
}
