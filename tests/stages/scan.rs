//! `scan.comp`: where each (camera, chunk) begins, and how many records there are.

use decouplegs::render::layout::{Needs, SCAN_BLOCK};
use decouplegs::render::stages::Scan;
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, found, identical, open, run, sort_shape, untouched, upload};
use crate::device::Validated;

/// Scans `counts` on the device and by the twin, which is given `twin_counts`.
fn compare(gpu: &Validated, counts: &[u32], twin_counts: &[u32], records_max: u32) -> Result<(), String> {
    let sort_block = sort_shape(gpu).block();
    let before = Needs { records: UNTOUCHED, ..Needs::default() };
    let control = control(gpu, before, &[]);
    let firsts = untouched(gpu, counts.len());
    let scan = Scan::new(gpu, sort_block).unwrap();
    run(gpu, |r| scan.record(r, &upload(gpu, counts), &firsts, counts.len(), records_max as usize, &control));
    let (needs, arguments) = found(gpu, &control);

    let (mut twin_needs, mut twin_arguments) = (before, vec![[UNTOUCHED; 3]; arguments.len()]);
    let mut twin_firsts = vec![UNTOUCHED; counts.len()];
    twins::scan(twin_counts, &mut twin_firsts, &mut twin_needs, &mut twin_arguments, records_max, sort_block);
    identical("firsts", &gpu.read(&firsts).unwrap(), &twin_firsts)?;
    identical("needs", &[needs], &[twin_needs])?;
    identical("arguments", &arguments, &twin_arguments)
}

fn counts(len: usize, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..len).map(|_| if random.below(3) == 0 { 0 } else { random.below(257) }).collect()
}

#[test]
fn sums_of_every_length_around_a_block() {
    let gpu = open();
    for len in [0, 1, 2, 255, 256, 257, SCAN_BLOCK - 1, SCAN_BLOCK, SCAN_BLOCK + 1, 2 * SCAN_BLOCK, 7 * SCAN_BLOCK + 300, 100_000]
    {
        let counts = counts(len, len as u64);
        compare(&gpu, &counts, &counts, u32::MAX).unwrap_or_else(|error| panic!("{len} counts: {error}"));
    }
}

#[test]
fn what_follows_is_sized_by_the_room_there_is() {
    let gpu = open();
    let counts = counts(3000, 1);
    for records_max in [0, 1, 1000, 100_000] {
        compare(&gpu, &counts, &counts, records_max).unwrap_or_else(|error| panic!("room for {records_max}: {error}"));
    }
    compare(&gpu, &[0; 5000], &[0; 5000], 10).unwrap();
    // More groups than fit along one axis.
    let full = [200_000_000; 3];
    compare(&gpu, &full, &full, u32::MAX).unwrap();
}

#[test]
fn a_count_of_one_more_is_seen() {
    let gpu = open();
    let counts = counts(2000, 2);
    let mut changed = counts.clone();
    compare(&gpu, &counts, &changed, u32::MAX).unwrap();
    changed[1999] += 1;
    assert!(compare(&gpu, &counts, &changed, u32::MAX).unwrap_err().starts_with("needs"));
    changed[5] += 1;
    assert!(compare(&gpu, &counts, &changed, u32::MAX).unwrap_err().starts_with("firsts"));
}
