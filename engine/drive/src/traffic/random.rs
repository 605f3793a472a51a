//! Random numbers addressed by what they are for.

use decouplegs_scene::random::{self, GOLDEN, mix};

/// One of `count` ways, at least one: that which agent `agent` takes where it chooses for the
/// `choice`-th time.
pub(super) fn way(seed: u64, agent: usize, choice: u32, count: usize) -> usize {
    (bits(seed, agent, choice) % count as u64) as usize
}

/// A number from 0 to below 1: that which agent `agent` draws for its `choice`-th choice.
pub(super) fn unit(seed: u64, agent: usize, choice: u32) -> f64 {
    random::unit(bits(seed, agent, choice))
}

fn bits(seed: u64, agent: usize, choice: u32) -> u64 {
    let keyed = mix(seed ^ 0x7472_6166).wrapping_add((agent as u64).wrapping_mul(GOLDEN));
    mix(mix(keyed).wrapping_add(u64::from(choice).wrapping_mul(GOLDEN)))
}
