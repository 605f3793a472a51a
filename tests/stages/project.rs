//! `project.comp`: footprint, depth key and colour of every visible splat.

use decouplegs::render::layout::CameraRecord;
use decouplegs::render::stages::{Project, ProjectVariant, Projected, SortScratch, Visible};
use decouplegs::render::twins;
use decouplegs::render::twins::projection::{from_camera_m, matrix_from_quaternion};
use decouplegs::render::twins::record::load_footprint;
use decouplegs::scene::rules::DILATION_PX2;
use decouplegs::scene::{DepthOrder, Rules};
use glam::{DVec2, DVec3, Vec3};

use super::scenes::{Listed, ProjectedTwin, Scene, Unranked, hard_world, rig, settled_tile_count};
use super::{ROUNDOFF, UNTOUCHED, identical, open, run, sort_shape, upload, within};
use crate::device::Validated;

/// How far f32 arithmetic may take the values of one record from one another, in the order in which they are stored.
///
/// A forward error analysis to first order (Higham, Accuracy and Stability of Numerical Algorithms, 2002, chapter 3): both
/// sides do the same operations, each rounded once, fused or not; a division may be off by 5 roundings and a logarithm by 2^-21
/// or 6 roundings (Vulkan specification, Precision of SPIR-V Instructions).
struct RecordBounds {
    footprint: [f64; 6],
    depth_m: f64,
    colour: f64,
}

impl RecordBounds {
    fn of(scene: &Scene, camera: usize, splat: usize, rules: &Rules) -> Self {
        let k = &scene.view.cameras[camera];
        let offset = from_camera_m(scene.means_m[splat], k).as_dvec3();
        let rows = [k.row_x, k.row_y, k.row_z].map(|row| Vec3::from_array(row).as_dvec3());
        let t = DVec3::new(rows[0].dot(offset), rows[1].dot(offset), rows[2].dot(offset));
        let u = ROUNDOFF;
        let t_error = 8.0 * u * offset.abs().element_sum();
        let focal = DVec2::from_array(k.focal_px.map(f64::from));
        let xy = t.truncate() / t.z;
        let xy_error = (DVec2::ONE + xy.abs()) * (t_error / t.z) + 6.0 * u * xy.abs();
        let mean_error = focal * xy_error + 4.0 * u * (focal * xy.abs() + DVec2::from_array(k.principal_px.map(f64::from)).abs());

        let low = DVec2::from_array(k.slope_min.map(f64::from));
        let slope = xy.max(low).min(DVec2::from_array(k.slope_max.map(f64::from)));
        let scales = DVec3::from_slice(&scene.shapes[splat][..3].iter().map(|&s| f64::from(s)).collect::<Vec<_>>());
        let turned = matrix_from_quaternion(scene.rotations[splat]).as_dmat3();
        let [row_x, row_y, row_z] = rows.map(|row| (turned.transpose() * row) * scales);
        // Of one of the projected axes: entries of the rotation are sums of products off by some roundings of 1.
        let axis = |row: DVec3, slope: f64, slope_error: f64, focal: f64| {
            let m = (row - slope * row_z) * (focal / t.z);
            let inner = scales * (40.0 * u * (1.0 + slope.abs()) + slope_error);
            (m, (inner * (focal / t.z) + m.abs() * (t_error / t.z + 8.0 * u)).length())
        };
        let (m0, e0) = axis(row_x, slope.x, xy_error.x, focal.x);
        let (m1, e1) = axis(row_y, slope.y, xy_error.y, focal.y);
        let shape = Shape { m0: m0.length(), m1: m1.length(), area: m0.cross(m1).length(), xy: m0.dot(m1), e0, e1 };
        let [slope, rate_x, rate_y, log2_opacity] = shape.errors(f64::from(scene.shapes[splat][3]), rules.antialias);
        let radial = rules.order == DepthOrder::Radial;
        Self {
            footprint: [mean_error.x, mean_error.y, slope, rate_x, rate_y, log2_opacity],
            depth_m: if radial { 8.0 * u * offset.length() } else { t_error },
            // A unit vector is off by some 12 roundings, and no basis function is steeper than 10.
            colour: 200.0 * u,
        }
    }
}

/// The projected axes in pixels, their cross and dot products, and how far either axis is off.
struct Shape {
    m0: f64,
    m1: f64,
    area: f64,
    xy: f64,
    e0: f64,
    e1: f64,
}

impl Shape {
    /// Of slope, both rates and log2 opacity.
    fn errors(&self, opacity: f64, antialias: bool) -> [f64; 4] {
        let Self { m0, m1, area, xy, e0, e1 } = *self;
        let u = ROUNDOFF;
        let (xx, yy) = (m0 * m0, m1 * m1);
        let (xx_error, yy_error) = (2.0 * m0 * e0 + 4.0 * u * xx, 2.0 * m1 * e1 + 4.0 * u * yy);
        let xy_error = m0 * e1 + m1 * e0 + 4.0 * u * m0 * m1;
        let area_error = m0 * e1 + m1 * e0 + 8.0 * u * m0 * m1;
        let undilated = area * area;
        let undilated_error = 2.0 * area * area_error + area_error * area_error + 4.0 * u * undilated;
        let determinant = undilated + DILATION_PX2 * (xx + yy) + DILATION_PX2 * DILATION_PX2;
        let determinant_share = (undilated_error + DILATION_PX2 * (xx_error + yy_error)) / determinant + 6.0 * u;
        let variance = yy + DILATION_PX2;
        let variance_share = yy_error / variance + 3.0 * u;
        let rate_y = (0.721 / variance).sqrt();
        let rate_x = (0.721 * variance / determinant).sqrt();
        let paid = 0.5 * (undilated_error / undilated + determinant_share) + 10.0 * u;
        let log2 = |value: f64| (6.0 * u * value.log2().abs()).max(2f64.powi(-21));
        [
            xy_error / variance + (xy / variance).abs() * (variance_share + 6.0 * u),
            rate_x * (0.5 * (variance_share + determinant_share) + 12.0 * u),
            rate_y * (0.5 * variance_share + 12.0 * u),
            if antialias { log2(opacity * (undilated / determinant).sqrt()) + 1.45 * paid } else { log2(opacity) },
        ]
    }
}

/// One run of the stage: what is drawn and how.
struct Case {
    scene: Scene,
    listed: Listed,
    rules: Rules,
    variant: ProjectVariant,
    room: usize,
}

impl Case {
    fn new(gpu: &Validated, splats: usize, rules: Rules, variant: ProjectVariant) -> Self {
        let scene = Scene::new(gpu, &hard_world(splats, 11), &rig());
        let listed = scene.listed(&rules);
        let room = listed.records.len();
        Self { scene, listed, rules, variant, room }
    }

    fn twin(&self) -> ProjectedTwin {
        self.scene.projected(&self.listed, &self.rules, usize::from(self.variant.sh_degree), self.variant.instances, self.room)
    }

    fn kernel(&self, gpu: &Validated) -> ProjectedTwin {
        let Self { scene, listed, rules, variant, room } = self;
        let cameras = scene.view.cameras.len();
        let visible = Visible::new(gpu, cameras, scene.chunks.len()).unwrap();
        gpu.write(&visible.words, 0, &listed.words).unwrap();
        let projected = Projected::new(gpu, *room).unwrap();
        gpu.write(&projected.tile_counts, 0, &vec![UNTOUCHED; *room]).unwrap();
        let sort = SortScratch::new(gpu, sort_shape(gpu), *room).unwrap();
        gpu.write(&sort.keys[0], 0, &vec![UNTOUCHED; *room]).unwrap();
        gpu.write(&sort.values[0], 0, &vec![UNTOUCHED; *room]).unwrap();
        let unranked = Unranked::new(gpu);
        let firsts = upload(gpu, &listed.firsts);
        let project = Project::new(gpu, rules, *variant).unwrap();
        run(gpu, |r| {
            let (cameras_of, ranked) = (&scene.camera_buffer, unranked.ranked());
            project.record(r, &scene.resident, cameras_of, cameras, &visible, &firsts, &projected, &sort, &ranked);
        });
        ProjectedTwin {
            footprints: gpu.read(&projected.footprints).unwrap(),
            colours: gpu.read(&projected.colours).unwrap(),
            keys: gpu.read(&sort.keys[0]).unwrap(),
            values: gpu.read(&sort.values[0]).unwrap(),
            tile_counts: gpu.read(&projected.tile_counts).unwrap(),
        }
    }

    fn check(&self, kernel: &ProjectedTwin, twin: &ProjectedTwin) -> Result<(), String> {
        self.check_floats(kernel, twin)?;
        self.check_keys(kernel, twin)?;
        identical("values", &kernel.values, &twin.values)?;
        self.check_tile_counts(kernel)
    }

    fn check_floats(&self, kernel: &ProjectedTwin, twin: &ProjectedTwin) -> Result<(), String> {
        let mut worst = [0.0f64; 2];
        for (record, &(camera, splat)) in self.listed.records[..self.room].iter().enumerate() {
            let bounds = RecordBounds::of(&self.scene, camera, splat, &self.rules);
            let [a, b] = [kernel, twin].map(|side| {
                let [low, high] = [side.footprints[2 * record], side.footprints[2 * record + 1]];
                ([low[0], low[1], low[2], low[3], high[0], high[1], high[2]], high[3].to_bits())
            });
            let [mean_x, mean_y, slope, rate_x, rate_y, log2_opacity] = bounds.footprint;
            let footprint = [mean_x, mean_y, slope, rate_x, rate_y, log2_opacity, bounds.depth_m];
            let what = format!("record {record} of splat {splat}, kind {}", splat % 16);
            worst[0] = worst[0].max(within(&what, &a.0, &b.0, &footprint)?);
            identical("instance", &[a.1], &[b.1])?;
            let amplitude = 1.0 + self.coefficient_sum(splat);
            let colours = [&kernel.colours[record][..3], &twin.colours[record][..3]];
            worst[1] = worst[1].max(within(&what, colours[0], colours[1], &[bounds.colour * amplitude; 3])?);
        }
        println!("{} records: {:.3} of the bound of footprints, {:.3} of that of colours", self.room, worst[0], worst[1]);
        Ok(())
    }

    /// Sum of the largest SH coefficients, DC among them.
    fn coefficient_sum(&self, splat: usize) -> f64 {
        let stored = self.scene.sh();
        let rest = if self.variant.sh_degree > 0 { 15.0 * 0.3 } else { 0.0 };
        rest + stored.sh_dc[splat].iter().fold(0.0, |largest, &c| f64::from(c.abs()).max(largest))
    }

    /// The shader computes a depth with 48 digits and the twin with 53: a step's edge may fall between the two.
    fn check_keys(&self, kernel: &ProjectedTwin, twin: &ProjectedTwin) -> Result<(), String> {
        let apart = |(a, b): (&u32, &u32)| a.abs_diff(*b);
        let different = kernel.keys.iter().zip(&twin.keys).map(apart).filter(|&steps| steps > 0).count();
        if kernel.keys.iter().zip(&twin.keys).map(apart).any(|steps| steps > 1) || different * 1000 > self.room {
            return identical("keys, which may be a step apart in one of a thousand", &kernel.keys, &twin.keys);
        }
        Ok(())
    }

    /// From the kernel's own footprints, so that nothing else differs.
    fn check_tile_counts(&self, kernel: &ProjectedTwin) -> Result<(), String> {
        let mut unsettled = 0;
        for (record, &(camera, splat)) in self.listed.records[..self.room].iter().enumerate() {
            let camera: &CameraRecord = &self.scene.view.cameras[camera];
            match settled_tile_count(&load_footprint(&kernel.footprints, record), camera) {
                Some(count) if count != kernel.tile_counts[record] => {
                    let kernel = kernel.tile_counts[record];
                    return Err(format!("tile count of record {record}, splat {splat}: {kernel}, the twin has {count}"));
                }
                Some(_) => {}
                None => unsettled += 1,
            }
        }
        assert!(unsettled * 50 <= self.room, "{unsettled} of {} tile counts are left to rounding", self.room);
        Ok(())
    }
}

const PLAIN: ProjectVariant = ProjectVariant { sh_degree: 0, instances: false, ranked: false, splat_ids: false };

#[test]
fn records_of_hard_splats() {
    let gpu = open();
    for (rules, variant) in [
        (Rules::DEFAULT, ProjectVariant { sh_degree: 3, instances: true, ranked: false, splat_ids: false }),
        (Rules::DEFAULT, ProjectVariant { sh_degree: 1, instances: false, ranked: false, splat_ids: false }),
        (Rules { order: DepthOrder::Radial, ..Rules::DEFAULT }, PLAIN),
        (
            Rules { antialias: true, ..Rules::INRIA },
            ProjectVariant { sh_degree: 2, instances: true, ranked: false, splat_ids: false },
        ),
    ] {
        let case = Case::new(&gpu, 3000, rules, variant);
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn records_without_room_are_left_out() {
    let gpu = open();
    let mut case = Case::new(&gpu, 700, Rules::DEFAULT, PLAIN);
    for room in [1, 200, case.room - 1] {
        case.room = room;
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn keys_are_depths_in_order() {
    let gpu = open();
    let case = Case::new(&gpu, 2000, Rules::DEFAULT, PLAIN);
    let keys = case.kernel(&gpu).keys;
    // Between -1 and 1 over a world whose farthest splat is 10^7 m away: a step is 2^-42 of that, or 2^-27 of the depth.
    let depth = |record: usize| {
        let (camera, splat) = case.listed.records[record];
        twins::depth_key::scaled_depth(case.scene.means_m[splat], &case.scene.view.cameras[camera], false)
    };
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by_key(|&record| keys[record]);
    for pair in order.windows(2) {
        let step = (depth(pair[1]).abs() * 2f64.powi(-26)).max(2f64.powi(-41));
        assert!(depth(pair[0]) <= depth(pair[1]) + step, "records {pair:?} are in the wrong order");
    }
}

#[test]
fn one_changed_value_is_seen() {
    let gpu = open();
    let case =
        Case::new(&gpu, 500, Rules::DEFAULT, ProjectVariant { sh_degree: 3, instances: true, ranked: false, splat_ids: false });
    let kernel = case.kernel(&gpu);
    let ordinary = case.listed.records.iter().position(|&(_, splat)| splat % 16 > 9).unwrap();
    let failure = |change: fn(&mut ProjectedTwin, usize)| {
        let mut twin = case.twin();
        case.check(&kernel, &twin).unwrap();
        change(&mut twin, ordinary);
        case.check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(|twin, i| twin.footprints[2 * i][3] *= 1.0001).contains("value 3"));
    assert!(failure(|twin, i| twin.colours[i][1] += 0.001).contains("value 1"));
    assert!(failure(|twin, i| twin.footprints[2 * i + 1][3] = f32::from_bits(9)).contains("instance"));
    assert!(failure(|twin, i| twin.keys[i] += 2).contains("keys"));
    let mut wrong = case.kernel(&gpu);
    wrong.tile_counts[ordinary] += 1;
    assert!(case.check(&wrong, &case.twin()).unwrap_err().contains("tile count"));
}
