//! `merge_order.comp`: background and agents in one order.

use decouplegs::render::layout::{CAMERAS_MAX, Needs, ViewLists};
use decouplegs::render::stages::{Arguments, MergeOrder, OrderPlan};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, untouched, upload};
use crate::device::Validated;

/// Keys of background and agents of each camera, in order.
struct Case {
    keys: Vec<[Vec<u32>; 2]>,
}

/// `count` sorted keys, each below `end`, plus `first`.
fn keys(count: usize, first: u32, end: u32, random: &mut Random) -> Vec<u32> {
    let mut keys: Vec<u32> = (0..count).map(|_| first + random.below(end)).collect();
    keys.sort_unstable();
    keys
}

impl Case {
    /// Where the lists lie: the backgrounds of all cameras, then the agents; and how many blocks they have.
    fn lists(&self) -> (Vec<ViewLists>, usize) {
        let statics: usize = self.keys.iter().map(|[background, _]| background.len()).sum();
        let mut next = ViewLists { first_moving: statics as u32, ..ViewLists::default() };
        let mut lists = Vec::new();
        for [background, agents] in &self.keys {
            let list = ViewLists { static_count: background.len() as u32, moving_count: agents.len() as u32, ..next };
            lists.push(list);
            next.first_static += list.static_count;
            next.first_moving += list.moving_count;
            next.first_ordered += list.static_count + list.moving_count;
            next.first_block += (list.static_count + list.moving_count).div_ceil(1024);
        }
        (lists, next.first_block as usize)
    }

    /// Keys and values as the sort leaves them: a value tells which record it is.
    fn sorted(&self) -> (Vec<u32>, Vec<u32>) {
        let side = |side: usize| self.keys.iter().flat_map(move |lists| &lists[side]).copied();
        let keys: Vec<u32> = side(0).chain(side(1)).collect();
        let values = (0..keys.len() as u32).map(|place| place.wrapping_mul(2_654_435_761)).collect();
        (keys, values)
    }

    fn kernel(&self, gpu: &Validated) -> Vec<u32> {
        let ((lists, blocks), (keys, values)) = (self.lists(), self.sorted());
        let plan = OrderPlan::new(gpu).unwrap();
        gpu.write(&plan.lists, 0, &lists).unwrap();
        // One place more than there are records stays as it is.
        let order = untouched(gpu, keys.len() + 1);
        let control = control(gpu, Needs::default(), &[(Arguments::Merge, blocks)]);
        let (merge, keys, values) = (MergeOrder::new(gpu).unwrap(), upload(gpu, &keys), upload(gpu, &values));
        run(gpu, |r| merge.record(r, lists.len(), &plan, &keys, &values, &order, &control));
        gpu.read(&order).unwrap()
    }

    fn twin(&self) -> Vec<u32> {
        let (keys, values) = self.sorted();
        let mut order = vec![UNTOUCHED; keys.len() + 1];
        twins::merge_order(&self.lists().0, &keys, &values, &mut order, self.keys.len());
        order
    }

    fn compare(&self, gpu: &Validated, what: &str) {
        identical(what, &self.kernel(gpu), &self.twin()).unwrap();
    }
}

/// Lengths around a block of 1024, one list with every other.
const LENGTHS: [usize; 9] = [0, 1, 2, 255, 1023, 1024, 1025, 2048, 3001];

#[test]
fn lists_of_every_length_around_a_block() {
    let gpu = open();
    let mut random = Random(1);
    for moving in LENGTHS {
        // Nine cameras, so that the blocks of one are next to those of another.
        let camera = |&length: &usize| [keys(length, 0, 5000, &mut random), keys(moving, 0, 5000, &mut Random(moving as u64))];
        Case { keys: LENGTHS.iter().map(camera).collect() }.compare(&gpu, &format!("{moving} of agents"));
    }
}

#[test]
fn keys_of_every_kind() {
    let gpu = open();
    let mut random = Random(2);
    let even: Vec<u32> = (0..2500).map(|i| 2 * i).collect();
    let odd: Vec<u32> = even.iter().map(|key| key + 1).collect();
    let (low, high) = (keys(1500, 0, 1000, &mut random), keys(1700, 1000, 1000, &mut random));
    let clouded = [keys(4000, 0, u32::MAX, &mut random), keys(700, 1 << 31, 1 << 20, &mut random)];
    let ends = [vec![0, 0, u32::MAX, u32::MAX], vec![0, u32::MAX]];
    for (what, keys) in [
        ("random", clouded),
        ("all background first", [low.clone(), high.clone()]),
        ("all agents first", [high, low]),
        ("interleaved", [even.clone(), odd.clone()]),
        ("interleaved the other way", [odd, even.clone()]),
        ("the same twice", [even.clone(), even]),
        ("few keys, many times", [keys(3000, 0, 3, &mut random), keys(2000, 0, 3, &mut random)]),
        ("the least and the largest", ends),
    ] {
        Case { keys: vec![keys] }.compare(&gpu, what);
    }
}

#[test]
fn of_equal_keys_the_background_comes_first() {
    let gpu = open();
    for (background, agents) in [(1500, 1500), (3000, 10), (10, 3000)] {
        let case = Case { keys: vec![[vec![7; background], vec![7; agents]]] };
        case.compare(&gpu, "all equal");
        let records = case.sorted().1;
        identical("records in their own order", &case.kernel(&gpu)[..records.len()], &records).unwrap();
    }
}

#[test]
fn the_order_is_that_of_a_stable_sort() {
    let gpu = open();
    let mut random = Random(5);
    let case = Case { keys: vec![[keys(5000, 0, 900, &mut random), keys(2500, 300, 900, &mut random)]] };
    let (keys, values) = case.sorted();
    let mut records: Vec<usize> = (0..keys.len()).collect();
    records.sort_by_key(|&record| keys[record]);
    let expected: Vec<u32> = records.iter().map(|&record| values[record]).collect();
    identical("order", &case.kernel(&gpu)[..expected.len()], &expected).unwrap();
}

#[test]
fn as_many_cameras_as_there_may_be() {
    let gpu = open();
    let mut random = Random(3);
    let mut camera = |i: usize| [keys(i * 97 % 1500, 0, 500, &mut random), keys(i * 61 % 1100, 0, 500, &mut random)];
    Case { keys: (0..CAMERAS_MAX).map(&mut camera).collect() }.compare(&gpu, "32 cameras");
}

#[test]
fn no_lists_are_nothing() {
    let gpu = open();
    let empty = || [Vec::new(), Vec::new()];
    Case { keys: vec![empty(), empty()] }.compare(&gpu, "empty lists");
    Case { keys: vec![empty(), [vec![3], Vec::new()], empty(), [Vec::new(), vec![2]]] }.compare(&gpu, "one record each");
}

#[test]
fn one_swapped_record_is_seen() {
    let gpu = open();
    let mut random = Random(4);
    let case = Case { keys: vec![[keys(900, 0, 100, &mut random), keys(800, 0, 100, &mut random)]] };
    let (kernel, mut twin) = (case.kernel(&gpu), case.twin());
    identical("order", &kernel, &twin).unwrap();
    twin.swap(1200, 1201);
    assert!(identical("order", &kernel, &twin).unwrap_err().contains("2 differ; value 1200"));
}
