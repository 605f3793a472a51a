//! Alpha compositing of the splats of a pixel.

use decouplegs_scene::rules::ALPHA_MIN;
use decouplegs_scene::{DepthOrder, Rules, SplatScene};
use glam::DVec2;

use super::{BLUE, Plain, RED, WHITE, camera, middle, projected, world_of};
use crate::reference::blend::alpha_at;
use crate::reference::render;

#[test]
fn the_nearer_of_two_covers_the_farther_whatever_their_order_in_the_file() {
    let near = || Plain::ball([0.0, 0.0, 2.0], 0.5, 0.6, RED);
    let far = || Plain::ball([0.0, 0.0, 3.0], 0.5, 0.5, BLUE);
    let a = render(&world_of(&[near(), far()]), &camera(9), &Rules::DEFAULT);
    let b = render(&world_of(&[far(), near()]), &camera(9), &Rules::DEFAULT);
    assert_eq!(a, b);
    let at = middle(&a);
    let (first, second) = (f64::from(0.6f32), (1.0 - f64::from(0.6f32)) * 0.5);
    assert!((a.rgb[at][0] - first).abs() < 1e-6 && (a.rgb[at][2] - second).abs() < 1e-6);
    assert!((a.depth[at] - (2.0 * first + 3.0 * second) / (first + second)).abs() < 1e-12);
}

#[test]
fn a_world_with_nothing_in_it_is_sky() {
    let splat_scene = SplatScene {
        sky: [0.1, 0.2, 1.5],
        ..SplatScene::default()
    };
    let image = render(&splat_scene, &camera(3), &Rules::DEFAULT);
    assert!(
        image
            .rgb
            .iter()
            .all(|rgb| *rgb == [0.1f32, 0.2, 1.5].map(f64::from))
    );
    assert!(
        image
            .alpha
            .iter()
            .chain(&image.depth)
            .all(|&value| value == 0.0)
    );
}

#[test]
fn a_splat_counts_from_one_255th_on() {
    // The f32 nearest to 1/255 lies above it, the one before below.
    let nearest = 1.0f32 / 255.0;
    assert!(f64::from(nearest) > 1.0 / 255.0);
    let alpha = |opacity: f32| {
        let image = render(
            &world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, opacity, WHITE)]),
            &camera(9),
            &Rules::DEFAULT,
        );
        image.alpha[middle(&image)]
    };
    assert!((alpha(nearest.next_up()) - f64::from(nearest.next_up())).abs() < 1e-15);
    assert!((alpha(nearest) - f64::from(nearest)).abs() < 1e-15);
    assert_eq!(alpha(nearest.next_down()), 0.0);
    assert_eq!(alpha(0.0), 0.0);
}

#[test]
fn alpha_has_the_bound_that_the_rules_say() {
    let alpha = |rules: &Rules| {
        let image = render(
            &world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, 1.0, WHITE)]),
            &camera(9),
            rules,
        );
        image.alpha[middle(&image)]
    };
    assert!((alpha(&Rules::DEFAULT) - 0.99).abs() < 1e-15);
    assert!((alpha(&Rules::GSPLAT15) - 0.999).abs() < 1e-15);
    assert!((alpha(&Rules::INRIA) - 0.99).abs() < 1e-15);
}

#[test]
fn the_exclusive_stop_leaves_out_the_splat_that_would_fill_the_pixel() {
    // Three splats of alpha 0.98: T would go 2e-2, 4e-4, 8e-6; the last is below 1e-4.
    let layers: Vec<Plain> = (0..3)
        .map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, 0.98, WHITE))
        .collect();
    let left = |rules: &Rules| {
        let image = render(&world_of(&layers), &camera(9), rules);
        1.0 - image.alpha[middle(&image)]
    };
    let through = 1.0 - f64::from(0.98f32);
    assert!((left(&Rules::DEFAULT) - through.powi(3)).abs() < 1e-15);
    assert!((left(&Rules::INRIA) - through.powi(2)).abs() < 1e-15);
}

#[test]
fn the_inclusive_stop_ends_with_the_splat_that_fills_the_pixel() {
    // Three splats of alpha 0.98: T would go 2e-2, 4e-4, 8e-6; the second is below 1e-3.
    let layers: Vec<Plain> = (0..3)
        .map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, 0.98, WHITE))
        .collect();
    let left = |count: usize, rules: &Rules| {
        let image = render(&world_of(&layers[..count]), &camera(9), rules);
        1.0 - image.alpha[middle(&image)]
    };
    let through = 1.0 - f64::from(0.98f32);
    assert!((left(3, &Rules::NUREC) - through.powi(2)).abs() < 1e-15);
    assert!((left(1, &Rules::NUREC) - through).abs() < 1e-15);
    // Alpha 0.9 thrice would end at 1e-3 itself, and a little less does not.
    let layers: Vec<Plain> = (0..5)
        .map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, 0.899, WHITE))
        .collect();
    let image = render(&world_of(&layers), &camera(9), &Rules::NUREC);
    let through = 1.0 - f64::from(0.899f32);
    assert!((1.0 - image.alpha[middle(&image)] - through.powi(4)).abs() < 1e-15);
}

#[test]
fn a_splat_adds_nothing_where_its_response_is_too_small() {
    // On the row of its mean the exponent of a ball falls with the square of the distance.
    let alphas = |opacity: f32, rules: &Rules| {
        let ball = Plain::ball([0.0, 0.0, 4.0], 0.4, opacity, WHITE);
        let view = projected(&world_of(&[ball]), &camera(81), rules).unwrap();
        let center = |column: u32| view.mean_px + DVec2::new(f64::from(column), 0.0);
        let response = |column: u32| (-0.5 * view.conic.q(center(column) - view.mean_px)).exp();
        let own: Vec<(f64, Option<f64>)> = (0..40)
            .map(|column| (response(column), alpha_at(&view, center(column), rules)))
            .collect();
        own
    };
    for opacity in [0.9, 0.5, 0.2] {
        let own = alphas(opacity, &Rules::NUREC);
        for (response, alpha) in &own {
            let counts = *response >= 0.0113 && f64::from(opacity) * response >= ALPHA_MIN;
            assert_eq!(alpha.is_some(), counts, "{opacity}, {response}");
        }
        let all = alphas(opacity, &Rules::DEFAULT);
        let count = |own: &[(f64, Option<f64>)]| own.iter().filter(|(_, a)| a.is_some()).count();
        // Of an opacity of 0.2 no response from 0.0196 on is left out.
        assert_eq!(count(&own) < count(&all), opacity > 0.4, "{opacity}");
    }
}

#[test]
fn equal_depths_are_blended_in_the_order_of_their_indices() {
    let ball = |rgb| Plain::ball([0.0, 0.0, 4.0], 0.2, 0.9, rgb);
    let many = |first: [f32; 3], second: [f32; 3]| {
        world_of(
            &(0..64)
                .map(|i| ball(if i == 0 { first } else { second }))
                .collect::<Vec<_>>(),
        )
    };
    let red_first = render(&many(RED, BLUE), &camera(9), &Rules::DEFAULT);
    let at = middle(&red_first);
    assert!((red_first.rgb[at][0] - f64::from(0.9f32)).abs() < 1e-6);
    let blue_first = render(&many(BLUE, RED), &camera(9), &Rules::DEFAULT);
    assert!((blue_first.rgb[at][2] - f64::from(0.9f32)).abs() < 1e-6);
}

#[test]
fn radial_order_can_turn_two_splats_around() {
    // Red is nearer by z (3 against 3.2) and farther by distance (3.98 against 3.2).
    let splat_scene = world_of(&[
        Plain {
            mean: [2.6, 0.0, 3.0],
            scales: [3.0, 3.0, 0.0],
            opacity: 0.9,
            rgb: RED,
        },
        Plain {
            mean: [0.0, 0.0, 3.2],
            scales: [3.0, 3.0, 0.0],
            opacity: 0.9,
            rgb: BLUE,
        },
    ]);
    let z = render(&splat_scene, &camera(9), &Rules::DEFAULT);
    let radial = render(
        &splat_scene,
        &camera(9),
        &Rules {
            order: DepthOrder::Radial,
            ..Rules::DEFAULT
        },
    );
    let at = middle(&z);
    assert!(z.rgb[at][0] > 0.55 && z.rgb[at][2] < 0.5, "{:?}", z.rgb[at]);
    assert!(radial.rgb[at][2] > 0.85, "{:?}", radial.rgb[at]);
    assert!(
        z.depth[at] > 3.0 && z.depth[at] < 3.2,
        "a mean of 3 and 3.2"
    );
    assert!(
        radial.depth[at] > 3.2 && radial.depth[at] < 3.3,
        "a mean of 3.2 and 3.97 that the nearer dominates"
    );
}

#[test]
fn a_stack_of_a_hundred_thousand_layers_has_its_closed_form() {
    const LAYERS: i32 = 100_000;
    let opacity = 0.004f32;
    let layers: Vec<Plain> = (0..LAYERS)
        .map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32 * 1e-4], 1e-7, opacity, [0.75; 3]))
        .collect();
    let splat_scene = SplatScene {
        sky: [1.0; 3],
        ..world_of(&layers)
    };
    let image = render(&splat_scene, &camera(1), &Rules::DEFAULT);
    let left = (1.0 - f64::from(opacity)).powi(LAYERS);
    assert!(left < 1e-170 && left > 0.0);
    assert!((image.alpha[0] - (1.0 - left)).abs() < 1e-11);
    assert!(
        (image.rgb[0][0] - (0.75 * (1.0 - left) + left)).abs() < 1e-6,
        "color is stored as f32"
    );
    // Sum over i of (2 + i h) a (1 - a)^i is 2 + h (1 - a) / a.
    let depth_m = 2.0 + 1e-4 * (1.0 - f64::from(opacity)) / f64::from(opacity);
    assert!(
        (image.depth[0] - depth_m).abs() < 1e-6,
        "{} against {depth_m}: means are stored as f32",
        image.depth[0]
    );
}

#[test]
fn the_instance_is_the_one_of_the_largest_weight_and_the_nearer_of_equals() {
    let instance = |opacities: [f32; 3]| {
        let plain: Vec<Plain> = (0..3)
            .map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, opacities[i], WHITE))
            .collect();
        let splat_scene = SplatScene {
            instance_from_splat: vec![3, 0, 7],
            ..world_of(&plain)
        };
        let image = render(&splat_scene, &camera(3), &Rules::DEFAULT);
        image.instance[middle(&image)]
    };
    assert_eq!(instance([0.9, 0.9, 0.9]), 3);
    assert_eq!(instance([0.1, 0.9, 0.9]), 0);
    assert_eq!(instance([0.1, 0.1, 0.9]), 7);
    assert_eq!(instance([0.5, 0.0, 1.0 / 255.0]), 3);
    assert_eq!(instance([0.0, 0.0, 0.0]), 0);
}

#[test]
fn equal_weights_belong_to_the_nearer() {
    // Weights 0.5 and (1 - 0.5) * 1 bounded to 0.5 by the rules, exactly equal.
    let plain = [
        Plain::ball([0.0, 0.0, 2.0], 0.5, 0.5, WHITE),
        Plain::ball([0.0, 0.0, 3.0], 0.5, 1.0, WHITE),
    ];
    let splat_scene = SplatScene {
        instance_from_splat: vec![1, 2],
        ..world_of(&plain)
    };
    let rules = Rules {
        alpha_max: 1.0,
        ..Rules::DEFAULT
    };
    let image = render(&splat_scene, &camera(3), &rules);
    assert_eq!(image.instance[middle(&image)], 1);
    assert_eq!(image.alpha[middle(&image)], 1.0);
}
