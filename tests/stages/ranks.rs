//! `key_splats.comp`, `rank_splats.comp` and `count_ranks.comp`, and the variants of `cull.comp` and `project.comp` that go by ranks.

use decouplegs::gpu::Buffer;
use decouplegs::render::layout::{CHUNK_SPLATS, OrderStep, SortSegment, ViewOrder};
use decouplegs::render::stages::{
    Cull, Project, ProjectVariant, Projected, RadixSort, RankLists, Ranked, Ranks, Scan, SortInput, SortScratch, Visible,
};
use decouplegs::render::{capacity::groups_for, twins};
use decouplegs::scene::Rules;

use super::project::{PLAIN, rounding::check_keys};
use super::scenes::{Kept, Listed, Scene, hard_world, rig};
use super::{Random, UNTOUCHED, identical, open, run, sort_shape, untouched, upload};
use crate::device::Validated;

/// Keys of all splats of the scene along the direction of a camera, and their indices, as the kernel writes them.
fn keys_of(gpu: &Validated, scene: &Scene, camera: usize) -> (Vec<u32>, Vec<u32>) {
    let sort = SortScratch::new(gpu, sort_shape(gpu), scene.means_m.len() + 1).unwrap();
    for buffer in [&sort.keys[0], &sort.values[0]] {
        gpu.write(buffer, 0, &vec![UNTOUCHED; buffer.len()]).unwrap();
    }
    let ranks = Ranks::new(gpu).unwrap();
    run(gpu, |r| ranks.record_keys(r, &scene.resident, &scene.camera_buffer, camera, &sort));
    (gpu.read(&sort.keys[0]).unwrap(), gpu.read(&sort.values[0]).unwrap())
}

/// Places of `keys` in a stable sort.
fn ranks_by_sorting(keys: &[u32]) -> Vec<u32> {
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by_key(|&splat| keys[splat]);
    let mut ranks = vec![0; keys.len()];
    (0..).zip(order).for_each(|(rank, splat)| ranks[splat] = rank);
    ranks
}

#[test]
fn keys_of_all_splats_seen_or_not() {
    let gpu = open();
    for count in [1, 255, 256, 257, 2000] {
        let scene = Scene::new(&gpu, &hard_world(count.max(17), 41), &rig());
        let splats = scene.means_m.len();
        for camera in 0..2 {
            let (mut keys, mut values) = (vec![UNTOUCHED; splats + 1], vec![UNTOUCHED; splats + 1]);
            twins::key_splats(&scene.view.cameras, &scene.means_m, &mut keys, &mut values, camera);
            let kernel = keys_of(&gpu, &scene, camera);
            check_keys(&kernel.0, &keys).unwrap();
            identical("values", &kernel.1, &values).unwrap();
        }
    }
}

#[test]
fn ranks_are_the_places_of_a_stable_sort() {
    let gpu = open();
    let scene = Scene::new(&gpu, &hard_world(3000, 42), &rig());
    let (ranks, sort_stage) = (Ranks::new(&gpu).unwrap(), RadixSort::new(&gpu, sort_shape(&gpu)).unwrap());
    let sort = SortScratch::new(&gpu, sort_shape(&gpu), 3000).unwrap();
    let segment = upload(&gpu, &[SortSegment { first: 0, count: 3000, first_block: 0 }]);
    let groups = upload(&gpu, &[groups_for(3000usize.div_ceil(sort_shape(&gpu).block() as usize))]);
    let found = untouched(&gpu, 3 * 3000);
    run(&gpu, |r| {
        for (camera, set) in [(0, 2), (1, 0)] {
            ranks.record_keys(r, &scene.resident, &scene.camera_buffer, camera, &sort);
            let all =
                SortInput { segments: &segment, segment_count: 1, arguments: groups.binding(), arguments_offset: 0, first: 0 };
            let sorted = sort_stage.record(r, &sort, all, 32);
            ranks.record_ranks(r, &sort.values[sorted], 3000, &found, set);
        }
    });
    let found = gpu.read(&found).unwrap();
    for (camera, set) in [(0, 2), (1, 0)] {
        let ranks = &found[set * 3000..(set + 1) * 3000];
        identical("ranks", ranks, &ranks_by_sorting(&keys_of(&gpu, &scene, camera).0[..3000])).unwrap();
        let mut places = ranks.to_vec();
        places.sort_unstable();
        assert!(places.into_iter().eq(0..3000), "some rank is given twice");
    }
    assert!(found[3000..6000].iter().all(|&rank| rank == UNTOUCHED), "a set that nobody asked for");
}

#[test]
fn ranks_of_any_order() {
    let gpu = open();
    let ranks = Ranks::new(&gpu).unwrap();
    for count in [1, 255, 256, 257, 1000] {
        let order = Random(count as u64).shuffled(count);
        let (values, found) = (upload(&gpu, &order), untouched(&gpu, 2 * count));
        run(&gpu, |r| ranks.record_ranks(r, &values, count, &found, 1));
        let mut twin = vec![UNTOUCHED; 2 * count];
        twins::rank_splats(&order, &mut twin, count, 1);
        let kernel = gpu.read(&found).unwrap();
        identical("ranks", &kernel, &twin).unwrap();
        twin.swap(count, 2 * count - 1);
        assert!(count == 1 || identical("ranks", &kernel, &twin).unwrap_err().contains("2 differ"));
    }
}

/// Records before each stretch of 256 ranks, and their total.
fn rank_firsts(gpu: &Validated, lists: &RankLists, chunk_lists: usize) -> Vec<u32> {
    let (ranks, scan) = (Ranks::new(gpu).unwrap(), Scan::new(gpu).unwrap());
    run(gpu, |r| ranks.record_counts(r, &scan, lists, chunk_lists));
    gpu.read(&lists.firsts).unwrap()
}

#[test]
fn visible_splats_before_each_stretch_of_ranks() {
    let gpu = open();
    let mut random = Random(43);
    for chunk_lists in [1, 2, 255, 256, 257, 700] {
        let lists = RankLists::new(&gpu, 1, chunk_lists).unwrap();
        let kinds = [0, u32::MAX, 1, 0x8000_0000];
        let words: Vec<u32> = (0..chunk_lists * CHUNK_SPLATS / 32)
            .map(|_| if random.below(2) == 0 { random.word() } else { kinds[random.below(4) as usize] })
            .collect();
        gpu.write(&lists.words, 0, &words).unwrap();
        let (mut counts, mut twin) = (vec![0; chunk_lists], vec![0; chunk_lists + 1]);
        twins::count_ranks(&words, &mut counts, chunk_lists);
        twins::scan(&counts, &mut twin);
        let kernel = rank_firsts(&gpu, &lists, chunk_lists);
        identical("firsts", &kernel, &twin).unwrap();
        twin[chunk_lists] += 1;
        assert!(identical("firsts", &kernel, &twin).unwrap_err().contains("1 differ"));
    }
}

/// A scene whose cameras' orders are kept in every way, by ranks of any order.
struct Case {
    scene: Scene,
    kept: Kept,
    view_orders: Buffer<ViewOrder>,
    ranks: Buffer<u32>,
}

impl Case {
    fn new(gpu: &Validated, splats: usize, steps: [(OrderStep, u32); 4]) -> Self {
        let scene = Scene::new(gpu, &hard_world(splats, 44), &rig());
        let ranks: Vec<u32> = (0..3).flat_map(|set| Random(set).shuffled(splats)).collect();
        let view_orders: Vec<ViewOrder> = steps.map(|(path, rank_set)| ViewOrder { path: path as u32, rank_set }).to_vec();
        let rank_words = vec![0; 4 * scene.chunks.len() * CHUNK_SPLATS / 32];
        Self {
            view_orders: upload(gpu, &view_orders),
            ranks: upload(gpu, &ranks),
            kept: Kept { view_orders, ranks, rank_words },
            scene,
        }
    }

    /// All ways of ordering a list.
    fn mixed(gpu: &Validated, splats: usize) -> Self {
        let steps = [(OrderStep::Kept, 1), (OrderStep::Sorted, 0), (OrderStep::Repaired, 0), (OrderStep::Repaired, 2)];
        Self::new(gpu, splats, steps)
    }

    /// Lists on the device that hold these words by rank.
    fn lists(&self, gpu: &Validated, rank_words: &[u32]) -> RankLists {
        let lists = RankLists::new(gpu, 4, self.scene.chunks.len()).unwrap();
        gpu.write(&lists.words, 0, rank_words).unwrap();
        lists
    }

    fn ranked<'a>(&'a self, lists: &'a RankLists) -> Ranked<'a> {
        Ranked { view_orders: &self.view_orders, ranks: &self.ranks, lists }
    }

    /// The place of a splat's bit in the words of a camera, by rank; `None` where the order is not kept.
    fn rank_bit(&self, camera: usize, splat: usize) -> Option<usize> {
        let ViewOrder { path, rank_set } = self.kept.view_orders[camera];
        let rank = self.kept.ranks[rank_set as usize * self.scene.means_m.len() + splat] as usize;
        (path != OrderStep::Sorted as u32).then_some(camera * self.scene.chunks.len() * CHUNK_SPLATS + rank)
    }

    /// The kept orders with the words by rank of what is listed.
    fn kept_of(&self, listed: &Listed) -> Kept {
        let mut kept = self.kept.clone();
        for bit in listed.records.iter().filter_map(|&(camera, splat)| self.rank_bit(camera, splat)) {
            kept.rank_words[bit / 32] |= 1 << (bit % 32);
        }
        kept
    }
}

fn is_set(words: &[u32], bit: usize) -> bool {
    words[bit / 32] >> (bit % 32) & 1 == 1
}

#[test]
fn culling_marks_ranks_where_orders_are_kept() {
    let gpu = open();
    let case = Case::mixed(&gpu, 2000);
    let (scene, rules) = (&case.scene, Rules::DEFAULT);
    let visible = Visible::new(&gpu, 4, scene.chunks.len()).unwrap();
    let lists = case.lists(&gpu, &case.kept.rank_words);
    let cull = Cull::new(&gpu, &rules, true, false).unwrap();
    run(&gpu, |r| cull.record(r, &scene.resident, &scene.camera_buffer, &scene.lens_buffer, 4, &visible, &case.ranked(&lists)));
    let (words, rank_words) = (gpu.read(&visible.words).unwrap(), gpu.read(&lists.words).unwrap());
    let (_, _, twin_words) = scene.culled_by_rank(&rules, &case.kept);
    let mut seen = 0;
    for (camera, splat) in (0..4).flat_map(|camera| (0..2000).map(move |splat| (camera, splat))) {
        let Some(bit) = case.rank_bit(camera, splat) else { continue };
        let is_visible = is_set(&words, camera * scene.chunks.len() * CHUNK_SPLATS + splat);
        assert_eq!(is_set(&rank_words, bit), is_visible, "camera {camera}, splat {splat}");
        if scene.settled_visibility(camera, splat, &rules).is_some() {
            assert_eq!(is_set(&rank_words, bit), is_set(&twin_words, bit), "camera {camera}, splat {splat}: the twin");
        }
        seen += u32::from(is_visible);
    }
    let bits: u32 = rank_words.iter().map(|word| word.count_ones()).sum();
    assert!(seen > 500 && bits == seen, "{bits} bits by rank for {seen} splats seen");
}

/// What the projection leaves: keys and values in their places, and keys by slot.
#[derive(Clone)]
struct Placed {
    keys: Vec<u32>,
    values: Vec<u32>,
    unranked_keys: Vec<u32>,
}

impl Case {
    fn placed(&self, gpu: &Validated, listed: &Listed, kept: &Kept, room: usize) -> Placed {
        let scene = &self.scene;
        let lists = self.lists(gpu, &kept.rank_words);
        rank_firsts(gpu, &lists, 4 * scene.chunks.len());
        let visible = Visible::new(gpu, 4, scene.chunks.len()).unwrap();
        gpu.write(&visible.words, 0, &listed.words).unwrap();
        let (firsts, projected) = (upload(gpu, &listed.firsts), Projected::new(gpu, room).unwrap());
        let sort = SortScratch::new(gpu, sort_shape(gpu), room).unwrap();
        let written = [&sort.keys[0], &sort.values[0], &sort.keys[1]];
        written.iter().for_each(|buffer| gpu.write(buffer, 0, &vec![UNTOUCHED; room]).unwrap());
        let (project, shadows) = (Project::new(gpu, &Rules::DEFAULT, RANKED).unwrap(), scene.shadow_buffers(gpu));
        run(gpu, |r| {
            let (cameras, ranked) = (&scene.camera_buffer, self.ranked(&lists));
            project.record(
                r,
                &scene.resident,
                cameras,
                &scene.lens_buffer,
                4,
                &visible,
                &firsts,
                &projected,
                &sort,
                &ranked,
                &shadows,
                0,
            );
        });
        let [keys, values, unranked_keys] = written.map(|buffer| gpu.read(buffer).unwrap());
        Placed { keys, values, unranked_keys }
    }

    fn twin(&self, listed: &Listed, kept: &Kept, room: usize) -> Placed {
        let (projected, unranked_keys) = self.scene.projected_by_rank(listed, &Rules::DEFAULT, RANKED, room, kept);
        Placed { keys: projected.keys, values: projected.values, unranked_keys }
    }
}

const RANKED: ProjectVariant = ProjectVariant { ranked: true, ..PLAIN };

fn check(kernel: &Placed, twin: &Placed) -> Result<(), String> {
    identical("values", &kernel.values, &twin.values)?;
    check_keys(&kernel.keys, &twin.keys)?;
    check_keys(&kernel.unranked_keys, &twin.unranked_keys).map_err(|error| format!("unranked {error}"))
}

#[test]
fn keys_stand_by_rank_where_orders_are_kept() {
    let gpu = open();
    for splats in [300, 2000] {
        let case = Case::mixed(&gpu, splats);
        let listed = case.scene.listed(&Rules::DEFAULT);
        let (kept, records) = (case.kept_of(&listed), listed.records.len());
        for room in [records, records - 1, records / 2, 1] {
            check(&case.placed(&gpu, &listed, &kept, room), &case.twin(&listed, &kept, room)).unwrap();
        }
    }
}

#[test]
fn the_ranks_of_a_direction_leave_nothing_to_sort() {
    let gpu = open();
    let mut case = Case::new(&gpu, 2000, [0, 1, 0, 0].map(|set| (OrderStep::Kept, set)));
    // The rig's first, third and fourth camera look the same way.
    for (set, camera) in [(0, 0), (1, 1)] {
        let ranks = ranks_by_sorting(&keys_of(&gpu, &case.scene, camera).0[..2000]);
        case.kept.ranks[set * 2000..(set + 1) * 2000].copy_from_slice(&ranks);
    }
    case.ranks = upload(&gpu, &case.kept.ranks);
    let listed = case.scene.listed(&Rules::DEFAULT);
    let placed = case.placed(&gpu, &listed, &case.kept_of(&listed), listed.records.len());
    let entries: Vec<(u32, u32)> = placed.keys.into_iter().zip(placed.values).collect();
    for camera in 0..4 {
        let first =
            |camera: usize| listed.firsts.get(camera * case.scene.chunks.len()).map_or(entries.len(), |&first| first as usize);
        let list = &entries[first(camera)..first(camera + 1)];
        assert!(!list.is_empty() && list.is_sorted(), "camera {camera}");
    }
}

#[test]
fn one_key_in_another_place_is_seen() {
    let gpu = open();
    let case = Case::mixed(&gpu, 600);
    let listed = case.scene.listed(&Rules::DEFAULT);
    let (kept, room) = (case.kept_of(&listed), listed.records.len());
    let kernel = case.placed(&gpu, &listed, &kept, room);
    let failure = |change: &dyn Fn(&mut Placed)| {
        let mut twin = case.twin(&listed, &kept, room);
        check(&kernel, &twin).unwrap();
        change(&mut twin);
        check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(&|twin| twin.values.swap(3, 4)).contains("values: 2 differ; value 3"));
    assert!(failure(&|twin| twin.keys[room - 1] += 2).contains("keys"));
    assert!(failure(&|twin| twin.unranked_keys[room - 1] += 2).contains("unranked keys"));
    // A splat's rank that is another's.
    let mut other = kept.clone();
    let visible = |place: usize| case.kept.ranks[600 + listed.records[place].1] as usize;
    let (a, b) = (listed.records[0].1, listed.records[1].1);
    assert!(visible(0) != visible(1));
    other.ranks.swap(600 + a, 600 + b);
    assert!(check(&kernel, &case.twin(&listed, &other, room)).unwrap_err().contains("values"));
}
