//! Differences between the rules of public renderers, by closed forms.

use decouplegs::scene::Rules;

use super::{Easel, Splat, WHITE, middle_of, sheet, square_camera, world_of};

#[test]
fn the_bound_of_alpha_is_that_of_the_rules() {
    for (rules, bound) in [
        (Rules::DEFAULT, 0.99),
        (Rules::GSPLAT15, 0.999),
        (Rules::GSPLAT16, 0.99),
        (Rules::INRIA, 0.99),
        (Rules::NUREC, 0.99),
    ] {
        let (_, alpha) = middle_of(&[sheet(2.0, 1.0, WHITE)], rules);
        assert!((alpha - bound).abs() < 1e-6, "{alpha}, not {bound}");
    }
}

#[test]
fn the_exclusive_stop_leaves_out_the_splat_that_would_fill_the_pixel() {
    // Alpha 0.98 thrice: what is left goes 2e-2, 4e-4, 8e-6. The third takes it below 1e-4.
    let layers: Vec<Splat> = (0..3u8)
        .map(|i| sheet(2.0 + f32::from(i), 0.98, WHITE))
        .collect();
    for (rules, left) in [
        (Rules::DEFAULT, 8e-6),
        (Rules::GSPLAT15, 4e-4),
        (Rules::GSPLAT16, 4e-4),
        (Rules::INRIA, 4e-4),
    ] {
        let ([red, ..], alpha) = middle_of(&layers, rules);
        assert!(
            (1.0 - alpha - left).abs() < 2e-6 && (1.0 - red - left).abs() < 2e-6,
            "{} is left, not {left}",
            1.0 - alpha
        );
    }
}

#[test]
fn the_inclusive_stop_ends_with_the_splat_that_fills_the_pixel() {
    // What is left goes 2e-2, 4e-4, 8e-6. The second takes it below 1e-3.
    let layers: Vec<Splat> = (0..40u8)
        .map(|i| sheet(2.0 + f32::from(i), 0.98, WHITE))
        .collect();
    for (count, left) in [(1, 2e-2), (2, 4e-4), (3, 4e-4), (40, 4e-4)] {
        let ([red, ..], alpha) = middle_of(&layers[..count], Rules::NUREC);
        assert!(
            (1.0 - alpha - left).abs() < 2e-6 && (1.0 - red - left).abs() < 2e-6,
            "{} is left of {count}, not {left}",
            1.0 - alpha
        );
    }
}

#[test]
fn a_splat_ends_where_its_response_is_least() {
    // A ball of 20 px standard deviation; its response is 0.0113 at 2.995 of them.
    let reach_px = |opacity: f32, rules: Rules| {
        let ball = Splat {
            scale_m: [0.8; 3],
            opacity,
            ..Splat::at(0.0, 0.0, 4.0)
        };
        let image = Easel::new(rules).draw(&world_of(&[ball]), &square_camera(201));
        let row = &image.alpha[100 * 201 + 100..101 * 201];
        row.iter().filter(|&&alpha| alpha > 0.0).count()
    };
    let radius = |response: f64| (20.0f64.powi(2) + 0.3).sqrt() * (-2.0 * response.ln()).sqrt();
    for (opacity, rules, least) in [
        (1.0, Rules::NUREC, 0.0113),
        (0.5, Rules::NUREC, 0.0113),
        (0.2, Rules::NUREC, 5.0 / 255.0),
        (1.0, Rules::DEFAULT, 1.0 / 255.0),
    ] {
        assert_eq!(reach_px(opacity, rules), radius(least).floor() as usize + 1);
    }
}

#[test]
fn nothing_behind_the_splat_that_stops_a_pixel_is_blended_either() {
    // The third layer stops the pixel; the fourth is faint enough to have been let through on its
    // own.
    let mut layers: Vec<Splat> = (0..3u8)
        .map(|i| sheet(2.0 + f32::from(i), 0.98, WHITE))
        .collect();
    layers.push(sheet(9.0, 0.5, WHITE));
    let without = middle_of(&layers[..2], Rules::GSPLAT15);
    assert_eq!(middle_of(&layers, Rules::GSPLAT15), without);
    layers.remove(2);
    let (_, alpha) = middle_of(&layers, Rules::GSPLAT15);
    assert!(
        (1.0 - alpha - 2e-4).abs() < 2e-6,
        "alone it is let through: {}",
        1.0 - alpha
    );
}

#[test]
fn the_near_plane_is_that_of_the_rules() {
    let at = |z_m: f32, rules: Rules| {
        middle_of(
            &[Splat {
                scale_m: [0.01; 3],
                ..Splat::at(0.0, 0.0, z_m)
            }],
            rules,
        )
        .1 > 0.5
    };
    assert!(
        at(0.15, Rules::DEFAULT)
            && at(0.15, Rules::GSPLAT15)
            && at(0.15, Rules::GSPLAT16)
            && !at(0.15, Rules::INRIA)
            && !at(0.15, Rules::NUREC)
    );
    assert!(at(0.201, Rules::INRIA) && !at(0.199, Rules::INRIA));
    assert!(at(0.0101, Rules::DEFAULT) && !at(0.0099, Rules::DEFAULT));
}

#[test]
fn faint_splats_count_from_one_255th_on() {
    let threshold = 1.0f32 / 255.0;
    let alpha = |opacity: f32| middle_of(&[sheet(2.0, opacity, WHITE)], Rules::DEFAULT).1;
    assert!((alpha(threshold * 1.001) - threshold).abs() < 1e-5);
    assert_eq!(alpha(threshold * 0.999), 0.0);
}
