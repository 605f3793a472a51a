//! The error of whole scenes, real ones among them: five scenes, three cameras each, exact mode.
//!
//! `cargo test --test main frames::scenes -- --nocapture` prints the figures that the README
//! quotes.

use decouplegs::asset::{open_scene, read_splats};
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, Rules, SplatCloud, SplatScene};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::DVec3;

use super::assert_exact;
use crate::data;

const SIZE: (u32, u32) = (240, 160);

/// Three cameras around an object whose up is along `up`, near enough to fill the image.
pub fn around(cloud: &SplatCloud, up: DVec3) -> Vec<Camera> {
    // Captures have floaters far out: the middle and the size are taken over the inner 90 %.
    let inner = |axis: usize| {
        let mut values: Vec<f32> = cloud.means.iter().map(|mean| mean[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        (
            f64::from(values[values.len() / 20]),
            f64::from(values[values.len() - 1 - values.len() / 20]),
        )
    };
    let [x, y, z] = [inner(0), inner(1), inner(2)];
    let center = 0.5 * DVec3::new(x.0 + x.1, y.0 + y.1, z.0 + z.1);
    let radius = 0.5 * DVec3::new(x.1 - x.0, y.1 - y.0, z.1 - z.0).length();
    let side = up.any_orthonormal_vector();
    [0.4f64, 2.3, 4.6]
        .into_iter()
        .enumerate()
        .map(|(i, angle)| {
            let out = side * angle.cos() + up.cross(side) * angle.sin() + 0.4 * up;
            Camera {
                name: format!("view {i}"),
                intrinsics: Intrinsics::from_horizontal_fov(SIZE.0, SIZE.1, 0.9),
                world_from_camera: Pose::look_at(
                    center + out.normalize() * 1.8 * radius,
                    center,
                    up,
                )
                .unwrap(),
                motion: Motion::REST,
            }
        })
        .collect()
}

fn real_file(test: &str, name: &str) {
    let Some(path) = data::file(test, name) else {
        return;
    };
    let cloud = read_splats(&path).unwrap();
    println!(
        "{name}: {} splats of degree {}",
        cloud.len(),
        cloud.sh_degree
    );
    let cameras = around(&cloud, -DVec3::Y);
    let mut world = SplatScene::from_splats(cloud);
    world.sky = [0.7, 0.8, 0.9];
    assert_exact(&world, &cameras, Rules::DEFAULT);
}

#[test]
fn captured_keys_of_degree_3() {
    real_file("captured_keys_of_degree_3", "splats/hfk_keys.ply");
}

#[test]
fn captured_keys_as_splat() {
    real_file("captured_keys_as_splat", "splats/hfk_keys.splat");
}

#[test]
fn captured_guitar() {
    real_file("captured_guitar", "splats/guitar.compressed.ply");
}

/// A street with its agents, seen by three cameras of its rig, made small.
fn street(options: &StreetOptions) {
    let street = Street::generate(options);
    let mut world = SplatScene {
        sky: street.sky,
        ..SplatScene::from_splats(street.background.clone())
    };
    for agent in &street.agents {
        world
            .bake_agent(&street.assets[agent.asset], agent)
            .unwrap();
    }
    let cameras: Vec<Camera> = street
        .rig
        .at(&street.ego[0].1)
        .into_iter()
        .take(3)
        .map(|camera| Camera {
            intrinsics: camera.intrinsics.resized(SIZE.0, 135),
            ..camera
        })
        .collect();
    assert_exact(&world, &cameras, Rules::DEFAULT);
}

#[test]
fn street_of_degree_3() {
    street(&StreetOptions {
        background: 60_000,
        agents: 4,
        agent_splats: 3000,
        sh_degree: 3,
        ..StreetOptions::default()
    });
}

#[test]
fn dense_street_of_degree_0() {
    street(&StreetOptions {
        background: 200_000,
        agents: 12,
        agent_splats: 5000,
        sh_degree: 0,
        seed: 2,
        ..StreetOptions::default()
    });
}

#[test]
fn a_scene_opened_in_spatial_order_is_the_same_scene() {
    let Some(path) = data::file(
        "a_scene_opened_in_spatial_order_is_the_same_scene",
        "splats/hfk_keys.ply",
    ) else {
        return;
    };
    let plain = read_splats(&path).unwrap();
    let opened = open_scene(&path, 0.0).unwrap().splat_scene;
    assert_eq!(opened.splats.len(), plain.len());
    let mut a: Vec<_> = plain.means.iter().map(|m| m.map(f32::to_bits)).collect();
    let mut b: Vec<_> = opened
        .splats
        .means
        .iter()
        .map(|m| m.map(f32::to_bits))
        .collect();
    a.sort_unstable();
    b.sort_unstable();
    assert_eq!(a, b);
}
