//! `emit_pairs.comp`: a pair for every macro tile that a record reaches.

use decouplegs::render::layout::{Needs, PAIR_BLOCK, SortSegment, ViewLists};
use decouplegs::render::stages::{Arguments, EmitPairs, Pairs, Projected};
use decouplegs::render::twins;
use decouplegs::render::twins::record::load_footprint;
use decouplegs::scene::Rules;

use super::project::PLAIN;
use super::scenes::{ProjectedTwin, Scene, hard_world, rig, settled_tile_count};
use super::{Random, UNTOUCHED, control, found, identical, open, run, sort_shape, untouched, upload};
use crate::device::Validated;

/// Records of a rig, in an order.
struct Case {
    scene: Scene,
    lists: Vec<ViewLists>,
    projected: ProjectedTwin,
    order: Vec<u32>,
}

/// The lists that begin at `firsts`, `[camera][chunk]`. There are no agents.
fn view_lists(firsts: &[u32], chunks: usize, records: u32) -> Vec<ViewLists> {
    let first = |camera: usize| firsts.get(camera * chunks).copied().unwrap_or(records);
    let list = |camera: usize| ViewLists { first_static: first(camera), first_moving: records, ..ViewLists::default() };
    (0..firsts.len() / chunks).map(list).collect()
}

type PairLists = (Vec<u32>, Vec<u32>);

impl Case {
    /// Records whose macro tiles do not depend on rounding, in random order.
    fn new(gpu: &Validated, splats: usize, seed: u64) -> Self {
        let rules = Rules::DEFAULT;
        let scene = Scene::new(gpu, &hard_world(splats, seed), &rig());
        let listed = scene.listed(&rules);
        let all = scene.projected(&listed, &rules, PLAIN, listed.records.len());
        let chunks = scene.chunks.len();
        let mut kept = Vec::new();
        let mut firsts = Vec::new();
        for (list, &first) in listed.firsts.iter().enumerate() {
            firsts.push(kept.len() as u32);
            let end = listed.firsts.get(list + 1).map_or(listed.records.len(), |&end| end as usize);
            kept.extend((first as usize..end).filter(|&record| {
                settled_tile_count(&load_footprint(&all.footprints, record), &scene.view.cameras[list / chunks]).is_some()
            }));
        }
        assert!(kept.len() * 20 >= listed.records.len() * 19, "rounding decides too many of the records");
        let take = |record: &usize| [all.footprints[2 * record], all.footprints[2 * record + 1]];
        let projected = ProjectedTwin {
            footprints: kept.iter().flat_map(take).collect(),
            colours: vec![[0.0; 4]; kept.len()],
            keys: vec![0; kept.len()],
            values: vec![0; kept.len()],
            tile_counts: kept.iter().map(|&record| all.tile_counts[record]).collect(),
        };
        let lists = view_lists(&firsts, chunks, kept.len() as u32);
        let order = Random(seed).shuffled(kept.len());
        Self { scene, lists, projected, order }
    }

    fn pairs(&self) -> usize {
        self.projected.tile_counts.iter().map(|&count| count as usize).sum()
    }

    /// Emits on the device and by the twin, with room for `pairs_max`; returns both lists of (tiles, records).
    fn emit(&self, gpu: &Validated, records: usize, pairs_max: usize) -> Result<[PairLists; 2], String> {
        let sort_block = sort_shape(gpu).block();
        let cameras = &self.scene.view.cameras;
        let room = self.order.len();
        let before = Needs { records: records as u32, pairs: 0, ..Needs::default() };
        let blocks = if records > room { 0 } else { records.div_ceil(PAIR_BLOCK) };
        let mut pair_counts = vec![0; blocks];
        twins::count_pairs(&before, &self.order, &self.projected.tile_counts, &mut pair_counts, room as u32);

        let control = control(gpu, before, &[(Arguments::PairBlocks, blocks)]);
        let projected = Projected::new(gpu, room).unwrap();
        gpu.write(&projected.footprints, 0, &self.projected.footprints).unwrap();
        gpu.write(&projected.tile_counts, 0, &self.projected.tile_counts).unwrap();
        let [order, pair_counts] = [&self.order, &pair_counts].map(|data| upload(gpu, data));
        let lists = upload(gpu, &self.lists);
        let (bins, records) = (untouched(gpu, pairs_max), untouched(gpu, pairs_max));
        let pairs = Pairs { bins: &bins, records: &records };
        let emit = EmitPairs::new(gpu, sort_block).unwrap();
        let camera_buffer = &self.scene.camera_buffer;
        run(gpu, |r| {
            emit.record(r, &control, camera_buffer, cameras.len(), &lists, &order, &projected, &pair_counts, &pairs);
        });
        let (needs, arguments) = found(gpu, &control);

        let (mut twin_needs, mut twin_bins, mut twin_records) = (before, vec![UNTOUCHED; pairs_max], vec![UNTOUCHED; pairs_max]);
        let mut twin_segment = SortSegment::default();
        let mut twin_arguments = vec![[UNTOUCHED; 3]; arguments.len()];
        twin_arguments[Arguments::PairBlocks as usize] = arguments[Arguments::PairBlocks as usize];
        twins::emit_pairs(
            cameras,
            &mut twin_needs,
            &self.order,
            &self.lists,
            &self.projected.footprints,
            &mut twin_bins,
            &mut twin_records,
            &mut twin_arguments,
            &mut twin_segment,
            room as u32,
            sort_block,
        );
        identical("needs", &[needs], &[twin_needs])?;
        identical("arguments", &arguments, &twin_arguments)?;
        identical("segment", &gpu.read(&control.pair_segment).unwrap(), &[twin_segment])?;
        Ok([(gpu.read(&bins).unwrap(), gpu.read(&records).unwrap()), (twin_bins, twin_records)])
    }

    /// Compares the pairs of all records that are emitted whole. Their order within a record is open.
    fn check(&self, kernel: &PairLists, twin: &PairLists) -> Result<(), String> {
        let mut first = 0;
        for &record in &self.order {
            let end = first + self.projected.tile_counts[record as usize] as usize;
            if end > twin.0.len() {
                break;
            }
            identical(&format!("records at pair {first}"), &kernel.1[first..end], &twin.1[first..end])?;
            let [a, b] = [kernel, twin].map(|list| {
                let mut bins = list.0[first..end].to_vec();
                bins.sort_unstable();
                bins
            });
            identical(&format!("tiles of record {record}"), &a, &b)?;
            first = end;
        }
        Ok(())
    }
}

#[test]
fn every_macro_tile_of_every_record() {
    let gpu = open();
    let case = Case::new(&gpu, 5000, 1);
    let (records, pairs) = (case.order.len(), case.pairs());
    let many = case.projected.tile_counts.iter().filter(|&&count| count > 12).count();
    println!("{records} records, {pairs} pairs; {many} records reach more than 12 macro tiles");
    assert!(records > 3 * PAIR_BLOCK && many > 100, "the case must fill blocks and hold large splats");
    let [kernel, twin] = case.emit(&gpu, records, pairs).unwrap();
    case.check(&kernel, &twin).unwrap();
    assert!(!kernel.0.contains(&UNTOUCHED), "as many pairs as were counted");
}

#[test]
fn pairs_without_room_are_counted_and_not_written() {
    let gpu = open();
    let case = Case::new(&gpu, 1500, 2);
    let (records, pairs) = (case.order.len(), case.pairs());
    for pairs_max in [1, 100, pairs - 1, pairs, pairs + 1000] {
        let [kernel, twin] = case.emit(&gpu, records, pairs_max).unwrap_or_else(|error| panic!("room for {pairs_max}: {error}"));
        case.check(&kernel, &twin).unwrap();
        assert!(kernel.0[pairs.min(pairs_max)..].iter().all(|&bin| bin == UNTOUCHED));
    }
    for records in [0, 1, 255, 256, 257] {
        let [kernel, twin] = case.emit(&gpu, records, pairs).unwrap_or_else(|error| panic!("{records} records: {error}"));
        let emitted = twin.1.iter().filter(|&&record| record != UNTOUCHED).count();
        assert_eq!(kernel.1.iter().filter(|&&record| record != UNTOUCHED).count(), emitted);
    }
}

#[test]
fn one_wrong_tile_is_seen() {
    let gpu = open();
    let case = Case::new(&gpu, 500, 3);
    let [kernel, mut twin] = case.emit(&gpu, case.order.len(), case.pairs()).unwrap();
    case.check(&kernel, &twin).unwrap();
    twin.0[case.pairs() / 2] += 1;
    assert!(case.check(&kernel, &twin).unwrap_err().starts_with("tiles"));
}
