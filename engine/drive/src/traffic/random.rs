//! Random numbers addressed by what they are for.

/// 2^64 over the golden ratio: the increment of SplitMix64 (G. L. Steele, D. Lea, C. H. Flood: Fast
/// splittable pseudorandom number generators, 2014).
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64: every input bit moves every output bit.
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One of `count` ways, at least one: that which agent `agent` takes where it chooses for the
/// `choice`-th time.
pub(super) fn way(seed: u64, agent: usize, choice: u32, count: usize) -> usize {
    let keyed = mix(seed ^ 0x7472_6166).wrapping_add((agent as u64).wrapping_mul(GOLDEN));
    (mix(mix(keyed).wrapping_add(u64::from(choice).wrapping_mul(GOLDEN))) % count as u64) as usize
}
