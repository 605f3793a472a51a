//! `plan_order.comp`: where the lists of records lie and which of them are sorted.

use decouplegs::render::layout::{CAMERAS_MAX, Needs, OrderStep, SortSegment, ViewLists, ViewOrder};
use decouplegs::render::stages::{OrderPlan, PlanOrder};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, found, identical, open, run, upload};
use crate::device::Validated;

const SORT_BLOCK: u32 = 1024;

/// What the frame found: records a `[camera][chunk]` of background and agents, and how the lists come into order.
struct Case {
    static_counts: Vec<u32>,
    moving_counts: Vec<u32>,
    paths: Vec<OrderStep>,
    inversions: Vec<u32>,
    records_max: usize,
}

/// What it makes of that.
struct Planned {
    lists: Vec<ViewLists>,
    segments: Vec<SortSegment>,
    needs: Needs,
    arguments: Vec<[u32; 3]>,
}

fn firsts_of(counts: &[u32]) -> Vec<u32> {
    let mut firsts = vec![0; counts.len() + 1];
    twins::scan(counts, &mut firsts);
    firsts
}

impl Case {
    /// Lists of all lengths for `cameras`, in all ways of ordering them, of so many chunks of background and agents.
    fn random(cameras: usize, chunks: [usize; 2], seed: u64) -> Self {
        let mut random = Random(seed);
        let mut counts = |chunks: usize| -> Vec<u32> {
            (0..cameras * chunks)
                .map(|_| match random.below(4) {
                    0 => 0,
                    1 => 1 + random.below(3),
                    2 => 1024 * random.below(3),
                    _ => random.below(5000),
                })
                .collect()
        };
        let [static_counts, moving_counts] = chunks.map(&mut counts);
        let steps = [OrderStep::Sorted, OrderStep::Kept, OrderStep::Repaired];
        let records = static_counts.iter().chain(&moving_counts).sum::<u32>() as usize;
        Self {
            static_counts,
            moving_counts,
            paths: (0..cameras).map(|_| steps[random.below(3) as usize]).collect(),
            inversions: (0..cameras).map(|_| random.below(2) * random.below(100)).collect(),
            records_max: records,
        }
    }

    fn cameras(&self) -> usize {
        self.paths.len()
    }

    fn records(&self) -> u32 {
        self.static_counts.iter().chain(&self.moving_counts).sum()
    }

    fn chunks(&self) -> [usize; 2] {
        [self.static_counts.len() / self.cameras(), self.moving_counts.len() / self.cameras()]
    }

    fn view_orders(&self) -> Vec<ViewOrder> {
        self.paths.iter().map(|&path| ViewOrder { path: path as u32, rank_set: 0 }).collect()
    }

    /// What no camera's plan has reached.
    fn before() -> (Vec<ViewLists>, Vec<SortSegment>, Needs) {
        let list = ViewLists { first_static: UNTOUCHED, ..ViewLists::default() };
        let segment = SortSegment { first: UNTOUCHED, ..SortSegment::default() };
        (vec![list; CAMERAS_MAX], vec![segment; 2 * CAMERAS_MAX], Needs { pairs: UNTOUCHED, ..Needs::default() })
    }

    fn kernel(&self, gpu: &Validated) -> Planned {
        let plan = OrderPlan::new(gpu).unwrap();
        let (lists, segments, needs) = Self::before();
        gpu.write(&plan.view_orders, 0, &self.view_orders()).unwrap();
        gpu.write(&plan.inversions, 0, &self.inversions).unwrap();
        gpu.write(&plan.lists, 0, &lists).unwrap();
        gpu.write(&plan.segments, 0, &segments).unwrap();
        let control = control(gpu, needs, &[]);
        let [static_firsts, moving_firsts] =
            [&self.static_counts, &self.moving_counts].map(|counts| upload(gpu, &firsts_of(counts)));
        let plan_order = PlanOrder::new(gpu, SORT_BLOCK).unwrap();
        let ([static_chunks, moving_chunks], cameras, room) = (self.chunks(), self.cameras(), self.records_max);
        run(gpu, |r| {
            plan_order.record(r, cameras, &static_firsts, static_chunks, &moving_firsts, moving_chunks, room, &plan, &control);
        });
        let (needs, arguments) = found(gpu, &control);
        Planned { lists: gpu.read(&plan.lists).unwrap(), segments: gpu.read(&plan.segments).unwrap(), needs, arguments }
    }

    fn twin(&self) -> Planned {
        let (lists, segments, needs) = Self::before();
        let arguments = vec![[UNTOUCHED; 3]; decouplegs::render::layout::ARGUMENT_SETS];
        let mut planned = Planned { lists, segments, needs, arguments };
        let [static_chunks, moving_chunks] = self.chunks();
        twins::plan_order(
            &self.view_orders(),
            &firsts_of(&self.static_counts),
            &firsts_of(&self.moving_counts),
            &self.inversions,
            &mut planned.lists,
            &mut planned.segments,
            &mut planned.needs,
            &mut planned.arguments,
            self.cameras(),
            static_chunks,
            moving_chunks,
            self.records_max as u32,
            SORT_BLOCK,
        );
        planned
    }

    fn compare(&self, gpu: &Validated) -> Planned {
        let kernel = self.kernel(gpu);
        check(&kernel, &self.twin()).unwrap_or_else(|error| panic!("{} cameras, {:?}: {error}", self.cameras(), self.chunks()));
        kernel
    }
}

fn check(kernel: &Planned, twin: &Planned) -> Result<(), String> {
    identical("lists", &kernel.lists, &twin.lists)?;
    identical("segments", &kernel.segments, &twin.segments)?;
    identical("needs", &[kernel.needs], &[twin.needs])?;
    identical("arguments", &kernel.arguments, &twin.arguments)
}

#[test]
fn lists_of_any_length_ordered_in_any_way() {
    let gpu = open();
    let mut all_records = 0;
    for cameras in [1, 2, 6, CAMERAS_MAX] {
        for chunks in [[1, 1], [3, 0], [0, 2], [7, 5]] {
            let case = Case::random(cameras, chunks, (cameras + 2 * chunks[0]) as u64);
            let drawn = |list: &ViewLists| list.static_count + list.moving_count;
            assert_eq!(case.compare(&gpu).lists[..cameras].iter().map(drawn).sum::<u32>(), case.records());
            all_records += case.records();
        }
    }
    assert!(all_records > 100_000, "{all_records} records in all");
}

#[test]
fn every_record_is_in_one_list_and_one_place_of_the_order() {
    let gpu = open();
    let case = Case::random(6, [4, 3], 9);
    let (planned, records) = (case.compare(&gpu), case.records() as usize);
    let (mut records_in, mut places_in) = (vec![0; records], vec![0; records]);
    for list in &planned.lists[..6] {
        for (first, count) in [(list.first_static, list.static_count), (list.first_moving, list.moving_count)] {
            records_in[first as usize..(first + count) as usize].iter_mut().for_each(|lists| *lists += 1);
        }
        let end = list.first_ordered + list.static_count + list.moving_count;
        places_in[list.first_ordered as usize..end as usize].iter_mut().for_each(|lists| *lists += 1);
    }
    assert!(records_in.iter().chain(&places_in).all(|&lists| lists == 1));
}

#[test]
fn no_records_are_nothing_to_do() {
    let gpu = open();
    let case = Case { static_counts: vec![0; 6], moving_counts: vec![0; 3], ..Case::random(3, [2, 1], 1) };
    let planned = Case { records_max: 10, ..case }.compare(&gpu);
    let groups: u32 = planned.arguments.iter().filter(|groups| groups[0] != UNTOUCHED).map(|groups| groups[0]).sum();
    assert_eq!((planned.needs.records, groups), (0, 0));
}

#[test]
fn records_without_room_are_counted_and_not_drawn() {
    let gpu = open();
    let full = Case::random(5, [3, 2], 4);
    let records = full.records();
    assert!(full.compare(&gpu).lists[..5].iter().map(|list| list.static_count + list.moving_count).sum::<u32>() == records);
    for room in [records - 1, 1, 0] {
        let planned = Case { records_max: room as usize, ..Case::random(5, [3, 2], 4) }.compare(&gpu);
        assert_eq!(planned.needs.records, records);
        assert!(planned.lists[..5].iter().all(|list| list.static_count + list.moving_count == 0));
        assert!(planned.arguments.iter().all(|groups| groups[0] == UNTOUCHED || groups[0] == 0));
    }
}

#[test]
fn only_what_is_not_in_order_is_sorted() {
    let gpu = open();
    let case = Case {
        static_counts: vec![2000; 4],
        moving_counts: vec![300; 4],
        paths: vec![OrderStep::Sorted, OrderStep::Kept, OrderStep::Repaired, OrderStep::Repaired],
        // What a kept order is wrong by is told and not sorted.
        inversions: vec![0, 7, 0, 1],
        records_max: 10_000,
    };
    let counts: Vec<u32> = case.compare(&gpu).segments[..8].iter().map(|segment| segment.count).collect();
    assert_eq!(counts, [2000, 300, 0, 300, 0, 300, 2000, 300]);
}

#[test]
fn one_changed_plan_is_seen() {
    let gpu = open();
    let case = Case::random(3, [2, 2], 6);
    let kernel = case.kernel(&gpu);
    let failure = |change: fn(&mut Planned)| {
        let mut twin = case.twin();
        check(&kernel, &twin).unwrap();
        change(&mut twin);
        check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(|twin| twin.lists[2].first_block += 1).contains("lists: 1 differ; value 2"));
    assert!(failure(|twin| twin.segments[5].count += 1).contains("segments: 1 differ; value 5"));
    assert!(failure(|twin| twin.needs.records += 1).contains("needs"));
    assert!(failure(|twin| twin.arguments[0][0] += 1).contains("arguments"));
}
