//! Equal bits from equal inputs on one device.

use decouplegs::render::{RenderOptions, Renderer};
use decouplegs::scene::Rules;
use glam::DVec3;

use super::{Splat, all_outputs, camera_at, world_of};
use crate::device::Validated;

/// Many splats at few depths: any order that is not settled by index would show.
fn ties(count: usize) -> Vec<Splat> {
    (0..count)
        .map(|i| {
            let share = (i as f32 * 0.618).fract();
            Splat {
                opacity: 0.2 + 0.6 * share,
                rgb: [share, 1.0 - share, 0.5],
                ..Splat::at(
                    share * 3.0 - 1.5,
                    (i % 37) as f32 * 0.05 - 0.9,
                    3.0 + (i % 5) as f32,
                )
            }
        })
        .collect()
}

#[test]
fn a_hundred_runs_of_one_frame_give_one_image() {
    let gpu = Validated::open();
    for rules in [Rules::DEFAULT, Rules::GSPLAT16] {
        runs_give_one_image(&gpu, rules);
    }
}

fn runs_give_one_image(gpu: &Validated, rules: Rules) {
    let options = RenderOptions {
        rules,
        outputs: all_outputs(),
        segment_pairs: 256,
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(gpu, options);
    let world = renderer.upload(&world_of(&ties(3000))).unwrap();
    let cameras = [
        camera_at(DVec3::ZERO, 96, 64),
        camera_at(DVec3::new(0.3, 0.0, -0.5), 70, 40),
    ];
    renderer.render(&world, &cameras).unwrap();
    let first = renderer.read_images().unwrap();
    for run in 1..100 {
        renderer.render(&world, &cameras).unwrap();
        assert!(
            renderer.read_images().unwrap() == first,
            "run {run} differs"
        );
    }
    // What is compared does change with the world.
    let other = renderer.upload(&world_of(&ties(3000)[1..])).unwrap();
    renderer.render(&other, &cameras).unwrap();
    assert!(renderer.read_images().unwrap() != first);
}

#[test]
fn a_camera_sees_the_same_alone_and_in_a_rig() {
    let gpu = Validated::open();
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let world = renderer.upload(&world_of(&ties(3000))).unwrap();
    let cameras: Vec<_> = (0..6)
        .map(|i| camera_at(DVec3::new(0.2 * f64::from(i), 0.0, -0.3), 90 + i, 50))
        .collect();
    renderer.render(&world, &cameras).unwrap();
    let rig = renderer.read_images().unwrap();
    for (camera, image) in cameras.iter().zip(&rig) {
        renderer
            .render(&world, std::slice::from_ref(camera))
            .unwrap();
        assert!(renderer.read_images().unwrap()[0] == *image);
    }
}
