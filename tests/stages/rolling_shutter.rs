//! Culling and projection under rolling shutters: kernels against twins.
//!
//! The time of a splat comes from four steps of Newton's method, whose rounding no simple bound
//! covers. So nearly all records lie within fixed tolerances, instead of all within derived ones.

use decouplegs::render::layout::CLUSTER_SPLATS;
use decouplegs::render::stages::{CameraVariant, ProjectVariant};
use decouplegs::scene::{Camera, Intrinsics, Motion, Rules, Shutter, ShutterDirection};
use glam::DVec3;

use super::cull::visible;
use super::open;
use super::project::{Case, PLAIN};
use super::scenes::{ProjectedTwin, Scene, hard_world, lens_rig, rig};

/// `cameras` that move, each with its own direction of readout.
fn moving(cameras: Vec<Camera>) -> Vec<Camera> {
    let directions = ShutterDirection::ALL.into_iter().skip(1).cycle();
    let moves = |(camera, direction): (Camera, ShutterDirection)| {
        let k = camera.intrinsics;
        Camera {
            intrinsics: Intrinsics {
                shutter: Shutter::new(direction, 0.03, [k.width_px, k.height_px]),
                ..k
            },
            motion: Motion {
                velocity_mps: DVec3::new(3.0, -1.0, 10.0),
                turn_rad_per_s: DVec3::new(0.2, 1.0, -0.4),
            },
            ..camera
        }
    };
    cameras.into_iter().zip(directions).map(moves).collect()
}

/// Numbers of bits that differ, and that are set.
fn differing(words: &[u32], twin_words: &[u32]) -> (u32, u32) {
    let pairs = words.iter().zip(twin_words);
    let differ = pairs.map(|(word, twin)| (word ^ twin).count_ones()).sum();
    (differ, words.iter().map(|word| word.count_ones()).sum())
}

#[test]
fn moving_cameras_see_what_the_twin_sees() {
    let gpu = open();
    for cameras in [rig(), lens_rig()] {
        let scene = Scene::new(&gpu, &hard_world(3000, 1), &moving(cameras.clone()));
        let (words, _) = visible(&gpu, &scene, &Rules::DEFAULT);
        let (twin_words, _) = scene.culled(&Rules::DEFAULT);
        let (differ, seen) = differing(&words, &twin_words);
        println!("{seen} are seen, {differ} only by one of both");
        assert!(differ * 200 <= seen, "{differ} of {seen} decisions differ");
        // Cameras at rest see others.
        let still = Scene::new(&gpu, &hard_world(3000, 1), &cameras);
        let (still_words, _) = still.culled(&Rules::DEFAULT);
        assert!(differing(&still_words, &twin_words).0 > 10 * differ.max(1));
    }
}

#[test]
fn clusters_are_dropped_only_if_no_splat_is_seen_during_the_readout() {
    let gpu = open();
    let cameras = moving(rig());
    let mut scene = Scene::new(&gpu, &hard_world(3000, 1), &cameras);
    let (with_boxes, _) = scene.culled(&Rules::DEFAULT);
    // Boxes that no camera can miss.
    for cluster in &mut scene.clusters {
        cluster.half_extent_m = [1e9; 3];
    }
    let (without, _) = scene.culled(&Rules::DEFAULT);
    assert_eq!(with_boxes, without);
}

/// Shares of records whose footprints and colors lie within the tolerances.
fn agreeing(
    kernel: &ProjectedTwin,
    twin: &ProjectedTwin,
    mean_shift: impl Fn(usize) -> u32,
) -> [f64; 2] {
    let near = |a: f32, b: f32, tolerance: f32| (a - b).abs() <= tolerance * (1.0 + b.abs());
    let records = twin.labels.len();
    let footprint = |record: &usize| {
        let [kernel, twin] =
            [kernel, twin].map(|side| side.values(*record, mean_shift(*record), [0; 2]));
        (0..7).all(|index| near(kernel[index], twin[index], 1e-3))
    };
    let color = |record: &usize| {
        let [kernel, twin] = [kernel, twin].map(|side| side.color(*record));
        (0..3).all(|channel| near(kernel[channel], twin[channel], 1e-4))
    };
    let share = |count: usize| count as f64 / records as f64;
    [
        share((0..records).filter(footprint).count()),
        share((0..records).filter(color).count()),
    ]
}

#[test]
fn records_of_moving_cameras() {
    let gpu = open();
    for cameras in [rig(), lens_rig()] {
        let cameras = moving(cameras);
        let is_pinhole = |camera: &Camera| camera.intrinsics.is_pinhole();
        let variant = ProjectVariant {
            sh_degree: 2,
            cameras: CameraVariant {
                lenses: !cameras.iter().all(is_pinhole),
                rolling: true,
            },
            ..PLAIN
        };
        let case = Case::seen_by(&gpu, 3000, &cameras, Rules::DEFAULT, variant);
        let (kernel, twin) = (case.kernel(&gpu), case.twin());
        let shares = agreeing(&kernel, &twin, |record| case.mean_shift(record));
        println!("{} records, {shares:?} agree", twin.labels.len());
        assert!(twin.labels.len() > CLUSTER_SPLATS);
        assert!(shares.iter().all(|&share| share > 0.995), "{shares:?}");
        // Keys are those of the time of the pose.
        assert_eq!(kernel.keys, twin.keys);
    }
}
