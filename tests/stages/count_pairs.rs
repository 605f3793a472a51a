//! `count_pairs.comp`: pairs of each block of records in depth order.

use decouplegs::render::layout::{Needs, PAIR_BLOCK};
use decouplegs::render::stages::{Arguments, CountPairs, Projected};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, untouched, upload};
use crate::device::Validated;

/// Counts the pairs of `records` records where there is room for `tile_counts.len()`; the twin is given `twin_counts`.
fn compare(gpu: &Validated, records: u32, tile_counts: &[u32], twin_counts: &[u32]) -> Result<(), String> {
    let room = tile_counts.len();
    let blocks = room.div_ceil(PAIR_BLOCK);
    let order = Random(u64::from(records)).shuffled(room);
    let needs = Needs { records, ..Needs::default() };
    let used_blocks = (records as usize).min(room).div_ceil(PAIR_BLOCK);
    let control = control(gpu, needs, &[(Arguments::PairBlocks, used_blocks)]);
    let projected = Projected::new(gpu, room).unwrap();
    gpu.write(&projected.tile_counts, 0, tile_counts).unwrap();
    let pair_counts = untouched(gpu, blocks);
    let count_pairs = CountPairs::new(gpu).unwrap();
    run(gpu, |r| count_pairs.record(r, &control, &upload(gpu, &order), &projected, &pair_counts));

    let mut twin = vec![UNTOUCHED; blocks];
    twins::count_pairs(&needs, &order, twin_counts, &mut twin, room as u32);
    identical("pair_counts", &gpu.read(&pair_counts).unwrap(), &twin)
}

fn tile_counts(room: usize) -> Vec<u32> {
    let mut random = Random(room as u64);
    (0..room).map(|_| if random.below(50) == 0 { random.below(100_000) } else { random.below(4) }).collect()
}

#[test]
fn blocks_are_added_up() {
    let gpu = open();
    for room in [1, 255, PAIR_BLOCK - 1, PAIR_BLOCK, PAIR_BLOCK + 1, 10 * PAIR_BLOCK + 3] {
        let counts = tile_counts(room);
        for records in [0, 1, room as u32 / 2, room as u32, room as u32 + 1000] {
            compare(&gpu, records, &counts, &counts)
                .unwrap_or_else(|error| panic!("{records} records, room for {room}: {error}"));
        }
    }
}

#[test]
fn one_tile_more_is_seen() {
    let gpu = open();
    let counts = tile_counts(3000);
    let mut changed = counts.clone();
    compare(&gpu, 3000, &counts, &changed).unwrap();
    changed[1234] += 1;
    assert!(compare(&gpu, 3000, &counts, &changed).is_err());
}
