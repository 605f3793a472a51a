//! Optimizations of the reference change nothing, and neither do splats that cannot be rendered.

use decouplegs_scene::{Rules, SplatCloud};
use glam::DVec2;

use super::{Plain, RED, WHITE, camera, middle, world_of};
use crate::reference::project::{Projected64, View};
use crate::reference::{Window, render, render_window};

#[test]
fn what_the_boxes_pass_over_adds_nothing() {
    // The same alphas without any box: every splat asked at every pixel by the definition.
    let plain: Vec<Plain> = (0..200u16)
        .map(|i| {
            let a = f32::from(i);
            Plain {
                mean: [
                    (a * 0.37).sin() * 0.8,
                    (a * 0.91).cos() * 0.8,
                    4.0 + (a * 0.13).sin() * 3.9,
                ],
                scales: [
                    0.12 * (a * 0.7).sin().abs(),
                    0.002,
                    0.01 * (a * 0.3).cos().abs(),
                ],
                opacity: (a * 0.77).sin().abs(),
                rgb: [1.0, a / 200.0, 0.0],
            }
        })
        .collect();
    let splat_scene = world_of(&plain);
    let view = camera(37);
    let image = render(&splat_scene, &view, &Rules::DEFAULT);
    let lens = View::new(splat_scene.origin, &view, &Rules::DEFAULT);
    let mut splats: Vec<Projected64> = (0..splat_scene.splats.len())
        .filter_map(|index| lens.project(&splat_scene.splats, index))
        .collect();
    splats.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
    for (at, &alpha) in image.alpha.iter().enumerate() {
        let center_px = DVec2::new((at % 37) as f64 + 0.5, (at / 37) as f64 + 0.5);
        let mut left = 1.0;
        for splat in &splats {
            let a =
                (splat.opacity * (-0.5 * splat.conic.q(center_px - splat.mean_px)).exp()).min(0.99);
            if a >= 1.0 / 255.0 {
                left *= 1.0 - a;
            }
        }
        assert_eq!(alpha, 1.0 - left, "at pixel {at}");
    }
    let pixels_with =
        |test: fn(f64) -> bool| image.alpha.iter().filter(|&&alpha| test(alpha)).count();
    let (empty, dense) = (
        pixels_with(|alpha| alpha == 0.0),
        pixels_with(|alpha| alpha > 0.7),
    );
    assert!(
        empty > 50 && dense > 50,
        "the scene must have both: {empty} empty, {dense} dense of {}",
        image.alpha.len()
    );
}

#[test]
fn a_window_is_a_part_of_the_whole_bit_for_bit() {
    let plain: Vec<Plain> = (0..40u8)
        .map(|i| {
            Plain::ball(
                [
                    f32::from(i).sin(),
                    f32::from(i).cos(),
                    2.0 + f32::from(i) * 0.1,
                ],
                0.2,
                0.4,
                RED,
            )
        })
        .collect();
    let splat_scene = world_of(&plain);
    let view = camera(50);
    let whole = render(&splat_scene, &view, &Rules::DEFAULT);
    let part = render_window(
        &splat_scene,
        &view,
        &Rules::DEFAULT,
        Window {
            left_px: 11,
            top_px: 23,
            width_px: 17,
            height_px: 19,
        },
    );
    assert_eq!((part.width, part.height, part.rgb.len()), (17, 19, 17 * 19));
    for y in 0..19usize {
        for x in 0..17usize {
            let (here, there) = (y * 17 + x, (y + 23) * 50 + x + 11);
            assert_eq!(
                (part.rgb[here], part.depth[here]),
                (whole.rgb[there], whole.depth[there])
            );
        }
    }
}

#[test]
fn splats_that_cannot_be_drawn_change_nothing() {
    let good = || Plain::ball([0.0, 0.0, 4.0], 0.2, 0.5, RED);
    let expected = render(&world_of(&[good()]), &camera(9), &Rules::DEFAULT);
    let hostile: [fn(&mut SplatCloud); 7] = [
        |c| c.means[1][0] = f32::NAN,
        |c| c.means[1][2] = f32::INFINITY,
        |c| c.scales[1][1] = -1.0,
        |c| c.scales[1][1] = f32::NAN,
        |c| c.rotations[1] = [0.0; 4],
        |c| c.opacities[1] = f32::NAN,
        |c| c.sh_dc[1][2] = f32::NEG_INFINITY,
    ];
    for change in hostile {
        let mut splat_scene = world_of(&[good(), good()]);
        change(&mut splat_scene.splats);
        assert_eq!(render(&splat_scene, &camera(9), &Rules::DEFAULT), expected);
    }
}

#[test]
fn extreme_parameters_leave_finite_pixels() {
    let tiny = f32::from_bits(1);
    let plain = [
        Plain::ball([0.0, 0.0, 4.0], 0.0, 0.5, WHITE),
        Plain::ball([0.0, 0.0, 4.0], tiny, 0.5, WHITE),
        Plain::ball([0.1, 0.0, 0.02], f32::MAX, 1.0, WHITE),
        Plain::ball([f32::MAX, f32::MAX, f32::MAX], f32::MAX, 1.0, WHITE),
        Plain {
            mean: [1e6, 0.0, 0.011],
            scales: [1e-3, 1e5, 1e-3],
            opacity: 1.0,
            rgb: RED,
        },
    ];
    for antialias in [false, true] {
        let image = render(
            &world_of(&plain),
            &camera(17),
            &Rules {
                antialias,
                ..Rules::DEFAULT
            },
        );
        assert!(
            image
                .rgb
                .iter()
                .flatten()
                .chain(&image.alpha)
                .chain(&image.depth)
                .all(|value| value.is_finite())
        );
        assert!(
            image.alpha[middle(&image)] > 0.9,
            "the one that covers the image is seen"
        );
    }
}
