//! `repair_order.comp`, `check_order.comp` and `restore_order.comp`: almost sorted lists are put right, or taken back.

use decouplegs::render::layout::{CAMERAS_MAX, Needs, OrderStep, ViewLists, ViewOrder};
use decouplegs::render::stages::{Arguments, OrderPlan, REPAIR_WINDOW, RepairOrder, SortScratch, StaticLists};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, sort_shape, upload};
use crate::device::Validated;

/// Half a window: nothing may be farther from its place than this for two rounds to be enough.
const REACH: usize = REPAIR_WINDOW / 2;

/// Lists of keys and values, one a camera, each in two chunks, and rounds of repair.
struct Case {
    lists: Vec<(OrderStep, Vec<(u32, u32)>)>,
    rounds: u32,
    /// Room for records; the lists end there.
    room: usize,
}

/// What the kernels or their twins leave.
#[derive(Clone)]
struct Repaired {
    keys: Vec<u32>,
    values: Vec<u32>,
    inversions: Vec<u32>,
    restored_keys: Vec<u32>,
    restored_values: Vec<u32>,
}

impl Case {
    fn new(lists: Vec<(OrderStep, Vec<(u32, u32)>)>, rounds: u32) -> Self {
        let room = lists.iter().map(|(_, list)| list.len()).sum();
        Self { lists, rounds, room }
    }

    /// One list, repaired.
    fn of(list: Vec<(u32, u32)>, rounds: u32) -> Self {
        Self::new(vec![(OrderStep::Repaired, list)], rounds)
    }

    fn view_orders(&self) -> Vec<ViewOrder> {
        self.lists.iter().map(|&(path, _)| ViewOrder { path: path as u32, rank_set: 0 }).collect()
    }

    fn firsts(&self) -> Vec<u32> {
        let counts: Vec<u32> =
            self.lists.iter().flat_map(|(_, list)| [list.len() as u32 / 3, (list.len() - list.len() / 3) as u32]).collect();
        let mut firsts = vec![0; counts.len() + 1];
        twins::scan(&counts, &mut firsts);
        firsts
    }

    /// Where the lists lie for the kernel that restores them: nothing where they have no room.
    fn view_lists(&self) -> Vec<ViewLists> {
        let firsts = self.firsts();
        let fits = firsts[firsts.len() - 1] as usize <= self.room;
        let list = |camera: usize| ViewLists {
            first_static: firsts[2 * camera],
            static_count: if fits { firsts[2 * camera + 2] - firsts[2 * camera] } else { 0 },
            ..ViewLists::default()
        };
        (0..self.lists.len()).map(list).collect()
    }

    fn entries(&self) -> (Vec<u32>, Vec<u32>) {
        self.lists.iter().flat_map(|(_, list)| list).take(self.room).copied().unzip()
    }

    /// Keys in splat order: any will do.
    fn unranked_keys(&self) -> Vec<u32> {
        let mut random = Random(77);
        (0..self.room).map(|_| random.word()).collect()
    }

    fn kernel(&self, gpu: &Validated) -> Repaired {
        let (repair, cameras) = (RepairOrder::new(gpu).unwrap(), self.lists.len());
        let plan = OrderPlan::new(gpu).unwrap();
        gpu.write(&plan.view_orders, 0, &self.view_orders()).unwrap();
        gpu.write(&plan.inversions, 0, &vec![0; cameras]).unwrap();
        gpu.write(&plan.lists, 0, &self.view_lists()).unwrap();
        let sort = SortScratch::new(gpu, sort_shape(gpu), self.room).unwrap();
        let (keys, values) = self.entries();
        gpu.write(&sort.keys[0], 0, &keys).unwrap();
        gpu.write(&sort.values[0], 0, &values).unwrap();
        gpu.write(&sort.keys[1], 0, &self.unranked_keys()).unwrap();
        let firsts = upload(gpu, &self.firsts());
        let lists = StaticLists { camera_count: cameras, chunk_count: 2, firsts: &firsts, records_max: self.room };
        run(gpu, |r| {
            repair.record_rounds(r, lists, &plan, &sort, self.rounds);
            repair.record_check(r, lists, &plan, &sort);
        });
        let (keys, values) = (gpu.read(&sort.keys[0]).unwrap(), gpu.read(&sort.values[0]).unwrap());
        let control = control(gpu, Needs::default(), &[(Arguments::Restore, self.room.div_ceil(1024))]);
        run(gpu, |r| repair.record_restore(r, cameras, &plan, &sort, &control));
        Repaired {
            keys,
            values,
            inversions: gpu.read(&plan.inversions).unwrap()[..cameras].to_vec(),
            restored_keys: gpu.read(&sort.keys[0]).unwrap(),
            restored_values: gpu.read(&sort.values[0]).unwrap(),
        }
    }

    fn twin(&self) -> Repaired {
        let (orders, firsts, cameras, room) = (self.view_orders(), self.firsts(), self.lists.len(), self.room as u32);
        let (mut keys, mut values) = self.entries();
        for round in 0..self.rounds as usize {
            twins::repair_order(&orders, &firsts, &mut keys, &mut values, cameras, 2, room, round % 2 * REACH);
        }
        let mut inversions = vec![0; cameras];
        twins::check_order(&orders, &firsts, &keys, &values, &mut inversions, cameras, 2, room);
        let (mut restored_keys, mut restored_values) = (keys.clone(), values.clone());
        let (lists, unranked) = (self.view_lists(), self.unranked_keys());
        twins::restore_order(&orders, &inversions, &lists, &unranked, &mut restored_keys, &mut restored_values, cameras);
        Repaired { keys, values, inversions, restored_keys, restored_values }
    }

    fn compare(&self, gpu: &Validated) -> Repaired {
        let kernel = self.kernel(gpu);
        check(&kernel, &self.twin()).unwrap();
        kernel
    }
}

fn check(kernel: &Repaired, twin: &Repaired) -> Result<(), String> {
    identical("keys", &kernel.keys, &twin.keys)?;
    identical("values", &kernel.values, &twin.values)?;
    identical("inversions", &kernel.inversions, &twin.inversions)?;
    identical("restored keys", &kernel.restored_keys, &twin.restored_keys)?;
    identical("restored values", &kernel.restored_values, &twin.restored_values)
}

/// Random keys below `end` with their places as values.
fn random_list(count: usize, end: u32, random: &mut Random) -> Vec<(u32, u32)> {
    (0..count as u32).map(|value| (random.below(end), value)).collect()
}

fn sorted(list: &[(u32, u32)]) -> Vec<(u32, u32)> {
    let mut sorted = list.to_vec();
    sorted.sort_unstable();
    sorted
}

/// A list of `count` different entries in which nothing is farther than `reach` from its place.
fn shaken(count: usize, reach: usize, random: &mut Random) -> Vec<(u32, u32)> {
    let mut places: Vec<(usize, u32)> =
        (0..count as u32).map(|i| (i as usize + random.below(reach as u32 + 1) as usize, i)).collect();
    places.sort_unstable();
    places.into_iter().map(|(_, i)| (3 * i, 7 * i)).collect()
}

/// A sorted list with its stretches of twice `reach`, the first at `first`, turned by half: entries are `reach` from their places.
fn exchanged(count: usize, reach: usize, first: usize) -> Vec<(u32, u32)> {
    let mut list: Vec<(u32, u32)> = (0..count as u32).map(|i| (i, i)).collect();
    list[first..].chunks_exact_mut(2 * reach).for_each(|stretch| stretch.rotate_left(reach));
    list
}

/// The entries of the list as they were left.
fn left(repaired: &Repaired) -> Vec<(u32, u32)> {
    repaired.keys.iter().copied().zip(repaired.values.iter().copied()).collect()
}

#[test]
fn lists_of_every_length_around_a_window() {
    let gpu = open();
    let mut random = Random(1);
    for rounds in [1, 2, 4] {
        for count in [0, 1, 2, 511, 512, 513, 1023, 1024, 1025, 1535, 1536, 1537, 5000] {
            Case::of(random_list(count, 4000, &mut random), rounds).compare(&gpu);
        }
    }
}

#[test]
fn what_is_near_its_place_is_sorted_by_two_rounds() {
    let gpu = open();
    let mut random = Random(2);
    for count in [513, 1024, 1500, 2048, 10_000] {
        let mut lists = vec![shaken(count, REACH, &mut random), shaken(count, 3, &mut random)];
        lists.extend([0, 1, 255, 512, 1000].map(|first: usize| exchanged(count, REACH, first.min(count))));
        for list in lists {
            let ordered = sorted(&list);
            let place_of = |entry: &(u32, u32)| ordered.binary_search(entry).unwrap();
            let farthest = list.iter().enumerate().map(|(place, entry)| place.abs_diff(place_of(entry))).max();
            assert!(farthest.unwrap() <= REACH, "the list is not what the test is about");
            let repaired = Case::of(list.clone(), 2).compare(&gpu);
            assert!(left(&repaired) == ordered && repaired.inversions == [0], "{count} entries");
            assert!(repaired.restored_values == repaired.values, "an order that was proved is taken back");
        }
    }
}

#[test]
fn what_is_far_from_its_place_is_seen_and_taken_back() {
    let gpu = open();
    // The least entry at the end: two rounds carry it 1536 places at most.
    let mut list: Vec<(u32, u32)> = (1..4000).map(|i| (i, i)).collect();
    list.push((0, 0));
    let case = Case::of(list.clone(), 2);
    let repaired = case.compare(&gpu);
    assert!(left(&repaired) != sorted(&list) && repaired.inversions == [1], "{:?}", repaired.inversions);
    assert_eq!(repaired.restored_keys, case.unranked_keys());
    assert!(repaired.restored_values.iter().copied().eq(0..4000));
    // More rounds carry it farther.
    let repaired = Case::of(list.clone(), 8).compare(&gpu);
    assert!(left(&repaired) == sorted(&list) && repaired.inversions == [0]);
}

#[test]
fn equal_keys_are_ordered_by_value() {
    let gpu = open();
    let mut random = Random(3);
    let order = random.shuffled(1024);
    for keys in [|_: u32| 7, |value: u32| value / 300] {
        let list: Vec<(u32, u32)> = order.iter().map(|&value| (keys(value), value)).collect();
        let repaired = Case::of(list.clone(), 1).compare(&gpu);
        assert_eq!((left(&repaired), repaired.inversions), (sorted(&list), vec![0]));
    }
    // Two of the same key the wrong way round are an inversion.
    let kept = Case::new(vec![(OrderStep::Kept, vec![(1, 0), (2, 5), (2, 4), (3, 6)])], 0).compare(&gpu);
    assert_eq!(kept.inversions, [1]);
}

#[test]
fn keys_that_windows_are_filled_up_with() {
    let gpu = open();
    let mut random = Random(4);
    let list: Vec<(u32, u32)> = (0..700).map(|value| ([0, u32::MAX, 5][random.below(3) as usize], value)).collect();
    for rounds in [1, 2, 3] {
        let repaired = Case::of(list.clone(), rounds).compare(&gpu);
        assert!(left(&repaired) == sorted(&list), "{rounds} rounds");
    }
}

#[test]
fn other_lists_stay_as_they_are() {
    let gpu = open();
    let mut random = Random(5);
    let steps = [OrderStep::Repaired, OrderStep::Sorted, OrderStep::Kept];
    let lists = (0..7).map(|camera| (steps[camera % 3], random_list(300 + 431 * camera, 2000, &mut random))).collect();
    let case = Case::new(lists, 3);
    let repaired = case.compare(&gpu);
    let (keys, firsts) = (case.entries().0, case.firsts());
    for (camera, (step, list)) in case.lists.iter().enumerate() {
        let range = firsts[2 * camera] as usize..firsts[2 * camera] as usize + list.len();
        assert_eq!(keys[range.clone()] == repaired.keys[range.clone()], *step != OrderStep::Repaired, "list {camera}");
        // A kept order is told how wrong it is, and stays.
        assert!(*step == OrderStep::Repaired || keys[range.clone()] == repaired.restored_keys[range], "list {camera}");
        assert!(*step == OrderStep::Repaired || (repaired.inversions[camera] > 0) == (*step == OrderStep::Kept), "list {camera}");
    }
}

#[test]
fn as_many_cameras_as_there_may_be_some_of_nothing() {
    let gpu = open();
    let mut random = Random(6);
    let list = |camera: usize| (OrderStep::Repaired, random_list(camera % 5 * 300, 1000, &mut random));
    Case::new((0..CAMERAS_MAX).map(list).collect(), 2).compare(&gpu);
    Case::new(vec![(OrderStep::Repaired, Vec::new()); 3], 2).compare(&gpu);
}

#[test]
fn lists_without_room_end_with_it() {
    let gpu = open();
    let mut random = Random(7);
    let lists: Vec<_> = (0..3).map(|_| (OrderStep::Repaired, random_list(1500, 5000, &mut random))).collect();
    for room in [1, 1499, 1500, 1501, 2999, 4000] {
        let case = Case { room, ..Case::new(lists.clone(), 2) };
        let repaired = case.compare(&gpu);
        assert_eq!(repaired.restored_keys, repaired.keys, "what will be drawn again is not taken back");
    }
}

#[test]
fn one_changed_entry_is_seen() {
    let gpu = open();
    let case = Case::of(random_list(3000, 100, &mut Random(8)), 2);
    let kernel = case.kernel(&gpu);
    let failure = |change: fn(&mut Repaired)| {
        let mut twin = case.twin();
        check(&kernel, &twin).unwrap();
        change(&mut twin);
        check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(|twin| twin.values.swap(1022, 1023)).contains("values: 2 differ; value 1022"));
    assert!(failure(|twin| twin.keys[2999] = UNTOUCHED).contains("keys: 1 differ; value 2999"));
    assert!(failure(|twin| twin.inversions[0] += 1).contains("inversions"));
    assert!(failure(|twin| twin.restored_keys[0] ^= 1).contains("restored keys"));
    assert!(failure(|twin| twin.restored_values[0] ^= 1).contains("restored values"));
}
