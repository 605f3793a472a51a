//! Rules nurec: a least response, and a stop behind the splat that fills a pixel.

use decouplegs::render::{RenderOptions, Renderer};
use decouplegs::scene::rules::ALPHA_MIN;
use decouplegs::scene::{Camera, Rules, SplatScene};
use glam::DVec3;

use super::hard_cases::crowd;
use super::{Splat, all_outputs, assert_exact, camera_at, differences, draw, world_of};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

fn camera() -> Camera {
    camera_at(DVec3::ZERO, 200, 120)
}

/// Opaque layers and a crowd: pixels end early, and edges of splats are seen.
fn world() -> SplatScene {
    let mut splats = crowd(600);
    splats.extend((0..30).map(|i| Splat {
        scale_m: [0.9, 0.4, 0.02],
        rotation: [1.0, 0.1 * i as f32, 0.3, -0.2],
        opacity: 0.7,
        rgb: [0.9, 0.03 * i as f32, 0.2],
        ..Splat::at(0.2 * i as f32 - 3.0, 0.5, 3.0 + 0.05 * i as f32)
    }));
    world_of(&splats)
}

#[test]
fn pinholes_and_lenses_see_the_definition() {
    assert_exact(&world(), &[camera()], Rules::NUREC);
    assert_exact(&world(), &lens_rig(), Rules::NUREC);
    let antialias = Rules {
        antialias: true,
        ..Rules::NUREC
    };
    assert_exact(&world(), &[camera()], antialias);
}

#[test]
fn needles_huge_splats_and_splats_below_a_pixel_are_the_definitions() {
    let needles = crowd(400).into_iter().map(|splat| Splat {
        scale_m: [splat.scale_m[0] + 0.5, 1e-5, 1e-5],
        ..splat
    });
    let points = crowd(1000).into_iter().map(|splat| Splat {
        scale_m: [1e-5; 3],
        ..splat
    });
    let huge = (0..20).map(|i| Splat {
        scale_m: [10f32.powi(i % 4); 3],
        opacity: 0.1 + 0.04 * i as f32,
        ..Splat::at(0.1 * i as f32, 0.0, 5.0 + i as f32)
    });
    for splats in [
        needles.collect::<Vec<_>>(),
        points.collect(),
        huge.collect(),
    ] {
        assert_exact(&world_of(&splats), &[camera()], Rules::NUREC);
    }
}

/// Images of other rules than were asked for differ, by each of the two alone.
#[test]
fn other_rules_are_another_image() {
    let gpu = Validated::open();
    let (world, cameras) = (world(), [camera()]);
    let own = &draw(&gpu, &world, &cameras, Rules::NUREC)[0];
    for other in [
        Rules {
            response_min: 0.0,
            ..Rules::NUREC
        },
        Rules {
            stop: Rules::DEFAULT.stop,
            ..Rules::NUREC
        },
    ] {
        assert!(draw(&gpu, &world, &cameras, other)[0] != *own, "{other:?}");
        let difference = &differences(&gpu, &world, &cameras, other)[0];
        assert!(difference.psnr_db > 95.0, "{other:?}: {difference:?}");
    }
}

/// No splat of opacity 1 or less has a response below 1/255 where its alpha counts.
#[test]
fn a_least_response_that_no_splat_falls_below_changes_no_byte() {
    let gpu = Validated::open();
    let world = world();
    let cameras: Vec<Camera> = [camera()]
        .into_iter()
        .chain(lens_rig().into_iter().take(2))
        .collect();
    for base in [Rules::DEFAULT, Rules::GSPLAT15, Rules::INRIA] {
        let drawn = |response_min: f64, segment_pairs: u32| {
            let options = RenderOptions {
                rules: Rules {
                    response_min,
                    ..base
                },
                segment_pairs,
                outputs: all_outputs(),
                ..RenderOptions::default()
            };
            let mut renderer = Renderer::new(&gpu, options);
            let resident = renderer.upload(&world).unwrap();
            renderer.render(&resident, &cameras).unwrap();
            renderer.read_images().unwrap()
        };
        for segment_pairs in [64, 1024] {
            let without = drawn(0.0, segment_pairs);
            assert!(
                drawn(0.99 * ALPHA_MIN, segment_pairs) == without,
                "{base:?}"
            );
            assert!(drawn(0.0113, segment_pairs) != without, "{base:?}");
        }
    }
}

#[test]
fn pairs_of_lists_are_fewer() {
    let gpu = Validated::open();
    let pairs = |rules: Rules| {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                rules,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world()).unwrap();
        let required = renderer.render(&resident, &[camera()]).unwrap().required;
        (required.pairs_high << 16) + required.pairs_low
    };
    let (all, fewer) = (pairs(Rules::DEFAULT), pairs(Rules::NUREC));
    println!("{all} pairs, {fewer} with a least response");
    assert!(fewer < all, "{fewer} of {all}");
}
