//! `project_lidar.comp` and `trace_lidar.comp` against their twin, and the proof that no beam
//! misses a splat.

use decouplegs::gpu::QueueRole;
use decouplegs::render::capacity::Capacity;
use decouplegs::render::layout::{
    BeamEchoes, BeamState, COARSE_HEIGHT_PX, COARSE_WIDTH_PX, RequiredCounts, View,
};
use decouplegs::render::lidar::{SectorPlan, Sectors};
use decouplegs::render::reference::lidar::{LidarSplats64, SplatGroup};
use decouplegs::render::stages::{
    LidarBuffers, LidarPass, LidarRoom, LidarVariant, ListLidar, ProjectLidar, Records, Scan,
    SectorBuffers, TileSort, TraceLidar,
};
use decouplegs::render::twins::lidar::{
    Cells, LidarConstants, LidarSplat, NO_CELLS, SLOPE_SLACK, SectorView, TwinBeam, meet,
    see_from_lidar,
};
use decouplegs::render::twins::projection::axes_of;
use decouplegs::render::twins::sh::Stored;
use decouplegs::render::twins::stored_splat::load_shape;
use decouplegs::render::{ResidentSplats, Storage};
use decouplegs::scene::lidar::Beam;
use decouplegs::scene::rules::LIDAR_DILATION_RAD;
use decouplegs::scene::{Lidar, Motion, Pose, Rules, SplatScene};
use glam::{DQuat, DVec3, Mat3, Vec3};

use super::{open, run};
use crate::device::Validated;
use crate::frames::lidar::{lidar_at, models, surroundings};

/// A sweep whose lists the kernels made, and what the twin reads of them.
struct Listed {
    beams: Vec<Beam>,
    cut: Sectors,
    view: View,
    /// Index of the splat of each record.
    splat_of_record: Vec<usize>,
    /// Sector of each record.
    sector_of_record: Vec<usize>,
    footprints: Vec<[u32; 4]>,
    looks: Vec<[f32; 3]>,
    shapes: Vec<[f32; 4]>,
    tile_lists: Vec<[u32; 2]>,
    sorted: Vec<u32>,
    tile_words: Vec<u32>,
    /// Room for pairs.
    pairs_max: usize,
    states: Vec<BeamState>,
    echoes: Vec<BeamEchoes>,
    /// Splats as the device has them.
    stored: Vec<([f32; 3], Mat3, f32)>,
    /// DC coefficients of those splats.
    dc: Vec<Vec3>,
}

impl Listed {
    fn new(gpu: &Validated, world: &SplatScene, lidar: &Lidar) -> Self {
        Self::stored(gpu, world, lidar, Storage::Exact)
    }

    fn stored(gpu: &Validated, world: &SplatScene, lidar: &Lidar, storage: Storage) -> Self {
        let beams = lidar.model.beams();
        let cells = lidar.model.cells();
        let cut = Sectors::new(
            lidar,
            &cells,
            &SectorPlan::new(&beams, &cells, 8),
            Vec::new(),
        );
        let view = View::new(&cut.cameras, world.origin, 1e3).unwrap();
        let scene = ResidentSplats::upload(gpu, world, storage).unwrap();
        let mut sectors = SectorBuffers::new(gpu).unwrap();
        sectors.set(gpu, &view, &cut.tables).unwrap();
        let capacity = Capacity {
            records: 32 * world.splats.len(),
            pairs: 160 * world.splats.len(),
            partials: 0,
            tiles: 1,
        };
        let clusters = scene.cluster_count();
        let room = LidarRoom::new(capacity, clusters, &view, beams.len(), true);
        let buffers = LidarBuffers::new(gpu, &room).unwrap();
        let variant = LidarVariant {
            instances: false,
            moving: !lidar.motion.is_rest(),
            dilation_rad: LIDAR_DILATION_RAD as f32,
            echoes: true,
            storage,
            beam_lanes: 1,
        };
        let project = ProjectLidar::new(gpu, &world.rules, variant).unwrap();
        let (scan, tile_sort) = (Scan::new(gpu).unwrap(), TileSort::for_lidar(gpu).unwrap());
        let list = ListLidar::new(gpu).unwrap();
        let mut recorder = gpu.record(QueueRole::Main);
        sectors.copy(&mut recorder);
        let (counters, lists) = (&buffers.counters, &buffers.lists);
        let (required, arguments) = (&counters.required, &counters.arguments);
        recorder.fill(required, 0, required.byte_len(), 0);
        recorder.fill(arguments, 0, arguments.byte_len(), 0);
        let slab_counts = &lists.slab_counts;
        recorder.fill(slab_counts, 0, slab_counts.byte_len(), 0);
        project.record(&mut recorder, LidarPass::Mark, &scene, &sectors, &buffers);
        let count = sectors.count * clusters;
        let counts = &buffers.visible.counts;
        scan.record(&mut recorder, counts, &buffers.offsets, count);
        project.record(&mut recorder, LidarPass::Write, &scene, &sectors, &buffers);
        let records = Records {
            cameras: sectors.cameras.device(),
            camera_count: sectors.count,
            projected: &buffers.projected,
            static_offsets: &buffers.offsets,
            static_clusters: clusters,
            moving_offsets: &buffers.no_agents,
            moving_clusters: 0,
            moving_only: false,
            other_keys: &buffers.projected.keys,
        };
        tile_sort.record(&mut recorder, counters, records, lists, sectors.bins);
        gpu.submit(recorder, &[]).unwrap().wait().unwrap();
        let required: RequiredCounts = gpu.read(&counters.required).unwrap()[0];
        assert!(capacity.holds(&required), "{required:?}");
        run(gpu, |r| list.record(r, &sectors, &buffers));
        let longest = gpu.read(&counters.required).unwrap()[0].longest;
        let tile_lists = gpu.read(&lists.tile_lists).unwrap();
        assert_eq!(tile_lists.iter().map(|list| list[1]).max(), Some(longest));
        let range_min_m = lidar.model.range_m[0] as f32;
        let walk = |beam_lanes| {
            let variant = LidarVariant {
                beam_lanes,
                ..variant
            };
            let trace = TraceLidar::new(gpu, &world.rules, variant).unwrap();
            run(gpu, |r| {
                // Two windows: the state between them is kept.
                let cut = longest / 3;
                trace.record(r, &sectors, &buffers, 0..cut, range_min_m);
                trace.record(r, &sectors, &buffers, cut..u32::MAX, range_min_m);
            });
            let states = gpu.read(&buffers.states).unwrap();
            (states, gpu.read(&buffers.echoes).unwrap())
        };
        let (states, echoes) = walk(1);
        for beam_lanes in [2, 4] {
            let same = walk(beam_lanes) == (states.clone(), echoes.clone());
            assert!(same, "{beam_lanes} lanes of a beam find something else");
        }
        let words = gpu.read(&buffers.visible.words).unwrap();
        let (mut splat_of_record, mut sector_of_record) = (vec![], vec![]);
        for sector in 0..sectors.count {
            for bit in 0..clusters * 256 {
                let index = sector * clusters * 256 + bit;
                if words[index / 32] >> (index % 32) & 1 == 1 {
                    splat_of_record.push(bit);
                    sector_of_record.push(sector);
                }
            }
        }
        assert_eq!(splat_of_record.len(), required.records as usize);
        let means = gpu.read(&scene.means).unwrap();
        let shapes = gpu.read(&scene.shapes).unwrap();
        let rotations = gpu.read(&scene.rotations).unwrap();
        let sh_dc = gpu.read(&scene.sh_dc).unwrap();
        let colors = Stored {
            storage,
            sh_dc: &sh_dc,
            sh_bands: [&[]; 3],
        };
        let stored = means.iter().enumerate().map(|(splat, &mean)| {
            let (shape, rotation) = load_shape(storage, &shapes, &rotations, splat);
            (mean, axes_of(shape, rotation), shape[3])
        });
        Self {
            stored: stored.collect(),
            dc: (0..means.len())
                .map(|splat| colors.dc(splat, means.len()))
                .collect(),
            footprints: gpu.read(&buffers.projected.footprints).unwrap(),
            looks: gpu.read(&buffers.looks).unwrap(),
            shapes: gpu.read(&buffers.shapes).unwrap(),
            tile_lists,
            sorted: gpu.read(&lists.sorted_records).unwrap(),
            tile_words: gpu.read(&buffers.tile_words).unwrap(),
            pairs_max: capacity.pairs,
            states,
            echoes,
            beams,
            cut,
            view,
            splat_of_record,
            sector_of_record,
        }
    }

    fn sector(&self, sector: usize) -> SectorView<'_> {
        let tables = &self.cut.tables;
        let record = &tables.sectors[sector];
        let camera = &self.view.cameras[sector];
        let [columns, rows] = camera.size_px.map(|size| size as usize);
        let (column, row) = (record.first_column as usize, record.first_row as usize);
        SectorView {
            camera,
            sector: record,
            column_bounds: &tables.column_bounds[column..column + columns],
            row_bounds: &tables.row_bounds[row..row + rows],
        }
    }

    fn cells(&self, record: usize) -> Cells {
        self.footprints[2 * record].map(|cell| f32::from_bits(cell) as i32)
    }

    fn splat(&self, record: usize) -> LidarSplat {
        let [x, y, z, range_m] = self.footprints[2 * record + 1].map(f32::from_bits);
        let [a, b, c] = std::array::from_fn(|word| self.shapes[3 * record + word]);
        LidarSplat {
            toward: Vec3::new(x, y, z),
            range_m,
            whiten: Mat3::from_cols(
                Vec3::new(a[0], a[1], a[2]),
                Vec3::new(0.0, b[0], b[1]),
                Vec3::new(0.0, 0.0, b[2]),
            ),
            drift_mps: Vec3::new(a[3], b[3], c[0]),
            log2_opacity: self.looks[record][0],
        }
    }

    /// Sector, column, row and index of each beam's cell.
    fn beam_cells(&self) -> Vec<[usize; 4]> {
        let mut cells = vec![[usize::MAX; 4]; self.beams.len()];
        for (sector, camera) in self.view.cameras.iter().enumerate() {
            let [columns, rows] = camera.size_px.map(|size| size as usize);
            for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |c| (row, c))) {
                let index = camera.first_pixel as usize + row * columns + column;
                let beam = self.cut.tables.beams[index];
                if beam.direction != [0.0; 3] {
                    cells[beam.index as usize] = [sector, column, row, index];
                }
            }
        }
        assert!(cells.iter().all(|cell| cell[0] != usize::MAX));
        cells
    }

    /// Records of the list of the coarse tile of a cell.
    fn list(&self, [sector, column, row, _]: [usize; 4]) -> &[u32] {
        let camera = &self.view.cameras[sector];
        let (x, y) = (
            column / COARSE_WIDTH_PX as usize,
            row / COARSE_HEIGHT_PX as usize,
        );
        let bin = camera.first_bin as usize + y * camera.coarse_tiles[0] as usize + x;
        let [first, count] = self.tile_lists[bin].map(|value| value as usize);
        &self.sorted[first..first + count]
    }
}

/// Intensity of a splat by its DC coefficients: luma (Rec. 709).
fn intensity_of(dc: Vec3) -> f32 {
    let rgb = (0.5 + 0.282_094_8 * dc).max(Vec3::ZERO);
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722)).min(1.0)
}

fn contains(outer: Cells, inner: Cells) -> bool {
    inner == NO_CELLS
        || (outer[0] <= inner[0]
            && outer[1] >= inner[1]
            && outer[2] <= inner[2]
            && outer[3] >= inner[3])
}

/// Sensor at 30 m/s that turns with 1 rad/s.
fn driving() -> Motion {
    Motion {
        velocity_mps: DVec3::new(24.0, 18.0, 0.0),
        turn_rad_per_s: DVec3::new(0.05, -0.1, 1.0),
    }
}

#[test]
fn records_are_those_of_the_twin() {
    let gpu = open();
    for (motion, antialias, storage) in [
        (Motion::REST, false, Storage::Exact),
        (driving(), true, Storage::Exact),
        (Motion::REST, false, Storage::Compact),
    ] {
        let mut world = surroundings(1500, 11);
        world.rules = Rules {
            antialias,
            ..Rules::DEFAULT
        };
        for (what, model) in models() {
            let lidar = lidar_at(model, DVec3::ZERO, motion);
            let listed = Listed::stored(&gpu, &world, &lidar, storage);
            let mut records = vec![None; 32 * world.splats.len()];
            for (record, (&splat, &sector)) in
                (listed.splat_of_record.iter().zip(&listed.sector_of_record)).enumerate()
            {
                records[sector * world.splats.len() + splat] = Some(record);
            }
            let mut unsettled = 0;
            for sector in 0..listed.view.cameras.len() {
                let view = listed.sector(sector);
                for (splat, &(mean_m, axes, opacity)) in listed.stored.iter().enumerate() {
                    // The kernel's cells lie between those with half and twice the room.
                    let [least, most] = [0.5, 2.0].map(|room| {
                        let constants = LidarConstants {
                            dilation_rad: LIDAR_DILATION_RAD as f32,
                            antialias,
                            moving: !motion.is_rest(),
                            slack: room * SLOPE_SLACK,
                        };
                        see_from_lidar(&view, &constants, mean_m, axes, opacity, Vec3::ZERO)
                    });
                    let cells = |seen: &Option<(LidarSplat, Cells)>| {
                        seen.map_or(NO_CELLS, |(_, cells)| cells)
                    };
                    let (least_cells, most_cells) = (cells(&least), cells(&most));
                    unsettled += usize::from(least_cells != most_cells);
                    let Some(record) = records[sector * world.splats.len() + splat] else {
                        assert_eq!(least_cells, NO_CELLS, "{what}: splat {splat} is missing");
                        continue;
                    };
                    let found = listed.cells(record);
                    assert!(
                        contains(most_cells, found) && contains(found, least_cells),
                        "{what}: splat {splat} has cells {found:?}; the twin {least_cells:?} to {most_cells:?}"
                    );
                    let (twin, _) = most.unwrap();
                    let kernel = listed.splat(record);
                    let intensity = intensity_of(listed.dc[splat]);
                    assert!(
                        (listed.looks[record][1] - intensity).abs() <= 1e-6,
                        "{what}: splat {splat} has intensity {}, the twin {intensity}",
                        listed.looks[record][1]
                    );
                    let near = |a: Vec3, b: Vec3, scale: f32| (a - b).length() <= 2e-5 * scale;
                    let size = |m: Mat3| m.x_axis.length() + m.y_axis.length() + m.z_axis.length();
                    let scale = size(twin.whiten);
                    assert!(
                        near(kernel.toward, twin.toward, 1.0)
                            && near(kernel.drift_mps, twin.drift_mps, 30.0)
                            && (kernel.range_m - twin.range_m).abs() <= 2e-6 * twin.range_m
                            && (kernel.log2_opacity - twin.log2_opacity).abs() < 1e-4
                            && size(kernel.whiten - twin.whiten) <= 2e-3 * scale,
                        "{what}: splat {splat}: {kernel:?}, the twin {twin:?}"
                    );
                }
            }
            println!(
                "{what}: {} records, {unsettled} with cells that rounding may move",
                listed.splat_of_record.len()
            );
            assert!(unsettled * 20 < listed.splat_of_record.len());
        }
    }
}

#[test]
fn words_of_fine_tiles_are_those_that_the_records_reach() {
    let gpu = open();
    let world = surroundings(1500, 14);
    for (what, model) in models() {
        let listed = Listed::new(&gpu, &world, &lidar_at(model, DVec3::ZERO, Motion::REST));
        let (mut shared_words, mut set, mut unset) = (0, 0, 0);
        for camera in &listed.view.cameras {
            let [columns, rows] = camera.coarse_tiles;
            for coarse in 0..columns * rows {
                let bin = (camera.first_bin + coarse) as usize;
                let [first, count] = listed.tile_lists[bin].map(|value| value as usize);
                let corner = [
                    coarse % columns * COARSE_WIDTH_PX,
                    coarse / columns * COARSE_HEIGHT_PX,
                ];
                for pair in first..first + count {
                    let word = pair / 32;
                    let whole = 32 * word + 31 < first + count;
                    shared_words += usize::from(32 * word < first || !whole);
                    let place = match whole {
                        true => word,
                        false => listed.pairs_max.div_ceil(32) + bin,
                    };
                    let [left, right, top, bottom] = listed.cells(listed.sorted[pair] as usize);
                    for tile in 0..32 {
                        let [x, y] = [corner[0] + tile % 8 * 8, corner[1] + tile / 8 * 8]
                            .map(|corner| corner as i32);
                        let reaches = left <= x + 7 && right >= x && top <= y + 7 && bottom >= y;
                        let bits = listed.tile_words[32 * place + tile as usize];
                        let found = bits >> (pair % 32) & 1 == 1;
                        assert_eq!(found, reaches, "{what}: pair {pair}, tile {tile} of {bin}");
                        (set, unset) = (set + usize::from(found), unset + usize::from(!found));
                    }
                }
            }
        }
        assert!(
            shared_words > 0 && set > 1000 && unset > 1000,
            "{what}: {shared_words} pairs in shared words, {set} bits set, {unset} not"
        );
    }
}

#[test]
fn beams_meet_their_lists_as_the_twin_does() {
    let gpu = open();
    for motion in [Motion::REST, driving()] {
        let world = surroundings(1500, 12);
        for (what, model) in models() {
            let lidar = lidar_at(model, DVec3::ZERO, motion);
            let listed = Listed::new(&gpu, &world, &lidar);
            let (mut medians, mut seconds) = (0, 0);
            for cell in listed.beam_cells().into_iter().step_by(7) {
                let beam = listed.cut.tables.beams[cell[3]];
                let firing = &listed.cut.tables.firings[beam.firing as usize];
                let traced = TwinBeam {
                    direction: Vec3::from_array(beam.direction),
                    firing: (!motion.is_rest()).then_some(firing),
                    alpha_max: world.rules.alpha_max as f32,
                    range_min_m: lidar.model.range_m[0] as f32,
                };
                let mut twin = BeamState {
                    transmittance: 1.0,
                    ..BeamState::default()
                };
                let mut echoes = BeamEchoes::default();
                for &record in listed.list(cell) {
                    let record = record as usize;
                    let [_, intensity, instance] = listed.looks[record];
                    let splat = listed.splat(record);
                    let [left, right, top, bottom] = listed.cells(record).map(|cell| cell / 8);
                    let [column, row] = [cell[1], cell[2]].map(|cell| cell as i32 / 8);
                    if twin.transmittance <= 1e-4
                        || !(left..=right).contains(&column)
                        || !(top..=bottom).contains(&row)
                    {
                        continue;
                    }
                    let look = (intensity, instance.to_bits());
                    meet(&splat, look, &traced, (&mut twin, &mut echoes));
                }
                let kernel = listed.states[beam.index as usize];
                let near = |a: f32, b: f32| (a - b).abs() <= 1e-3 + 1e-4 * b.abs();
                assert!(
                    near(kernel.transmittance, twin.transmittance)
                        && near(kernel.range_sum_m, twin.range_sum_m)
                        && near(kernel.intensity_sum, twin.intensity_sum)
                        && near(kernel.median_m, twin.median_m)
                        && kernel.instances == twin.instances,
                    "{what}, cell {cell:?}: {kernel:?}, the twin {twin:?}"
                );
                medians += usize::from(twin.median_m > 0.0);
                let of_kernel = listed.echoes[beam.index as usize];
                let records = |found: &BeamEchoes| [found.open, found.strongest, found.last];
                for (a, b) in records(&of_kernel).into_iter().zip(records(&echoes)) {
                    assert!(
                        near(a.weight, b.weight)
                            && near(a.range_sum_m, b.range_sum_m)
                            && near(a.intensity_sum, b.intensity_sum)
                            && a.instance == b.instance,
                        "{what}, cell {cell:?}: {of_kernel:?}, the twin {echoes:?}"
                    );
                }
                seconds += usize::from(echoes.found()[1].is_some());
            }
            assert!(
                medians > 50 && seconds > 20,
                "{what}: only {medians} medians and {seconds} second returns were compared"
            );
        }
    }
}

/// Asserts that every splat of `world` that adds to a beam by definition is in the list of the
/// beam's coarse tile, with cells around the beam's; returns pairs tested and pairs that add.
fn check_lists(what: &str, listed: &Listed, world: &SplatScene, lidar: &Lidar) -> [usize; 2] {
    let truth = LidarSplats64 {
        groups: vec![SplatGroup {
            splats: &world.splats,
            instances: &[],
            instance: 0,
            world_from_splats: Pose::new(DQuat::IDENTITY, world.origin),
            motion: Motion::REST,
        }],
        rules: world.rules,
    };
    let contributions = truth.contributions(lidar, &listed.beams);
    let (mut adding, mut tested) = (0, 0);
    for (cell, found) in listed.beam_cells().into_iter().zip(&contributions) {
        let (column, row) = (cell[1] as i32, cell[2] as i32);
        let reaches = |&record: &u32| {
            let [left, right, top, bottom] = listed.cells(record as usize);
            (left..=right).contains(&column) && (top..=bottom).contains(&row)
        };
        let reached: Vec<usize> = (listed.list(cell).iter().filter(|record| reaches(record)))
            .map(|&record| listed.splat_of_record[record as usize])
            .collect();
        tested += reached.len();
        for met in found {
            // Rounding decides at the threshold itself.
            if met.alpha < (1.0 + 1e-4) / 255.0 {
                continue;
            }
            adding += 1;
            assert!(
                reached.contains(&(met.splat as usize)),
                "{what}: the beam of cell {cell:?} meets splat {} with alpha {}, and its list lacks it",
                met.splat,
                met.alpha
            );
        }
    }
    println!("{what}: {tested} pairs tested, {adding} add to a beam, 0 missing");
    [tested, adding]
}

/// Sectors of uneven grids have columns without a beam in some rows: bounds do not depend on how
/// threads share the rows.
#[test]
fn sectors_do_not_depend_on_threads() {
    for (what, model) in models() {
        let lidar = lidar_at(model, DVec3::ZERO, Motion::REST);
        let (beams, cells) = (lidar.model.beams(), lidar.model.cells());
        let plan = SectorPlan::new(&beams, &cells, 8);
        let of_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| Sectors::new(&lidar, &cells, &plan, Vec::new()).tables)
        };
        let alone = of_threads(1);
        let bounds = alone.column_bounds.iter().chain(&alone.row_bounds);
        assert!(bounds.flatten().all(|bound| bound.is_finite()), "{what}");
        for threads in [2, 8, 24] {
            assert!(of_threads(threads) == alone, "{what}, {threads} threads");
        }
    }
}

#[test]
fn no_beam_misses_a_splat() {
    let gpu = open();
    let (mut tested, mut adding) = (0, 0);
    for seed in 0..4 {
        let mut world = surroundings(600 + 300 * seed, seed as u64 + 20);
        world.origin = DVec3::new(1e6 * seed as f64, -2e5, 12.0);
        for motion in [Motion::REST, driving()] {
            for (what, model) in models() {
                let lidar = lidar_at(model, world.origin, motion);
                let listed = Listed::new(&gpu, &world, &lidar);
                let [of_tested, of_adding] = check_lists(what, &listed, &world, &lidar);
                (tested, adding) = (tested + of_tested, adding + of_adding);
            }
        }
    }
    assert!(adding > 100_000, "{adding} pairs prove too little");
    assert!(tested < 20 * adding, "{tested} tests for {adding} pairs");
}

#[test]
#[should_panic(expected = "and its list lacks it")]
fn a_missing_splat_is_noticed() {
    let gpu = open();
    let world = surroundings(900, 31);
    let mut smaller = world.clone();
    for scales in &mut smaller.splats.scales {
        *scales = scales.map(|scale| 0.8 * scale);
    }
    let (what, model) = models().swap_remove(0);
    let lidar = lidar_at(model, world.origin, Motion::REST);
    let listed = Listed::new(&gpu, &smaller, &lidar);
    check_lists(what, &listed, &world, &lidar);
}
