//! Invariants of any splat and any camera.

use decouplegs::render::layout::{CameraRecord, View, response_squares_max};
use decouplegs::render::reference;
use decouplegs::render::stages::{Project, ProjectInputs, Projected, Visible};
use decouplegs::render::twins::footprint::{
    Footprint, log2_alpha, reached_coarse_rows, reached_coarse_tiles,
};
use decouplegs::render::twins::projection::{
    Variant, axes_of, from_camera_m, project_splat, to_camera_axes,
};
use decouplegs::scene::rules::ALPHA_MIN;
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, Rules, SplatScene};
use glam::{DQuat, DVec2, DVec3, Vec3};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

use super::project::PLAIN;
use super::scenes::{LABELED, NoKeys, Scene, hard_splats, hard_world, rig};
use super::{open, run, upload};
use crate::device::Validated;
use crate::frames::{Splat, camera_at, draw, world_of};

const SIZE: (u32, u32) = (150, 90);

/// Means for which footprint.glsl promises its slack to be enough.
const MEAN_MAX_PX: f32 = 1e5;

/// Needles, discs and balls from a tenth of a millimeter to a kilometer, from the near plane on, in
/// and far beside the image.
fn any_splat() -> impl Strategy<Value = Splat> {
    let length_m = || (-4.0f32..3.0).prop_map(|exponent| 10f32.powf(exponent));
    let depth_m = (-2.0f32..2.0).prop_map(|exponent| 10f32.powf(exponent));
    let slope = prop_oneof![3 => -0.7f32..0.7, 1 => -30.0f32..30.0];
    let opacity = prop_oneof![Just(1.0f32), 0.0039f32..0.0045, 0.004f32..1.0];
    (
        prop::array::uniform3(length_m()),
        depth_m,
        slope.clone(),
        slope,
        prop::array::uniform4(-1.0f32..1.0),
        opacity,
    )
        .prop_filter("a rotation has a direction", |(_, _, _, _, q, _)| {
            q.iter().map(|x| x * x).sum::<f32>() > 0.01
        })
        .prop_map(|(scale_m, z, x, y, rotation, opacity)| Splat {
            scale_m,
            rotation,
            opacity,
            ..Splat::at(x * z, y * z, z)
        })
}

/// The footprint that the twin gives the splat, `None` where it is not drawn.
fn footprint_of(splat: &Splat, camera: &CameraRecord, rules: &Rules) -> Option<Footprint> {
    let q = splat.rotation.map(f64::from);
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [sx, sy, sz] = splat.scale_m;
    let axes = axes_of([sx, sy, sz, splat.opacity], q.map(|x| (x / norm) as f32));
    let t = to_camera_axes(camera, from_camera_m(splat.mean_m, camera));
    let (footprint, drawn) =
        project_splat(camera, t, axes, splat.opacity, Variant::for_rules(rules));
    drawn.then_some(footprint)
}

/// True if the list of the pixel's coarse tile contains the splat.
fn is_listed(splat: &Footprint, most: f32, column: u32, row: u32) -> bool {
    let [first, last] = reached_coarse_rows(splat, most, SIZE.1);
    let tile_row = (row / 32) as i32;
    let [left, right] = reached_coarse_tiles(splat, most, row / 32, [SIZE.0, SIZE.1]);
    (first..=last).contains(&tile_row) && (left..=right).contains(&((column / 64) as i32))
}

/// log2 of the footprint's alpha in f64.
fn log2_alpha_f64(splat: &Footprint, center: DVec2) -> f64 {
    let d = center - splat.mean_px.as_dvec2();
    let u = (d.x - f64::from(splat.slope) * d.y) * f64::from(splat.rate_x);
    let v = d.y * f64::from(splat.rate_y);
    f64::from(splat.log2_opacity) - u * u - v * v
}

/// A pixel that `splat` reaches, by its footprint or by definition, and that no list has it for.
fn pixel_left_out(
    splat: &Splat,
    rules: &Rules,
    is_listed: fn(&Footprint, f32, u32, u32) -> bool,
) -> Option<String> {
    let camera = camera_at(DVec3::ZERO, SIZE.0, SIZE.1);
    let record = CameraRecord::new(&camera, DVec3::ZERO, 1.0, 0, 0);
    let footprint = footprint_of(splat, &record, rules);
    let cloud = world_of(std::slice::from_ref(splat)).splats;
    let most = response_squares_max(rules);
    let truth = reference::project::View::new(DVec3::ZERO, &camera, rules).project(&cloud, 0);
    for row in 0..SIZE.1 {
        for column in 0..SIZE.0 {
            let center = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let listed =
                footprint.is_some_and(|footprint| is_listed(&footprint, most, column, row));
            if let Some(footprint) =
                footprint.filter(|footprint| footprint.mean_px.abs().max_element() < MEAN_MAX_PX)
            {
                let least = (footprint.log2_opacity - most).max(ALPHA_MIN.log2() as f32);
                let counts = log2_alpha_f64(&footprint, center) >= f64::from(least)
                    || log2_alpha(&footprint, center.as_vec2()) >= least;
                if counts && !listed {
                    return Some(format!(
                        "column {column}, row {row} of the footprint {footprint:?}"
                    ));
                }
            }
            // By definition, with a hundredth of the thresholds for the rounding of the projection
            // itself.
            let alpha = truth
                .as_ref()
                .and_then(|truth| reference::blend::alpha_at(truth, center, rules))
                .unwrap_or(0.0);
            let response = alpha / truth.as_ref().map_or(1.0, |truth| truth.opacity);
            let counts = alpha >= 1.01 * ALPHA_MIN && response >= 1.01 * rules.response_min;
            if counts && !listed {
                return Some(format!(
                    "column {column}, row {row}: alpha {alpha} by definition"
                ));
            }
        }
    }
    None
}

proptest! {
    #![proptest_config(Config::with_cases(600))]

    #[test]
    fn lists_hold_every_pixel_that_a_splat_reaches(splat in any_splat(), antialias: bool) {
        for rules in [Rules::DEFAULT, Rules::NUREC] {
            let left_out = pixel_left_out(&splat, &Rules { antialias, ..rules }, is_listed);
            prop_assert!(left_out.is_none(), "{}", left_out.unwrap());
        }
    }
}

#[test]
fn a_list_that_ends_a_pixel_early_is_seen() {
    // The ball's edge falls into the first column of the second coarse tile.
    let splat = Splat {
        scale_m: [1.0; 3],
        opacity: 1.0,
        ..Splat::at(-0.5, 0.0, 4.0)
    };
    assert_eq!(pixel_left_out(&splat, &Rules::DEFAULT, is_listed), None);
    let without_last_tile =
        |splat: &Footprint, most, column, row| is_listed(splat, most, column, row) && column < 128;
    assert!(pixel_left_out(&splat, &Rules::DEFAULT, without_last_tile).is_some());
}

#[test]
fn culled_splats_change_nothing() {
    let gpu = open();
    let cameras = &rig()[..2];
    let mut runner = TestRunner::new(Config::with_cases(8));
    let property = |seed: u64| {
        let world = hard_world(500, seed);
        let scene = Scene::new(&gpu, &world, cameras);
        let unseen = |splat: usize| {
            (0..cameras.len()).all(|camera| {
                scene.settled_visibility(camera, splat, &Rules::DEFAULT) == Some(false)
            })
        };
        // The farthest one sets the steps in which depths are counted, and so what ties: it stays,
        // seen or not.
        let distance_m =
            |&splat: &usize| f64::from(Vec3::from_array(scene.means_m[splat]).length());
        let farthest = (0..500)
            .max_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))
            .unwrap();
        let kept: Vec<u32> = (0..500)
            .filter(|&splat| splat == farthest || !unseen(splat))
            .map(|splat| splat as u32)
            .collect();
        prop_assert!(
            kept.len() < 400,
            "few splats are culled: the property says little"
        );
        let without = |kept: &[u32]| SplatScene {
            instance_from_splat: kept
                .iter()
                .map(|&splat| world.instance_from_splat[splat as usize])
                .collect(),
            ..SplatScene::from_splats(world.splats.select(kept))
        };
        let images = draw(&gpu, &world, cameras, Rules::DEFAULT);
        prop_assert!(
            draw(&gpu, &without(&kept), cameras, Rules::DEFAULT) == images,
            "a culled splat is in the image"
        );
        prop_assert!(
            draw(
                &gpu,
                &without(&kept[kept.len() / 2..]),
                cameras,
                Rules::DEFAULT
            ) != images,
            "no splat is"
        );
        Ok(())
    };
    runner.run(&(0..u64::MAX / 2), property).unwrap();
}

/// Depth keys of all splats as the kernel finds them, by splat; all splats are in front of the
/// camera.
fn depth_keys(gpu: &Validated, world: &SplatScene, camera: &Camera) -> Vec<u32> {
    let scene = Scene::new(gpu, world, std::slice::from_ref(camera));
    let splats = world.splats.len();
    let visible = Visible::new(gpu, 1, scene.clusters.len()).unwrap();
    let mut words = vec![u32::MAX; visible.words.len()];
    for bit in splats..words.len() * 32 {
        words[bit / 32] &= !(1 << (bit % 32));
    }
    gpu.write(&visible.words, 0, &words).unwrap();
    let offsets: Vec<u32> = (0..scene.clusters.len() as u32)
        .map(|cluster| cluster * 256)
        .collect();
    let projected = Projected::new(gpu, splats, 0, LABELED).unwrap();
    let (offsets, no_keys) = (upload(gpu, &offsets), NoKeys::new(gpu));
    let shadows = scene.shadow_buffers(gpu);
    let project = Project::new(gpu, &Rules::DEFAULT, PLAIN).unwrap();
    run(gpu, |r| {
        let inputs = ProjectInputs {
            visible: &visible,
            offsets: &offsets,
            kept: no_keys.kept(),
            shadows: &shadows,
            shadow_count: 0,
            flow_interval_s: 0.0,
        };
        project.record(r, &scene.resident, scene.views(), inputs, &projected);
    });
    gpu.read(&projected.keys).unwrap()
}

#[test]
fn a_camera_that_does_not_turn_changes_no_key() {
    let gpu = open();
    let splats: Vec<Splat> = hard_splats(700, 5)
        .into_iter()
        .filter(|splat| splat.mean_m[0].abs() < 60.0 && splat.mean_m[2] > 0.1)
        .map(|splat| Splat {
            scale_m: [0.1; 3],
            ..splat
        })
        .collect();
    let world = world_of(&splats);
    let mut runner = TestRunner::new(Config::with_cases(12));
    let property = |(center_m, turn): ([f64; 3], f64)| {
        let camera = |center: DVec3, turn: f64| {
            let pose = Pose::new(
                DQuat::from_rotation_z(turn) * DQuat::from_rotation_y(0.1 * turn),
                center,
            );
            Camera {
                name: "moved".into(),
                intrinsics: Intrinsics::from_horizontal_fov(64, 64, 1.0),
                world_from_camera: pose,
                motion: Motion::REST,
            }
        };
        let center = DVec3::from_array(center_m.map(|x| (x * 1024.0).round() / 1024.0));
        let keys = depth_keys(&gpu, &world, &camera(DVec3::ZERO, turn));
        prop_assert!(keys.iter().any(|&key| key != keys[0]));
        prop_assert!(
            depth_keys(&gpu, &world, &camera(center, turn)) == keys,
            "a key has changed"
        );
        // A thousandth of a thousandth of a degree is seen.
        prop_assert!(depth_keys(&gpu, &world, &camera(center, turn + 2e-8)) != keys);
        // Moved by its origin, the world is the same to the last bit.
        let origin = DVec3::new(4.5e6, 0.7e6, 100.0);
        let [here, there] = [(center, DVec3::ZERO), (center + origin, origin)]
            .map(|(center, origin)| View::new(&[camera(center, turn)], origin, 100.0).unwrap());
        prop_assert_eq!(&here.cameras, &there.cameras);
        Ok(())
    };
    runner
        .run(
            &(prop::array::uniform3(-4e3f64..4e3), -0.5f64..0.5),
            property,
        )
        .unwrap();
}
