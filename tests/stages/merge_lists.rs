//! `plan_merges.comp` and `merge_lists.comp`: kept lists merged with those of agents.

use bytemuck::Zeroable;
use decouplegs::gpu::Buffer;
use decouplegs::render::Capacity;
use decouplegs::render::layout::{MERGE_PAIRS, MergePiece, NOT_BLENDED, RequiredCounts, SLABS};
use decouplegs::render::stages::{
    DrawnAlone, IndirectArguments, MergeBuffers, MergeLists, Projected, RecordContents, Records,
    SortedLists, TileLists, TileSort, TileSortBuffers,
};
use decouplegs::render::twins;
use decouplegs::scene::{DepthOrder, Rules};

use super::tile_sort::Case as SortCase;
use super::{Random, UNTOUCHED, counters, found, identical, open, run, untouched, upload};
use crate::device::Validated;

/// Lists of coarse tiles: records of the background are those below `background`, and agents' lie
/// behind.
struct Case {
    keys: Vec<u32>,
    background: u32,
    kept: Vec<Vec<u32>>,
    moving: Vec<Vec<u32>>,
    /// Coarse tiles that the image shows, and whether that counts.
    drawn_alone: Vec<u32>,
    drawn_holds: bool,
    /// Pairs that there is room for beside those that the case has.
    spare: i64,
}

impl Case {
    /// Lists of the given lengths; keys are below `key_count`, so that few of them are many ties.
    fn random(lengths: &[(usize, usize)], key_count: u32, seed: u64) -> Self {
        let mut random = Random(seed);
        let background: usize = lengths.iter().map(|length| length.0).sum();
        let all: usize = background + lengths.iter().map(|length| length.1).sum::<usize>();
        let keys: Vec<u32> = (0..all).map(|_| random.below(key_count)).collect();
        let mut first = [0, background as u32];
        let mut next = |half: usize, length: usize| {
            let mut records: Vec<u32> = (first[half]..first[half] + length as u32).collect();
            first[half] += length as u32;
            records.sort_unstable_by_key(|&record| (keys[record as usize], record));
            records
        };
        let (kept, moving) = lengths
            .iter()
            .map(|&(kept, moving)| (next(0, kept), next(1, moving)))
            .unzip();
        Self {
            keys,
            background: background as u32,
            kept,
            moving,
            drawn_alone: Vec::new(),
            drawn_holds: false,
            spare: 0,
        }
    }

    fn pairs(&self) -> usize {
        self.kept.iter().chain(&self.moving).map(Vec::len).sum()
    }

    /// Merges on the device and by the twin, and compares lists, pieces and counts. Returns the
    /// records of each list, and none where it is not merged.
    fn compare(&self, gpu: &Validated) -> Result<Vec<Vec<u32>>, String> {
        let bins = self.kept.len() as u32;
        let room = (self.pairs() as i64 + self.spare) as usize;
        let capacity = Capacity {
            records: self.keys.len(),
            pairs: room,
            partials: 1,
            tiles: 1,
        };
        let projected =
            Projected::new(gpu, self.keys.len(), room, RecordContents::default()).unwrap();
        gpu.write(&projected.keys, 0, &self.keys).unwrap();
        let moving = TileSortBuffers::new(gpu, &capacity, bins).unwrap();
        let buffers = MergeBuffers::new(gpu, &capacity, bins).unwrap();
        let (kept_lists, kept_records) = laid_out(&self.kept);
        let (moving_lists, moving_records) = laid_out(&self.moving);
        let mut all = vec![UNTOUCHED; 2 * room];
        all[..kept_records.len().min(2 * room)].copy_from_slice(&kept_records);
        gpu.write(&moving.tile_lists, 0, &moving_lists).unwrap();
        let written = &moving_records[..moving_records.len().min(room)];
        gpu.write(&moving.sorted_records, 0, written).unwrap();
        gpu.write(&buffers.kept_lists, 0, &kept_lists).unwrap();
        gpu.write(&buffers.sorted_records, 0, &all).unwrap();
        let counts = |records: &[u32]| RequiredCounts {
            pairs_low: records.len() as u32 & 0xffff,
            pairs_high: records.len() as u32 >> 16,
            ..RequiredCounts::default()
        };
        let kept_required = counts(&kept_records);
        gpu.write(&buffers.kept_required, 0, &[kept_required])
            .unwrap();
        let mut pieces = vec![
            MergePiece {
                bin: UNTOUCHED,
                ..MergePiece::zeroed()
            };
            buffers.pieces.len()
        ];
        gpu.write(&buffers.pieces, 0, &pieces).unwrap();
        let drawn_alone = upload(gpu, &self.drawn_alone);
        let counters = counters(gpu, counts(&moving_records), &[]);
        let merge = MergeLists::new(gpu).unwrap();
        run(gpu, |r| {
            let lists = TileLists {
                lists: &moving.tile_lists,
                count: bins,
            };
            let drawn = DrawnAlone {
                tiles: &drawn_alone,
                holds: self.drawn_holds,
            };
            merge.record_plan(r, &counters, lists, &buffers, drawn);
            let records = &moving.sorted_records;
            merge.record(
                r,
                &counters,
                SortedLists { lists, records },
                &projected,
                &buffers,
            );
        });
        let (required, arguments) = found(gpu, &counters);

        let mut twin_required = counts(&moving_records);
        let mut twin_arguments = vec![[UNTOUCHED; 3]; arguments.len()];
        let mut twin_drawn = self.drawn_alone.clone();
        let mut lists = vec![[0; 2]; bins as usize];
        twins::plan_merges(
            &mut twin_required,
            &kept_required,
            &kept_lists,
            &moving_lists,
            &mut lists,
            &mut pieces,
            &mut twin_arguments,
            &mut twin_drawn,
            room as u32,
            self.drawn_holds,
        );
        identical("lists", &gpu.read(&buffers.merged_lists).unwrap(), &lists)?;
        identical("pieces", &gpu.read(&buffers.pieces).unwrap(), &pieces)?;
        identical("required", &[required], &[twin_required])?;
        identical("arguments", &arguments, &twin_arguments)?;
        identical("drawn", &gpu.read(&drawn_alone).unwrap(), &twin_drawn)?;
        if self.spare >= 0 {
            for (bin, &[first, length]) in lists.iter().enumerate() {
                if !self.moving[bin].is_empty() {
                    let merged = twins::merge_lists(&self.kept[bin], &self.moving[bin], &self.keys);
                    all[first as usize..][..length as usize].copy_from_slice(&merged);
                }
            }
        }
        let sorted = gpu.read(&buffers.sorted_records).unwrap();
        identical("records", &sorted, &all)?;
        let records = |&[first, length]: &[u32; 2]| match length {
            NOT_BLENDED => Vec::new(),
            length => sorted[first as usize..][..length as usize].to_vec(),
        };
        Ok(lists.iter().map(records).collect())
    }

    /// Merges, and compares the lists with their definition too: all records in the order of depth
    /// keys, then in their own.
    fn check(&self, gpu: &Validated) {
        let merged = self.compare(gpu).unwrap();
        for (bin, merged) in merged.iter().enumerate() {
            let mut all = [&self.kept[bin][..], &self.moving[bin][..]].concat();
            all.sort_unstable_by_key(|&record| (self.keys[record as usize], record));
            identical(&format!("coarse tile {bin}"), merged, &all).unwrap();
        }
        assert!(
            self.kept
                .iter()
                .flatten()
                .all(|&record| record < self.background)
        );
    }
}

/// First index and length of each list, the last list first, and all records.
fn laid_out(lists: &[Vec<u32>]) -> (Vec<[u32; 2]>, Vec<u32>) {
    let mut records = Vec::new();
    let mut laid: Vec<_> = lists
        .iter()
        .rev()
        .map(|list| {
            records.extend_from_slice(list);
            [(records.len() - list.len()) as u32, list.len() as u32]
        })
        .collect();
    laid.reverse();
    (laid, records)
}

#[test]
fn lists_of_all_lengths_are_merged() {
    let gpu = open();
    let edges = [0, 1, 127, 128, 129, 1023, 1024, 1025, 5000];
    let lengths: Vec<_> = edges
        .iter()
        .flat_map(|&kept| edges.map(|moving| (kept, moving)))
        .collect();
    for key_count in [1, 2, 300, u32::MAX] {
        Case::random(&lengths, key_count, 7).check(&gpu);
    }
}

#[test]
fn a_hundred_thousand_layers_are_merged() {
    let gpu = open();
    for lengths in [(100_000, 1), (100_000, 3000), (10, 100_000), (0, 100_000)] {
        for key_count in [1, 1000, u32::MAX] {
            Case::random(&[lengths, (5, 0)], key_count, 9).check(&gpu);
        }
    }
}

#[test]
fn agents_before_and_behind_all_of_the_background_are_merged() {
    let gpu = open();
    for (kept_key, moving_key) in [(5, 4), (5, 5), (5, 6)] {
        let mut case = Case::random(&[(3000, 2500), (1, 1024), (1024, 1)], 1, 3);
        let background = case.background as usize;
        case.keys[..background].fill(kept_key);
        case.keys[background..].fill(moving_key);
        case.check(&gpu);
    }
}

/// Lengths of many lists, most without agents.
fn street(bins: usize) -> Vec<(usize, usize)> {
    let mut random = Random(bins as u64);
    (0..bins)
        .map(|_| {
            let moving = match random.below(4) {
                0 => random.below(700),
                _ => 0,
            };
            (random.below(900) as usize, moving as usize)
        })
        .collect()
}

#[test]
fn coarse_tiles_that_the_image_shows_are_not_blended() {
    let gpu = open();
    for bins in [1, 255, 256, 257, 1500] {
        let mut case = Case::random(&street(bins), 1000, 4);
        case.drawn_alone = (0..bins).map(|bin| u32::from(bin % 3 > 0)).collect();
        case.check(&gpu); // nothing holds
        case.drawn_holds = true;
        let lists = case.compare(&gpu).unwrap();
        let is_left_out = |bin: usize| case.moving[bin].is_empty() && case.drawn_alone[bin] == 1;
        let blended = lists.iter().map(|list| !list.is_empty());
        for (bin, blended) in blended.enumerate() {
            let empty = case.kept[bin].is_empty() && case.moving[bin].is_empty();
            assert_eq!(blended, !is_left_out(bin) && !empty, "coarse tile {bin}");
        }
    }
}

#[test]
fn what_has_no_room_is_counted_and_not_merged() {
    let gpu = open();
    for spare in [-1, -2000] {
        let case = Case {
            spare,
            ..Case::random(&street(300), 1000, 5)
        };
        case.compare(&gpu).unwrap();
    }
    let roomy = Case {
        spare: 3000,
        ..Case::random(&street(300), 1000, 5)
    };
    roomy.check(&gpu);
}

#[test]
fn records_in_another_order_are_seen() {
    let gpu = open();
    let mut case = Case::random(&[(400, 300)], 10, 6);
    case.compare(&gpu).unwrap();
    // Lists that are not in the order of keys have no merged list that both agree on.
    case.moving[0].reverse();
    assert!(case.compare(&gpu).unwrap_err().starts_with("records"));
}

/// Lists of the background and of agents, sorted by themselves and merged, are those of one sort.
#[test]
fn merged_lists_of_several_cameras_are_those_of_one_sort() {
    let gpu = open();
    let radial = Rules {
        order: DepthOrder::Radial,
        ..Rules::DEFAULT
    };
    for rules in [Rules::DEFAULT, radial] {
        let case = SortCase::hard(&gpu, 3000, rules);
        let expected = case.twin().records;
        let (bins, pairs) = (case.bins(), expected.iter().map(Vec::len).sum());
        let capacity = Capacity {
            records: case.keys.len(),
            pairs,
            partials: 1,
            tiles: 1,
        };
        let projected =
            Projected::new(&gpu, case.keys.len(), pairs, RecordContents::default()).unwrap();
        gpu.write(&projected.footprints, 0, &case.footprints)
            .unwrap();
        gpu.write(&projected.keys, 0, &case.keys).unwrap();
        let sort = TileSort::new(&gpu, &rules).unwrap();
        let merge = MergeLists::new(&gpu).unwrap();
        let buffers = MergeBuffers::new(&gpu, &capacity, bins).unwrap();
        let own = TileSortBuffers::new(&gpu, &capacity, bins).unwrap();
        let offsets = [&case.static_offsets, &case.moving_offsets].map(|all| upload(&gpu, all));
        let sorted = |lists: &TileSortBuffers, moving_only: bool| {
            let counters = counters(&gpu, RequiredCounts::default(), &[]);
            gpu.write(&lists.slab_counts, 0, &vec![0; bins as usize * SLABS])
                .unwrap();
            let records = Records {
                cameras: &case.camera_buffer,
                camera_count: case.cameras.len(),
                projected: &projected,
                static_offsets: &offsets[0],
                static_clusters: 1,
                moving_offsets: &offsets[1],
                moving_clusters: usize::from(moving_only),
                moving_only,
                other_keys: &buffers.other_keys,
            };
            run(&gpu, |r| sort.record(r, &counters, records, lists, bins));
            counters
        };
        let kept = sorted(&buffers.kept_sort(&own), false);
        let (kept, _) = found(&gpu, &kept);
        assert_eq!(2 * kept.records as usize, case.keys.len());
        gpu.write(&buffers.kept_required, 0, &[kept]).unwrap();
        let counters = sorted(&own, true);
        let (moving, arguments) = found(&gpu, &counters);
        assert_eq!(moving.first_binned, kept.records);
        assert_eq!(moving.records as usize, case.keys.len());
        assert_eq!(2 * moving.pairs as usize, pairs);
        assert_eq!(arguments[IndirectArguments::Merge as usize], [UNTOUCHED; 3]);
        let none: Buffer<u32> = untouched(&gpu, 0);
        run(&gpu, |r| {
            let lists = TileLists {
                lists: &own.tile_lists,
                count: bins,
            };
            let drawn = DrawnAlone {
                tiles: &none,
                holds: false,
            };
            merge.record_plan(r, &counters, lists, &buffers, drawn);
            let records = &own.sorted_records;
            merge.record(
                r,
                &counters,
                SortedLists { lists, records },
                &projected,
                &buffers,
            );
        });
        let records = gpu.read(&buffers.sorted_records).unwrap();
        let lists = gpu.read(&buffers.merged_lists).unwrap();
        let mut longest = 0;
        for (bin, (&[first, length], expected)) in lists.iter().zip(&expected).enumerate() {
            let merged = &records[first as usize..][..length as usize];
            identical(&format!("coarse tile {bin}"), merged, expected).unwrap();
            longest = longest.max(expected.len());
        }
        assert!(longest > MERGE_PAIRS, "no list has more than a piece");
        assert_eq!(
            gpu.read(&projected.keys).unwrap()[..case.keys.len()],
            case.keys
        );
    }
}
