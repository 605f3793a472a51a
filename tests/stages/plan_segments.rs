//! `plan_segments.comp`: segments of lists and how their results are joined.

use bytemuck::Zeroable;
use decouplegs::render::Capacity;
use decouplegs::render::layout::{BlendItem, Composite, NOT_BLENDED, RequiredCounts};
use decouplegs::render::stages::{Plan, PlanSegments, TileLists};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, counters, found, identical, open, run, upload};
use crate::device::Validated;

/// Lists of these lengths, cut at `segment_pairs`.
struct Case<'a> {
    lengths: &'a [u32],
    segment_pairs: u32,
    pairs_max: usize,
    partials_max: usize,
}

impl Case<'_> {
    /// First index and length of each list, the last list first.
    fn tile_lists(&self) -> Vec<[u32; 2]> {
        let mut first = 0;
        let held = |length: u32| if length == NOT_BLENDED { 0 } else { length };
        let mut lists: Vec<_> = self
            .lengths
            .iter()
            .rev()
            .map(|&length| {
                first += held(length);
                [first - held(length), length]
            })
            .collect();
        lists.reverse();
        lists
    }

    /// Plans on the device, and by a twin that cuts at `twin_segment_pairs`.
    fn compare(&self, gpu: &Validated, twin_segment_pairs: u32) -> Result<RequiredCounts, String> {
        let bin_count = self.lengths.len() as u32;
        let capacity = Capacity {
            records: 1,
            pairs: self.pairs_max,
            partials: self.partials_max,
            tiles: 1,
        };
        let held = |&&length: &&u32| length != NOT_BLENDED;
        let pairs = self.lengths.iter().filter(held).sum::<u32>();
        let tile_lists = self.tile_lists();
        let before = RequiredCounts {
            pairs,
            pairs_low: pairs & 0xffff,
            pairs_high: pairs >> 16,
            ..RequiredCounts::default()
        };
        let counters = counters(gpu, before, &[]);
        let plan = Plan::new(gpu, &capacity, bin_count).unwrap();
        let mut items = vec![
            BlendItem {
                bin: UNTOUCHED,
                ..BlendItem::zeroed()
            };
            plan.items.len()
        ];
        let mut composites = vec![
            Composite {
                bin: UNTOUCHED,
                ..Composite::zeroed()
            };
            plan.composites.len()
        ];
        gpu.write(&plan.items, 0, &items).unwrap();
        gpu.write(&plan.composites, 0, &composites).unwrap();
        let plan_segments = PlanSegments::new(gpu, self.segment_pairs).unwrap();
        run(gpu, |r| {
            plan_segments.record(
                r,
                &counters,
                TileLists {
                    lists: &upload(gpu, &tile_lists),
                    count: bin_count,
                },
                &capacity,
                &plan,
            );
        });
        let (required, arguments) = found(gpu, &counters);

        let (mut twin_required, mut twin_arguments) =
            (before, vec![[UNTOUCHED; 3]; arguments.len()]);
        twins::plan_segments(
            &mut twin_required,
            &tile_lists,
            &mut items,
            &mut composites,
            &mut twin_arguments,
            bin_count,
            self.pairs_max as u32,
            self.partials_max as u32,
            twin_segment_pairs,
        );
        identical("items", &gpu.read(&plan.items).unwrap(), &items)?;
        identical(
            "composites",
            &gpu.read(&plan.composites).unwrap(),
            &composites,
        )?;
        identical("required", &[required], &[twin_required])?;
        identical("arguments", &arguments, &twin_arguments)?;
        Ok(required)
    }
}

fn lengths(bins: usize) -> Vec<u32> {
    let mut random = Random(bins as u64);
    (0..bins)
        .map(|_| match random.below(4) {
            0 => 0,
            1 => random.below(60),
            2 => 64 * random.below(20),
            _ => random.below(5000),
        })
        .collect()
}

#[test]
fn lists_of_all_lengths_are_cut() {
    let gpu = open();
    for bins in [1, 2, 255, 256, 257, 2000] {
        let lengths = lengths(bins);
        for segment_pairs in [64, 256, 1024, u32::MAX] {
            let case = Case {
                lengths: &lengths,
                segment_pairs,
                pairs_max: 1 << 24,
                partials_max: 1 << 18,
            };
            let required = case
                .compare(&gpu, segment_pairs)
                .unwrap_or_else(|error| panic!("{bins} lists, {segment_pairs}: {error}"));
            assert_eq!(
                required.partials == 0,
                segment_pairs == u32::MAX || required.composites == 0
            );
        }
    }
}

#[test]
fn edges_of_a_segment() {
    let gpu = open();
    let lengths = [0, 1, 255, 256, 257, 511, 512, 513, 25_600, 25_601];
    let case = Case {
        lengths: &lengths,
        segment_pairs: 256,
        pairs_max: 1 << 20,
        partials_max: 1 << 10,
    };
    let required = case.compare(&gpu, 256).unwrap();
    assert_eq!(
        (required.items, required.partials, required.composites),
        (
            4 + 2 + 2 + 2 + 3 + 100 + 101,
            2 + 2 + 2 + 3 + 100 + 101,
            4 + 2 * 8
        )
    );
}

#[test]
fn no_pairs_is_an_item_a_tile() {
    let gpu = open();
    let lengths = [0; 700];
    let case = Case {
        lengths: &lengths,
        segment_pairs: 64,
        pairs_max: 10,
        partials_max: 10,
    };
    assert_eq!(case.compare(&gpu, 64).unwrap().items, 700);
}

#[test]
fn coarse_tiles_that_are_not_blended_have_no_segment() {
    let gpu = open();
    for bins in [1, 256, 600] {
        let mut lengths = lengths(bins);
        for length in lengths.iter_mut().step_by(3) {
            *length = NOT_BLENDED;
        }
        let blended = lengths.iter().filter(|&&length| length != NOT_BLENDED);
        let segments: u32 = blended.map(|length| length.div_ceil(64).max(1)).sum();
        let case = Case {
            lengths: &lengths,
            segment_pairs: 64,
            pairs_max: 1 << 24,
            partials_max: 1 << 18,
        };
        assert_eq!(case.compare(&gpu, 64).unwrap().items, segments);
    }
}

#[test]
fn what_has_no_room_is_counted_and_not_written() {
    let gpu = open();
    let lengths = lengths(600);
    for partials_max in [1, 2, 100, 1000] {
        let case = Case {
            lengths: &lengths,
            segment_pairs: 64,
            pairs_max: 1 << 24,
            partials_max,
        };
        let required = case
            .compare(&gpu, 64)
            .unwrap_or_else(|error| panic!("room for {partials_max}: {error}"));
        assert!(
            required.partials as usize > partials_max,
            "the case must not fit"
        );
    }
}

#[test]
fn another_segment_length_is_seen() {
    let gpu = open();
    let lengths = lengths(300);
    let case = Case {
        lengths: &lengths,
        segment_pairs: 64,
        pairs_max: 1 << 24,
        partials_max: 1 << 18,
    };
    case.compare(&gpu, 64).unwrap();
    assert!(case.compare(&gpu, 65).is_err());
}
