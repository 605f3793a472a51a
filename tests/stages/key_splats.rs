//! `key_splats.comp`: depth keys of a whole background.

use decouplegs::render::stages::{KeySplats, WantedKeys};
use decouplegs::render::twins;

use super::scenes::{Scene, hard_world, rig};
use super::{UNTOUCHED, open, run, untouched};

#[test]
fn keys_of_all_splats_go_to_their_set() {
    let gpu = open();
    let scene = Scene::new(&gpu, &hard_world(1000, 31), &rig());
    let splats = scene.means_m.len();
    let keys = untouched(&gpu, 3 * splats);
    let key_splats = KeySplats::new(&gpu).unwrap();
    run(&gpu, |r| {
        key_splats.record(
            r,
            &scene.resident,
            &scene.camera_buffer,
            WantedKeys { camera: 1, set: 2 },
            &keys,
        );
    });
    let kernel = gpu.read(&keys).unwrap();
    assert!(
        kernel[..2 * splats].iter().all(|&key| key == UNTOUCHED),
        "other sets are left alone"
    );
    let apart = |camera: usize| {
        let mut twin = vec![UNTOUCHED; 3 * splats];
        twins::key_splats(&scene.view.cameras, &scene.means_m, &mut twin, camera, 2);
        kernel
            .iter()
            .zip(&twin)
            .map(|(a, b)| a.abs_diff(*b))
            .max()
            .unwrap()
    };
    // A depth on the edge of a step may fall to either side.
    assert!(apart(1) <= 1);
    assert!(apart(0) > 1, "another camera's keys are seen");
}
