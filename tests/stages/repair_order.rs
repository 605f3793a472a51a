//! `repair_order.comp`, `check_order.comp` and `restore_order.comp`: almost sorted lists are put right, or taken back.

use decouplegs::render::layout::{CAMERAS_MAX, Needs, OrderStep, ViewLists, ViewOrder};
use decouplegs::render::stages::{Arguments, OrderPlan, REPAIR_REACH_MAX, RepairOrder, SortScratch, StaticLists};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, sort_shape, upload};
use crate::device::Validated;

/// The background of a camera: the key of each of its records, and these in the order in which they stand.
#[derive(Clone)]
struct List {
    step: OrderStep,
    keys: Vec<u32>,
    order: Vec<u32>,
}

impl List {
    /// Records with these keys, to be repaired, in this order.
    fn new(keys: Vec<u32>, order: Vec<u32>) -> Self {
        Self { step: OrderStep::Repaired, keys, order }
    }

    /// Its records by key and number.
    fn sorted(&self) -> Vec<u32> {
        let mut order = self.order.clone();
        order.sort_by_key(|&record| (self.keys[record as usize], record));
        order
    }

    /// The farthest that two records which stand the wrong way round are apart, in places.
    fn widest_inversion(&self) -> usize {
        let entry = |place: usize| (self.keys[self.order[place] as usize], self.order[place]);
        let mut largest_before: Vec<(u32, u32)> = Vec::new();
        let mut widest = 0;
        for place in 0..self.order.len() {
            let first_larger = largest_before.partition_point(|largest| *largest < entry(place));
            widest = widest.max(place - first_larger);
            largest_before.push(largest_before.last().copied().unwrap_or_default().max(entry(place)));
        }
        widest
    }

    /// Random keys below `end`, in an order in which records are up to about `shake` places from where they belong.
    fn shaken(count: usize, end: u32, shake: u32, random: &mut Random) -> Self {
        let mut list = Self::new((0..count).map(|_| random.below(end)).collect(), (0..count as u32).collect());
        let mut places: Vec<(u32, u32)> =
            (0..).zip(list.sorted()).map(|(i, record)| (i + random.below(shake + 1), record)).collect();
        places.sort_unstable();
        list.order = places.into_iter().map(|(_, record)| record).collect();
        list
    }

    /// Records whose stretches of twice `half`, the first at `first`, are turned by half.
    fn exchanged(count: usize, half: usize, first: usize) -> Self {
        let mut order: Vec<u32> = (0..count as u32).collect();
        order[first.min(count)..].chunks_exact_mut(2 * half).for_each(|stretch| stretch.rotate_left(half));
        Self::new((0..count as u32).map(|record| 3 * record).collect(), order)
    }
}

/// Lists of a frame, each in two chunks.
struct Case {
    lists: Vec<List>,
    reach: u32,
    /// Room for records; the lists end there.
    room: usize,
    /// What `repaired` holds for `check_order` instead of what `repair_order` writes.
    planted: Option<Vec<u32>>,
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
    fn new(lists: Vec<List>, reach: u32) -> Self {
        let room = lists.iter().map(|list| list.keys.len()).sum();
        Self { lists, reach, room, planted: None }
    }

    fn view_orders(&self) -> Vec<ViewOrder> {
        self.lists.iter().map(|list| ViewOrder { path: list.step as u32, rank_set: 0 }).collect()
    }

    fn firsts(&self) -> Vec<u32> {
        let chunks = |list: &List| [list.keys.len() as u32 / 3, (list.keys.len() - list.keys.len() / 3) as u32];
        let counts: Vec<u32> = self.lists.iter().flat_map(chunks).collect();
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

    /// Keys and records as they stand.
    fn entries(&self) -> (Vec<u32>, Vec<u32>) {
        let firsts = self.firsts();
        let of_list = |(camera, list): (usize, &List)| -> Vec<(u32, u32)> {
            list.order.iter().map(|&record| (list.keys[record as usize], firsts[2 * camera] + record)).collect()
        };
        self.lists.iter().enumerate().flat_map(of_list).take(self.room).unzip()
    }

    fn unranked_keys(&self) -> Vec<u32> {
        self.lists.iter().flat_map(|list| &list.keys).take(self.room).copied().collect()
    }

    /// Records of all lists as they stand when all that is to be repaired is in order.
    fn repaired(&self) -> Vec<u32> {
        let firsts = self.firsts();
        let of_list = |(camera, list): (usize, &List)| -> Vec<u32> {
            let order = if list.step == OrderStep::Repaired { list.sorted() } else { list.order.clone() };
            order.into_iter().map(|record| firsts[2 * camera] + record).collect()
        };
        self.lists.iter().enumerate().flat_map(of_list).collect()
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
        gpu.write(&sort.values[1], 0, self.planted.as_ref().unwrap_or(&vec![UNTOUCHED; self.room])).unwrap();
        let firsts = upload(gpu, &self.firsts());
        let lists = StaticLists { camera_count: cameras, chunk_count: 2, firsts: &firsts, records_max: self.room };
        run(gpu, |r| {
            if self.planted.is_none() {
                repair.record_repair(r, lists, &plan, &sort, self.reach);
            }
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
        let ((mut keys, mut values), unranked) = (self.entries(), self.unranked_keys());
        let repaired = self.planted.clone().unwrap_or_else(|| {
            let mut repaired = vec![UNTOUCHED; self.room];
            twins::repair_order(&orders, &firsts, &keys, &values, &mut repaired, cameras, 2, room, self.reach as usize);
            repaired
        });
        let mut inversions = vec![0; cameras];
        twins::check_order(&orders, &firsts, &mut keys, &mut values, &repaired, &unranked, &mut inversions, cameras, 2, room);
        let (mut restored_keys, mut restored_values) = (keys.clone(), values.clone());
        let lists = self.view_lists();
        twins::restore_order(&orders, &inversions, &lists, &unranked, &mut restored_keys, &mut restored_values, cameras);
        Repaired { keys, values, inversions, restored_keys, restored_values }
    }

    /// Holds the kernel to the twin. Of a list that could not be repaired, which entries stand in it is left open, but not that
    /// it is seen, nor what it is taken back to.
    fn check(&self, kernel: &Repaired, twin: &Repaired) -> Result<(), String> {
        let firsts = self.firsts();
        for (camera, list) in self.lists.iter().enumerate() {
            let [first, end] = [firsts[2 * camera], firsts[2 * camera + 2]].map(|place| (place as usize).min(self.room));
            let is_open = self.planted.is_none() && list.step == OrderStep::Repaired && twin.inversions[camera] > 0;
            if is_open && kernel.inversions[camera] > 0 {
                continue;
            }
            identical("keys", &kernel.keys[first..end], &twin.keys[first..end])?;
            identical("values", &kernel.values[first..end], &twin.values[first..end])?;
            identical("inversions", &[kernel.inversions[camera]], &[twin.inversions[camera]])?;
        }
        if firsts[firsts.len() - 1] as usize > self.room {
            return Ok(()); // nothing is taken back
        }
        identical("restored keys", &kernel.restored_keys, &twin.restored_keys)?;
        identical("restored values", &kernel.restored_values, &twin.restored_values)
    }

    fn compare(&self, gpu: &Validated) -> Repaired {
        let kernel = self.kernel(gpu);
        self.check(&kernel, &self.twin()).unwrap();
        kernel
    }
}

#[test]
fn lists_of_every_length_around_a_block() {
    let gpu = open();
    let mut random = Random(1);
    for reach in [REPAIR_REACH_MAX, 64, 0] {
        for count in [0, 1, 2, 255, 256, 257, 1023, 1024, 1025, 1279, 1280, 1281, 5000] {
            Case::new(vec![List::shaken(count, 4000, 50, &mut random)], reach).compare(&gpu);
        }
    }
}

#[test]
fn a_list_is_sorted_when_the_reach_is_that_of_its_widest_inversion_and_not_before() {
    let gpu = open();
    let mut random = Random(2);
    for count in [300, 1024, 2500] {
        let mut lists = vec![List::shaken(count, u32::MAX, 1, &mut random), List::shaken(count, 900, 90, &mut random)];
        lists.extend([(1, 0), (128, 1), (128, 1000), (100, 7)].map(|(half, first)| List::exchanged(count, half, first)));
        for list in lists {
            let widest = list.widest_inversion() as u32;
            assert!(widest <= REPAIR_REACH_MAX, "{widest} places are too many for the test");
            // Looked at is in steps of 8 places.
            let case = Case::new(vec![list.clone()], widest.next_multiple_of(8));
            let repaired = case.compare(&gpu);
            assert!(repaired.values == list.sorted() && repaired.inversions == [0], "{count} records over {widest}");
            assert!(repaired.restored_values == repaired.values, "an order that was proved is taken back");
            let too_near = widest.saturating_sub(1) / 8 * 8;
            if widest > 0 {
                let repaired = Case::new(vec![list], too_near).compare(&gpu);
                assert!(repaired.inversions[0] > 0, "{count} records over less than {widest}");
                assert!(repaired.restored_values.iter().copied().eq(0..count as u32), "it is not taken back");
                assert_eq!(repaired.restored_keys, case.unranked_keys());
            }
        }
    }
}

#[test]
fn what_is_far_from_its_place_is_seen_and_taken_back() {
    let gpu = open();
    let keys: Vec<u32> = (0..4000).collect();
    let last_first: Vec<u32> = (1..4000).chain([0]).collect();
    let random = Random(3).shuffled(4000);
    for order in [last_first, random, (0..4000).rev().collect()] {
        let repaired = Case::new(vec![List::new(keys.clone(), order)], REPAIR_REACH_MAX).compare(&gpu);
        assert!(repaired.inversions[0] > 0 && repaired.restored_keys == keys && repaired.restored_values == keys);
    }
}

#[test]
fn equal_keys_are_ordered_by_record() {
    let gpu = open();
    let order = Random(4).shuffled(200);
    for keys in [vec![7; 200], (0..200).map(|record| record / 60).collect(), (0..200).map(|i| [0, u32::MAX][i % 2]).collect()] {
        let list = List::new(keys, order.clone());
        let repaired = Case::new(vec![list.clone()], REPAIR_REACH_MAX).compare(&gpu);
        assert_eq!((repaired.values, repaired.inversions), (list.sorted(), vec![0]));
    }
    // Two of the same key the wrong way round are an inversion.
    let kept = List { step: OrderStep::Kept, ..List::new(vec![1, 2, 2, 3], vec![0, 2, 1, 3]) };
    assert_eq!(Case::new(vec![kept], 0).compare(&gpu).inversions, [1]);
}

#[test]
fn other_lists_stay_as_they_are() {
    let gpu = open();
    let mut random = Random(5);
    let steps = [OrderStep::Repaired, OrderStep::Sorted, OrderStep::Kept];
    let list = |camera: usize| List { step: steps[camera % 3], ..List::shaken(300 + 431 * camera, 2000, 40, &mut random) };
    let case = Case::new((0..7).map(list).collect(), REPAIR_REACH_MAX);
    let repaired = case.compare(&gpu);
    identical("records", &repaired.values, &case.repaired()).unwrap();
    for (list, inversions) in case.lists.iter().zip(repaired.inversions) {
        // A kept order is told how wrong it is.
        assert_eq!(inversions > 0, list.step == OrderStep::Kept);
    }
}

#[test]
fn as_many_cameras_as_there_may_be_some_of_nothing() {
    let gpu = open();
    let mut random = Random(6);
    let lists = (0..CAMERAS_MAX).map(|camera| List::shaken(camera % 5 * 300, 1000, 30, &mut random)).collect();
    let case = Case::new(lists, REPAIR_REACH_MAX);
    identical("records", &case.compare(&gpu).values, &case.repaired()).unwrap();
    Case::new(vec![List::new(Vec::new(), Vec::new()); 3], REPAIR_REACH_MAX).compare(&gpu);
}

#[test]
fn lists_without_room_end_with_it() {
    let gpu = open();
    let mut random = Random(7);
    let lists: Vec<List> = (0..3).map(|_| List::shaken(1500, 5000, 50, &mut random)).collect();
    for room in [1, 1499, 1500, 1501, 2999, 4000] {
        let repaired = Case { room, ..Case::new(lists.clone(), REPAIR_REACH_MAX) }.compare(&gpu);
        assert_eq!(repaired.restored_keys, repaired.keys, "what will be drawn again is not taken back");
    }
}

#[test]
fn only_every_record_once_and_in_order_is_a_proof() {
    let gpu = open();
    let mut random = Random(8);
    let lists: Vec<List> = (0..2).map(|_| List::shaken(1500, 5000, 50, &mut random)).collect();
    let inversions = |change: fn(&mut Vec<u32>)| {
        let case = Case::new(lists.clone(), 0);
        let mut planted = case.repaired();
        change(&mut planted);
        Case { planted: Some(planted), ..case }.compare(&gpu).inversions
    };
    assert_eq!(inversions(|_| ()), [0, 0]);
    assert_eq!(inversions(|records| records[1024] = records[1023]), [1, 0], "a record twice");
    assert_eq!(inversions(|records| records.swap(1023, 1024)), [1, 0], "two the wrong way round");
    assert!(inversions(|records| records[1499] = 1500)[0] > 0, "one of the other list");
    assert!(inversions(|records| records[1500] = 1499)[1] > 0, "one of the other list, at the beginning");
    assert!(inversions(|records| records[2000] = UNTOUCHED)[1] > 0, "none at all");
    assert!(inversions(|records| records[2999] = 3000)[1] > 0, "one behind all lists");
}

#[test]
fn one_changed_entry_is_seen() {
    let gpu = open();
    let near = List::shaken(1500, 100, 20, &mut Random(9));
    let far = List::new(vec![5; 800], (0..800).rev().collect());
    let case = Case::new(vec![near, far], REPAIR_REACH_MAX);
    let kernel = case.kernel(&gpu);
    let failure = |change: fn(&mut Repaired)| {
        let mut twin = case.twin();
        case.check(&kernel, &twin).unwrap();
        change(&mut twin);
        case.check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(|twin| twin.values.swap(1022, 1023)).contains("values: 2 differ; value 1022"));
    assert!(failure(|twin| twin.keys[1499] = UNTOUCHED).contains("keys: 1 differ; value 1499"));
    assert!(failure(|twin| twin.restored_keys[0] ^= 1).contains("restored keys"));
    assert!(failure(|twin| twin.restored_values[1600] ^= 1).contains("restored values"));
    // A list that the kernel must not have taken for proved.
    let unseen = Repaired { inversions: vec![0, 0], ..kernel.clone() };
    assert!(case.check(&unseen, &case.twin()).is_err());
}
