//! `cull.comp`: which splats can be seen by which camera.

use decouplegs::render::Storage;
use decouplegs::render::layout::CLUSTER_SPLATS;
use decouplegs::render::stages::{CameraVariant, Cull, Visible};
use decouplegs::render::twins::lens::lens_of;
use decouplegs::scene::{Camera, Rules, SplatScene};

use super::scenes::{Scene, hard_world, lens_rig, rig};
use super::{UNTOUCHED, identical, open, run};
use crate::device::Validated;

/// Visibility bits and counts of the kernel.
pub fn visible(gpu: &Validated, scene: &Scene, rules: &Rules) -> (Vec<u32>, Vec<u32>) {
    let cameras = scene.view.cameras.len();
    let visible = Visible::new(gpu, cameras, scene.clusters.len()).unwrap();
    gpu.write(&visible.words, 0, &vec![UNTOUCHED; visible.words.len()])
        .unwrap();
    gpu.write(&visible.counts, 0, &vec![UNTOUCHED; visible.counts.len()])
        .unwrap();
    let cull = Cull::new(
        gpu,
        rules,
        CameraVariant::for_cameras(&scene.view.cameras, &scene.view.lenses),
        scene.resident.storage,
        0.0,
    )
    .unwrap();
    run(gpu, |r| {
        cull.record(r, &scene.resident, scene.views(), &visible);
    });
    (
        gpu.read(&visible.words).unwrap(),
        gpu.read(&visible.counts).unwrap(),
    )
}

/// Holds the kernel's bits to the twin's wherever these survive rounding; returns how many do not.
fn check(scene: &Scene, rules: &Rules, words: &[u32], twin_words: &[u32]) -> Result<usize, String> {
    let splats = scene.means_m.len();
    let mut unsettled = 0;
    for camera in 0..scene.view.cameras.len() {
        for splat in 0..scene.clusters.len() * CLUSTER_SPLATS {
            let bit = camera * scene.clusters.len() * CLUSTER_SPLATS + splat;
            let [kernel, twin] =
                [words, twin_words].map(|words| words[bit / 32] >> (bit % 32) & 1 == 1);
            let settled = if splat < splats {
                scene.settled_visibility(camera, splat, rules)
            } else {
                Some(false)
            };
            unsettled += usize::from(settled.is_none());
            if kernel != twin && settled.is_some() {
                return Err(format!(
                    "camera {camera}, splat {splat}: the kernel says {kernel}, the twin {twin}"
                ));
            }
        }
    }
    Ok(unsettled)
}

fn compare(gpu: &Validated, world: &SplatScene, cameras: &[Camera], rules: Rules) {
    compare_stored(gpu, world, cameras, rules, Storage::Exact);
}

fn compare_stored(
    gpu: &Validated,
    world: &SplatScene,
    cameras: &[Camera],
    rules: Rules,
    storage: Storage,
) {
    let scene = Scene::stored(gpu, world, cameras, storage);
    let (words, counts) = visible(gpu, &scene, &rules);
    let (twin_words, _) = scene.culled(&rules);
    let unsettled = check(&scene, &rules, &words, &twin_words).unwrap();
    let decisions = scene.means_m.len() * cameras.len();
    let seen: u32 = counts.iter().sum();
    println!("{seen} of {decisions} are seen, {unsettled} only as f32 rounds");
    // Three in a hundred of the hard splats are made to be at the threshold of opacity.
    assert!(
        unsettled * 20 <= decisions,
        "{unsettled} of {decisions} decisions are left to rounding: the test proves too little"
    );
    let bits: Vec<u32> = words
        .chunks(CLUSTER_SPLATS / 32)
        .map(|cluster| cluster.iter().map(|word| word.count_ones()).sum())
        .collect();
    identical("counts", &counts, &bits).unwrap();
}

#[test]
fn hard_splats_are_seen_by_the_same_cameras() {
    let gpu = open();
    for rules in [
        Rules::DEFAULT,
        Rules::INRIA,
        Rules::NUREC,
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
    ] {
        compare(&gpu, &hard_world(3000, 1), &rig(), rules);
        compare(&gpu, &hard_world(3000, 1), &lens_rig(), rules);
    }
    let (world, storage) = (hard_world(3000, 1), Storage::Compact);
    compare_stored(&gpu, &world, &rig(), Rules::DEFAULT, storage);
}

#[test]
fn clusters_of_every_fill() {
    let gpu = open();
    for count in [1, 31, 32, 33, 255, 256, 257, 512, 1000] {
        compare(
            &gpu,
            &hard_world(count.max(160), count as u64),
            &rig()[..2],
            Rules::DEFAULT,
        );
    }
    let one = SplatScene::from_splats(hard_world(16, 3).splats.select(&[12]));
    compare(&gpu, &one, &rig()[..1], Rules::DEFAULT);
}

#[test]
fn as_many_cameras_as_there_may_be() {
    let gpu = open();
    let cameras: Vec<Camera> = (0..32).map(|i| rig()[i % 4].clone()).collect();
    compare(&gpu, &hard_world(600, 5), &cameras, Rules::DEFAULT);
}

#[test]
fn spatial_clusters_are_dropped_without_loss() {
    drop_clusters_of(&rig());
    drop_clusters_of(&lens_rig());
}

fn drop_clusters_of(rig: &[Camera]) {
    // Small splats in spatial order: many clusters lie outside of a camera's view, so that the test
    // of boxes decides.
    let gpu = open();
    let small: Vec<u32> = (0..16_000).filter(|i| i % 16 >= 6).collect();
    let small = hard_world(16_000, 7).splats.select(&small);
    let ordered = SplatScene::from_splats(small.in_spatial_order());
    let scene = Scene::new(&gpu, &ordered, rig);
    let near_m = decouplegs::render::layout::near_m(&Rules::DEFAULT);
    let overlaps = |camera: usize, cluster: usize| {
        let lens = lens_of(&scene.view.lenses, camera);
        decouplegs::render::twins::cluster_overlaps_any_lens(
            &scene.clusters[cluster],
            &scene.view.cameras[camera],
            lens,
            near_m,
        )
    };
    let dropped = (0..scene.clusters.len())
        .filter(|&cluster| !overlaps(0, cluster))
        .count();
    assert!(dropped > 0, "no cluster is dropped: the test shows nothing");
    for camera in 0..scene.view.cameras.len() {
        for splat in 0..scene.means_m.len() {
            if scene.settled_visibility(camera, splat, &Rules::DEFAULT) == Some(true) {
                assert!(
                    overlaps(camera, splat / CLUSTER_SPLATS),
                    "camera {camera}: the cluster of splat {splat} was dropped"
                );
            }
        }
    }
    compare(&gpu, &ordered, rig, Rules::DEFAULT);
}

#[test]
fn one_bit_is_seen() {
    let gpu = open();
    let scene = Scene::new(&gpu, &hard_world(600, 8), &rig());
    let (words, _) = visible(&gpu, &scene, &Rules::DEFAULT);
    let settled = (0..600)
        .find(|&splat| scene.settled_visibility(0, splat, &Rules::DEFAULT) == Some(true))
        .unwrap();
    let mut twin = words.clone();
    check(&scene, &Rules::DEFAULT, &words, &twin).unwrap();
    twin[settled / 32] ^= 1 << (settled % 32);
    assert!(
        check(&scene, &Rules::DEFAULT, &words, &twin)
            .unwrap_err()
            .contains(&format!("splat {settled}:"))
    );
}
