//! `find_ranges.comp`: where each macro tile's list begins.

use decouplegs::render::layout::{Needs, PAIR_BLOCK};
use decouplegs::render::stages::{Arguments, FindRanges};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, untouched, upload};
use crate::device::Validated;

/// The ranges of `pairs` pairs where there is room for `bins.len()`; the twin is given `twin_bins`.
fn compare(gpu: &Validated, pairs: u32, bins: &[u32], twin_bins: &[u32], bin_count: u32) -> Result<(), String> {
    let needs = Needs { pairs, ..Needs::default() };
    let blocks = (pairs as usize).min(bins.len()).div_ceil(PAIR_BLOCK);
    let control = control(gpu, needs, &[(Arguments::Ranges, blocks)]);
    let range_firsts = untouched(gpu, bin_count as usize + 1);
    let find_ranges = FindRanges::new(gpu).unwrap();
    run(gpu, |r| find_ranges.record(r, &control, &upload(gpu, bins), &range_firsts, bin_count));

    let mut twin = vec![UNTOUCHED; bin_count as usize + 1];
    twins::find_ranges(&needs, twin_bins, &mut twin, bins.len() as u32, bin_count);
    identical("range_firsts", &gpu.read(&range_firsts).unwrap(), &twin)
}

fn sorted_bins(pairs: usize, first: u32, end: u32) -> Vec<u32> {
    let mut random = Random(pairs as u64);
    let mut bins: Vec<u32> = (0..pairs).map(|_| first + random.below(end - first)).collect();
    bins.sort_unstable();
    bins
}

#[test]
fn lists_and_empty_tiles_of_all_kinds() {
    let gpu = open();
    for pairs in [1, 2, 255, 256, PAIR_BLOCK - 1, PAIR_BLOCK, PAIR_BLOCK + 1, 20_000] {
        // All tiles; a few of many; none at either end; all pairs in the first, in the last, in the only one.
        for (first, end, bin_count) in [(0, 40, 40), (0, 5000, 5000), (17, 23, 3000), (0, 1, 50), (49, 50, 50), (0, 1, 1)] {
            let bins = sorted_bins(pairs, first, end);
            compare(&gpu, pairs as u32, &bins, &bins, bin_count)
                .unwrap_or_else(|error| panic!("{pairs} pairs in tiles {first} to {end} of {bin_count}: {error}"));
        }
    }
}

#[test]
fn pairs_without_room_are_left_out() {
    let gpu = open();
    let bins = sorted_bins(3000, 0, 100);
    for pairs in [0, 1, 2999, 3000, 3001, 1_000_000] {
        compare(&gpu, pairs, &bins, &bins, 100).unwrap_or_else(|error| panic!("{pairs} pairs, room for 3000: {error}"));
    }
}

#[test]
fn a_pair_in_the_next_tile_is_seen() {
    let gpu = open();
    let bins = sorted_bins(3000, 0, 100);
    let mut changed = bins.clone();
    let last_of_50 = bins.partition_point(|&bin| bin <= 50) - 1;
    compare(&gpu, 3000, &bins, &changed, 100).unwrap();
    changed[last_of_50] += 1;
    assert!(compare(&gpu, 3000, &bins, &changed, 100).is_err());
}
