//! `plan_lists.comp`, `count_pairs.comp`, `plan_buckets.comp`, `fill_pairs.comp`,
//! `split_slabs.comp` and `sort_buckets.comp`: from records to sorted lists of coarse tiles.

use decouplegs::gpu::Buffer;
use decouplegs::render::Capacity;
use decouplegs::render::layout::{
    BUCKET_PAIRS, Bucket, CameraRecord, NO_BIN, PAIR_BLOCK, RequiredCounts, SHARED_PAIRS, SLABS,
    View,
};
use decouplegs::render::stages::{
    IndirectArguments, Plan, PlanBuckets, PlanSegments, Projected, RecordContents, Records,
    TileLists, TileSort, TileSortBuffers,
};
use decouplegs::render::twins;
use decouplegs::render::twins::depth_key::{depth_key, depth_of_key};
use decouplegs::render::twins::record::load_footprint;
use decouplegs::scene::{DepthOrder, Rules};
use glam::DVec3;

use super::project::PLAIN;
use super::scenes::{Scene, hard_world, rig, settled_tile_count};
use super::{Random, UNTOUCHED, counters, found, identical, open, run, upload};
use crate::device::Validated;
use crate::frames::camera_at;

/// Records of a rig: those of the background by camera, and those of agents by camera behind them.
pub(super) struct Case {
    pub(super) cameras: Vec<CameraRecord>,
    pub(super) camera_buffer: Buffer<CameraRecord>,
    pub(super) footprints: Vec<[u32; 4]>,
    pub(super) keys: Vec<u32>,
    /// First record of each camera in its half, and the number of all in it.
    pub(super) static_offsets: Vec<u32>,
    pub(super) moving_offsets: Vec<u32>,
    rules: Rules,
}

/// Lists as they were sorted, by coarse tile, and the lengths of its buckets in their order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sorted {
    pub(super) records: Vec<Vec<u32>>,
    buckets: Vec<Vec<u32>>,
}

/// Compares the lists and buckets of all coarse tiles.
fn check_lists(kernel: &Sorted, twin: &Sorted) -> Result<(), String> {
    for (bin, (kernel, twin)) in kernel.records.iter().zip(&twin.records).enumerate() {
        identical(&format!("records of coarse tile {bin}"), kernel, twin)?;
    }
    identical("buckets", &kernel.buckets, &twin.buckets)
}

impl Case {
    /// Hard splats whose coarse tiles do not depend on rounding. Agents are the background once
    /// more, so that all keys are tied.
    pub(super) fn hard(gpu: &Validated, splats: usize, rules: Rules) -> Self {
        let scene = Scene::new(gpu, &hard_world(splats, 41), &rig());
        let listed = scene.listed(&rules);
        let all = scene.projected(&listed, &rules, PLAIN, listed.records.len());
        let mut case = Self {
            cameras: scene.view.cameras.clone(),
            camera_buffer: scene.camera_buffer.clone(),
            footprints: Vec::new(),
            keys: Vec::new(),
            static_offsets: vec![0],
            moving_offsets: vec![0],
            rules,
        };
        for camera in 0..case.cameras.len() {
            for record in
                (0..listed.records.len()).filter(|&record| listed.records[record].0 == camera)
            {
                if settled_tile_count(
                    &load_footprint(
                        &all.footprints,
                        record,
                        case.cameras[camera].mean_shift,
                        [0; 2],
                    ),
                    &case.cameras[camera],
                    &rules,
                )
                .is_some()
                {
                    case.footprints
                        .extend([all.footprints[2 * record], all.footprints[2 * record + 1]]);
                    case.keys.push(all.keys[record]);
                }
            }
            case.static_offsets.push(case.keys.len() as u32);
        }
        assert!(
            case.keys.len() * 20 >= listed.records.len() * 19,
            "rounding decides too many of the records"
        );
        case.footprints.extend_from_within(..);
        case.keys.extend_from_within(..);
        case.moving_offsets = case.static_offsets.clone();
        case
    }

    /// Records that all lie in the one coarse tile of one camera.
    fn pile(gpu: &Validated, keys: Vec<u32>) -> Self {
        let view = View::new(&[camera_at(DVec3::ZERO, 64, 32)], DVec3::ZERO, 100.0).unwrap();
        let footprint =
            [[32.0f32, 16.0, 0.0, 0.5], [0.5, -0.1, 1.0, 0.0]].map(|half| half.map(f32::to_bits));
        Self {
            camera_buffer: upload(gpu, &view.cameras),
            cameras: view.cameras,
            footprints: footprint.repeat(keys.len()),
            static_offsets: vec![0, keys.len() as u32],
            moving_offsets: vec![0],
            keys,
            rules: Rules::DEFAULT,
        }
    }

    pub(super) fn bins(&self) -> u32 {
        self.cameras.iter().map(CameraRecord::bins).sum()
    }

    pub(super) fn twin(&self) -> Sorted {
        let statics = *self.static_offsets.last().unwrap();
        let lists: Vec<_> = (0..self.cameras.len())
            .map(|camera| decouplegs::render::layout::ViewLists {
                first_static: self.static_offsets[camera],
                first_moving: statics + self.moving_offsets.get(camera).unwrap_or(&0),
            })
            .collect();
        let (cameras, rules) = (&self.cameras, &self.rules);
        let slabs = twins::bin_pairs(cameras, &lists, &self.keys, &self.footprints, rules);
        let sorted = |tile: &[Vec<[u32; 2]>]| {
            let mut pairs = tile.concat();
            pairs.sort_unstable();
            pairs.into_iter().map(|[_, record]| record).collect()
        };
        let lengths = |tile: &[Vec<[u32; 2]>]| {
            twins::plan_buckets(
                &tile
                    .iter()
                    .map(|slab| slab.len() as u32)
                    .collect::<Vec<_>>(),
            )
            .into_iter()
            .filter(|&pairs| pairs > 0)
            .collect()
        };
        Sorted {
            records: slabs.chunks(SLABS).map(sorted).collect(),
            buckets: slabs.chunks(SLABS).map(lengths).collect(),
        }
    }

    /// Lists of the kernels with room for `pairs_max` pairs, and their counts; `None` if the pairs
    /// do not fit.
    fn kernel(
        &self,
        gpu: &Validated,
        pairs_max: usize,
    ) -> Result<(Option<Sorted>, RequiredCounts), String> {
        let bins = self.bins();
        let counters = counters(gpu, RequiredCounts::default(), &[]);
        let projected =
            Projected::new(gpu, self.keys.len(), pairs_max, RecordContents::default()).unwrap();
        gpu.write(&projected.footprints, 0, &self.footprints)
            .unwrap();
        gpu.write(&projected.keys, 0, &self.keys).unwrap();
        let capacity = Capacity {
            records: self.keys.len(),
            pairs: pairs_max,
            partials: 1,
            tiles: 1,
        };
        let buffers = TileSortBuffers::new(gpu, &capacity, bins).unwrap();
        gpu.write(&buffers.slab_counts, 0, &vec![0; bins as usize * SLABS])
            .unwrap();
        gpu.write(&buffers.sorted_records, 0, &vec![UNTOUCHED; pairs_max])
            .unwrap();
        let (static_offsets, moving_offsets) = (
            upload(gpu, &self.static_offsets),
            upload(gpu, &self.moving_offsets),
        );
        let records = Records {
            cameras: &self.camera_buffer,
            camera_count: self.cameras.len(),
            projected: &projected,
            static_offsets: &static_offsets,
            static_clusters: 1,
            moving_offsets: &moving_offsets,
            moving_clusters: usize::from(self.moving_offsets.len() > 1),
            moving_only: false,
            other_keys: &projected.keys,
        };
        let sort = TileSort::new(gpu, &self.rules).unwrap();
        run(gpu, |r| sort.record(r, &counters, records, &buffers, bins));
        let (required, _) = found(gpu, &counters);
        if required.records as usize != self.keys.len() {
            return Err(format!(
                "{} records instead of {}",
                required.records,
                self.keys.len()
            ));
        }
        let all = gpu.read(&buffers.sorted_records).unwrap();
        if required.pairs as usize > pairs_max {
            identical("records without room", &all, &vec![UNTOUCHED; pairs_max])?;
            return Ok((None, required));
        }
        let tile_lists = gpu.read(&buffers.tile_lists).unwrap();
        let records = tile_lists
            .iter()
            .map(|&[first, length]| all[first as usize..(first + length) as usize].to_vec())
            .collect();
        // Buckets as they were planned: long slabs stand at the end, and their pieces are buckets
        // of no coarse tile.
        let listed = gpu.read(&buffers.buckets).unwrap();
        let (planned, long) = (required.buckets as usize, required.long_slabs as usize);
        assert!(planned + long <= listed.len(), "buckets have no room");
        let mut buckets: Vec<Bucket> = listed[..planned].to_vec();
        buckets.retain(|bucket| bucket.bin != NO_BIN);
        let pieces = planned - buckets.len();
        assert!(
            pieces <= required.pieces as usize,
            "{pieces} pieces, {} counted",
            required.pieces
        );
        assert_eq!(required.planned, bins, "coarse tiles that are planned");
        buckets.extend_from_slice(&listed[listed.len() - long..]);
        buckets.retain(|bucket| bucket.pairs > 0 && bucket.part == 0);
        buckets.sort_unstable();
        let of_tile = |bin: usize| {
            let own = buckets.iter().filter(|bucket| bucket.bin as usize == bin);
            let mut end = tile_lists[bin][0];
            own.map(|bucket| {
                assert_eq!(
                    bucket.first_pair, end,
                    "buckets of a tile follow each other"
                );
                end += bucket.pairs;
                bucket.pairs
            })
            .collect()
        };
        Ok((
            Some(Sorted {
                records,
                buckets: (0..bins as usize).map(of_tile).collect(),
            }),
            required,
        ))
    }

    fn compare(&self, gpu: &Validated) -> Result<Sorted, String> {
        let twin = self.twin();
        let pairs: usize = twin.records.iter().map(Vec::len).sum();
        let (kernel, required) = self.kernel(gpu, pairs)?;
        let kernel = kernel.ok_or("as many pairs as the twin has do not fit")?;
        check_lists(&kernel, &twin)?;
        let counts = [
            required.pairs,
            (required.pairs_high << 16) + required.pairs_low,
            required.long_slabs,
        ];
        let long = |&&pairs: &&u32| pairs > SHARED_PAIRS as u32;
        let long_slabs = twin.buckets.iter().flatten().filter(long);
        let long_slabs = long_slabs.map(|&pairs| twins::slab_parts(pairs)).sum();
        identical("counts", &counts, &[pairs as u32, pairs as u32, long_slabs])?;
        Ok(kernel)
    }
}

#[test]
fn lists_of_hard_splats_are_those_of_the_definition() {
    let gpu = open();
    for rules in [
        Rules::DEFAULT,
        Rules::NUREC,
        Rules {
            order: DepthOrder::Radial,
            ..Rules::DEFAULT
        },
    ] {
        let case = Case::hard(&gpu, 5000, rules);
        let sorted = case.compare(&gpu).unwrap();
        let pairs: usize = sorted.records.iter().map(Vec::len).sum();
        let longest = sorted.records.iter().map(Vec::len).max().unwrap();
        println!(
            "{} records, {pairs} pairs in {} coarse tiles, at most {longest}",
            case.keys.len(),
            case.bins()
        );
        assert!(
            case.keys.len() > 3 * PAIR_BLOCK && longest > BUCKET_PAIRS,
            "the case must fill blocks and cut lists"
        );
        assert!(sorted.buckets.iter().any(|buckets| buckets.len() > 1));
        let large = case.kernel(&gpu, pairs).unwrap().1.large as usize;
        assert!(
            0 < large && large < case.keys.len() / 2,
            "{large} records with many coarse tiles"
        );
    }
}

/// Keys of `count` splats that are hard to sort, by name.
fn hard_keys(count: usize) -> Vec<(&'static str, Vec<u32>)> {
    let mut random = Random(count as u64);
    let near = depth_key(0.3);
    let mut all: Vec<(&str, Vec<u32>)> = vec![
        ("equal", vec![near; count]),
        ("any", (0..count).map(|_| random.word()).collect()),
        (
            "two",
            (0..count).map(|i| near + (i as u32 * 7 % 2)).collect(),
        ),
        ("falling", (0..count).map(|i| near - i as u32).collect()),
        (
            "in one slab",
            (0..count).map(|_| near + random.below(1 << 12)).collect(),
        ),
        (
            "a wall and others",
            (0..count)
                .map(|i| {
                    if i % 8 == 0 {
                        depth_key(f64::from(random.between(0.0, 0.9)))
                    } else {
                        near + random.below(64)
                    }
                })
                .collect(),
        ),
        (
            "behind the last slab",
            (0..count)
                .map(|_| depth_key(0.99) + random.below(1 << 20))
                .collect(),
        ),
    ];
    all.push((
        "uniform depths",
        (0..count)
            .map(|_| depth_key(f64::from(random.between(0.001, 0.99))))
            .collect(),
    ));
    all
}

#[test]
fn piles_of_all_sizes_are_sorted() {
    let gpu = open();
    for count in [1, 2, 255, 257, 511, 512, 513, 1023, 1024, 1025, 2048, 5000] {
        for (name, keys) in hard_keys(count) {
            Case::pile(&gpu, keys)
                .compare(&gpu)
                .unwrap_or_else(|error| panic!("{count} keys, {name}: {error}"));
        }
    }
}

#[test]
fn a_hundred_thousand_layers_of_one_depth_are_sorted() {
    let gpu = open();
    let near = depth_key(0.3);
    Case::pile(&gpu, vec![near; 100_000]).compare(&gpu).unwrap();
    let mut random = Random(3);
    Case::pile(
        &gpu,
        (0..100_000).map(|_| near + random.below(1 << 14)).collect(),
    )
    .compare(&gpu)
    .unwrap();
}

#[test]
fn pairs_without_room_are_counted_and_not_written() {
    let gpu = open();
    let case = Case::hard(&gpu, 1000, Rules::DEFAULT);
    let pairs: usize = case.twin().records.iter().map(Vec::len).sum();
    for pairs_max in [1, pairs / 2, pairs - 1] {
        let (sorted, required) = case.kernel(&gpu, pairs_max).unwrap();
        assert!(
            sorted.is_none() && required.pairs as usize == pairs,
            "{required:?}"
        );
    }
    assert_eq!(
        case.kernel(&gpu, pairs + 1000).unwrap().0,
        Some(case.twin())
    );
}

#[test]
fn more_pairs_than_32_bits_hold_do_not_look_like_few() {
    let gpu = open();
    let capacity = Capacity {
        records: 1,
        pairs: 5000,
        partials: 4,
        tiles: 1,
    };
    let bins = 9u32;
    // Eight times 2^30 wrap to nothing.
    let counters = counters(&gpu, RequiredCounts::default(), &[]);
    let buffers = TileSortBuffers::new(&gpu, &capacity, bins).unwrap();
    let counts: Vec<u32> = (0..bins as usize * SLABS)
        .map(|i| {
            if i % SLABS == 7 && i < 8 * SLABS {
                1 << 30
            } else {
                0
            }
        })
        .collect();
    gpu.write(&buffers.slab_counts, 0, &counts).unwrap();
    let plan = Plan::new(&gpu, &capacity, bins).unwrap();
    let (buckets, segments) = (
        PlanBuckets::new(&gpu).unwrap(),
        PlanSegments::new(&gpu, 1024).unwrap(),
    );
    let lists = TileLists {
        lists: &buffers.tile_lists,
        count: bins,
    };
    run(&gpu, |r| {
        buckets.record(r, &counters, &buffers, bins);
        segments.record(r, &counters, lists, &capacity, &plan);
    });
    let (required, arguments) = found(&gpu, &counters);
    assert_eq!((required.pairs, required.longest), (u32::MAX, 1 << 30));
    assert_eq!(
        arguments[IndirectArguments::Blend as usize][0],
        0,
        "nothing is blended"
    );
}

#[test]
fn the_slab_never_falls_with_the_key() {
    let mut random = Random(9);
    for _ in 0..10_000 {
        let (a, b) = (random.word(), random.word());
        let (low, high) = (a.min(b), a.max(b));
        let (camera_depth, key_scale) = (random.between(-0.9, 0.9), 1.0 / 128.0);
        assert!(
            twins::depth_slab(low, camera_depth, key_scale)
                <= twins::depth_slab(high, camera_depth, key_scale)
        );
        assert!(depth_of_key(low) <= depth_of_key(high));
    }
    assert_ne!(
        twins::depth_slab(depth_key(0.1), 0.0, 1.0 / 128.0),
        twins::depth_slab(depth_key(0.2), 0.0, 1.0 / 128.0)
    );
}

#[test]
fn records_in_another_order_are_seen() {
    let gpu = open();
    let case = Case::hard(&gpu, 500, Rules::DEFAULT);
    let kernel = case.compare(&gpu).unwrap();
    let mut twin = case.twin();
    let tile = twin
        .records
        .iter()
        .position(|records| records.len() > 1)
        .unwrap();
    twin.records[tile].swap(0, 1);
    let tile_records = format!("records of coarse tile {tile}");
    assert!(
        check_lists(&kernel, &twin)
            .unwrap_err()
            .starts_with(&tile_records)
    );
    twin.records[tile].swap(0, 1);
    twin.buckets[tile][0] += 1;
    assert!(
        check_lists(&kernel, &twin)
            .unwrap_err()
            .starts_with("buckets")
    );
}
