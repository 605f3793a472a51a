//! `scan.comp`: exclusive sums and their total.

use decouplegs::render::layout::SCAN_BLOCK;
use decouplegs::render::stages::Scan;
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, identical, open, run, untouched, upload};
use crate::device::Validated;

/// Scans `counts` on the device and by the twin, which is given `twin_counts`.
fn compare(gpu: &Validated, counts: &[u32], twin_counts: &[u32]) -> Result<(), String> {
    let offsets = untouched(gpu, counts.len() + 3);
    let scan = Scan::new(gpu).unwrap();
    run(gpu, |r| {
        scan.record(r, &upload(gpu, counts), &offsets, counts.len());
    });
    let mut twin_offsets = vec![UNTOUCHED; counts.len() + 3];
    twins::scan(twin_counts, &mut twin_offsets);
    identical("offsets", &gpu.read(&offsets).unwrap(), &twin_offsets)
}

fn counts(len: usize, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..len)
        .map(|_| {
            if random.below(3) == 0 {
                0
            } else {
                random.below(257)
            }
        })
        .collect()
}

#[test]
fn sums_of_every_length_around_a_block() {
    let gpu = open();
    for len in [
        0,
        1,
        2,
        255,
        256,
        257,
        SCAN_BLOCK - 1,
        SCAN_BLOCK,
        SCAN_BLOCK + 1,
        2 * SCAN_BLOCK,
        7 * SCAN_BLOCK + 300,
        100_000,
    ] {
        let counts = counts(len, len as u64);
        compare(&gpu, &counts, &counts).unwrap_or_else(|error| panic!("{len} counts: {error}"));
    }
}

#[test]
fn counts_of_nothing_and_of_very_much() {
    let gpu = open();
    compare(&gpu, &[0; 5000], &[0; 5000]).unwrap();
    compare(&gpu, &[200_000_000; 3], &[200_000_000; 3]).unwrap();
}

#[test]
fn a_count_of_one_more_is_seen() {
    let gpu = open();
    let counts = counts(2000, 2);
    let mut changed = counts.clone();
    compare(&gpu, &counts, &changed).unwrap();
    changed[1999] += 1;
    assert!(
        compare(&gpu, &counts, &changed)
            .unwrap_err()
            .contains("value 2000"),
        "the total"
    );
    changed[5] += 1;
    assert!(
        compare(&gpu, &counts, &changed)
            .unwrap_err()
            .contains("value 6")
    );
}
