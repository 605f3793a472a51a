//! Position, width and color of a splat.

use decouplegs_scene::{Camera, Pose, Rules, SplatScene};
use glam::{DQuat, DVec2, DVec3};

use super::{Plain, WHITE, camera, largest_difference, middle, projected, world_of};
use crate::reference::render;

#[test]
fn one_ball_on_the_axis_is_a_gaussian_of_the_projected_width() {
    let splat_scene = SplatScene {
        sky: [0.0, 0.0, 0.25],
        ..world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, 0.8, WHITE)])
    };
    let image = render(&splat_scene, &camera(33), &Rules::DEFAULT);
    // On the axis J is (f / z) I, so the variance is (f s / z)^2 + 0.3.
    let variance_px2 = (100.0 * f64::from(0.08f32) / 4.0).powi(2) + 0.3;
    for y in 0..33u32 {
        for x in 0..33u32 {
            let (dx, dy) = (f64::from(x) - 16.0, f64::from(y) - 16.0);
            let alpha = f64::from(0.8f32) * (-0.5 * (dx * dx + dy * dy) / variance_px2).exp();
            let alpha = if alpha < 1.0 / 255.0 { 0.0 } else { alpha };
            let at = (y * 33 + x) as usize;
            assert!(
                (image.alpha[at] - alpha).abs() < 1e-12,
                "alpha at ({x}, {y})"
            );
            assert!(
                (image.rgb[at][0] - alpha).abs() < 1e-6,
                "white at ({x}, {y})"
            );
            assert!(
                (image.rgb[at][2] - (alpha + 0.25 * (1.0 - alpha))).abs() < 1e-6,
                "sky through ({x}, {y})"
            );
            assert_eq!(image.depth[at], if alpha > 0.0 { 4.0 } else { 0.0 });
        }
    }
}

#[test]
fn the_projected_covariance_is_the_derivative_of_the_projection() {
    // A turned, stretched splat off the axis: S must equal the covariance found by moving the mean
    // along each axis.
    let mut splat_scene = world_of(&[Plain {
        mean: [0.5, -0.3, 5.0],
        scales: [0.3, 0.02, 0.1],
        opacity: 1.0,
        rgb: WHITE,
    }]);
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.8, 1.9);
    splat_scene.splats.rotations[0] = [
        turn.w as f32 * 3.0,
        turn.x as f32 * 3.0,
        turn.y as f32 * 3.0,
        turn.z as f32 * 3.0,
    ];
    let view = camera(64);
    let found = projected(&splat_scene, &view, &Rules::DEFAULT).unwrap();
    let project = |p: DVec3| DVec2::new(100.0 * p.x / p.z + 32.0, 100.0 * p.y / p.z + 32.0);
    let mean = DVec3::from_array(splat_scene.splats.means[0].map(f64::from));
    assert!((found.mean_px - project(mean)).length() < 1e-12);
    let step = 1e-5;
    let (mut xx, mut xy, mut yy) = (0.3, 0.0, 0.3);
    for (axis, scale) in [DVec3::X, DVec3::Y, DVec3::Z]
        .into_iter()
        .zip(splat_scene.splats.scales[0])
    {
        let along = turn * axis * step;
        let column =
            (project(mean + along) - project(mean - along)) / (2.0 * step) * f64::from(scale);
        xx += column.x * column.x;
        xy += column.x * column.y;
        yy += column.y * column.y;
    }
    let det = xx * yy - xy * xy;
    for d in [
        DVec2::new(1.0, 0.0),
        DVec2::new(0.0, 1.0),
        DVec2::new(2.0, -3.0),
        DVec2::new(-1.5, -0.5),
    ] {
        let q = (yy * d.x * d.x - 2.0 * xy * d.x * d.y + xx * d.y * d.y) / det;
        assert!(
            (found.conic.q(d) / q - 1.0).abs() < 1e-6,
            "q at {d}: {} against {q}",
            found.conic.q(d)
        );
    }
}

#[test]
fn antialiasing_keeps_the_light_of_a_splat_far_below_a_pixel() {
    // The integral of alpha over the image is o 2 pi sqrt(det S'); with the factor sqrt(det S / det
    // S') it is o 2 pi sqrt(det S).
    let sum = |scale: f32, antialias: bool| {
        let splat_scene = world_of(&[Plain::ball([0.003, -0.002, 4.0], scale, 0.9, WHITE)]);
        render(
            &splat_scene,
            &camera(33),
            &Rules {
                antialias,
                ..Rules::DEFAULT
            },
        )
        .alpha
        .iter()
        .sum::<f64>()
    };
    let area = |scale: f32| {
        f64::from(0.9f32) * std::f64::consts::TAU * (100.0 * f64::from(scale) / 4.0).powi(2)
    };
    // Tolerance: what lies below 1/255 of alpha is cut away, (1/255) / peak of the whole, 2.7 % for
    // the small splat.
    assert!((sum(0.012, true) / area(0.012) - 1.0).abs() < 0.05);
    assert!((sum(0.08, true) / area(0.08) - 1.0).abs() < 0.01);
    assert!(
        sum(0.012, false) > 3.0 * area(0.012),
        "without it the dilated splat is far too bright"
    );
}

#[test]
fn a_splat_is_dropped_just_before_the_near_plane_and_not_on_it() {
    let visible = |z: f32, rules: &Rules| {
        projected(
            &world_of(&[Plain::ball([0.0, 0.0, z], 0.001, 0.9, WHITE)]),
            &camera(9),
            rules,
        )
        .is_some()
    };
    let near = Rules {
        near_m: 0.25,
        ..Rules::DEFAULT
    };
    assert!(visible(0.25, &near) && !visible(0.25f32.next_down(), &near));
    assert!(!visible(-3.0, &near), "behind the camera");
    assert!(!visible(0.15, &Rules::INRIA) && visible(0.15, &Rules::DEFAULT));
    assert!(
        !visible(
            0.0,
            &Rules {
                near_m: 0.0,
                ..Rules::DEFAULT
            }
        ),
        "no division by zero where the near plane is at the eye"
    );
}

#[test]
fn the_jacobian_is_clamped_a_margin_beyond_the_true_image_edges() {
    // Principal point off the middle: the edges lie at tangents -0.2 and 0.6, the margin is 0.3 *
    // 0.4.
    let mut view = camera(80);
    view.intrinsics.cx_px = 20.0;
    let width_at = |tangent: f32| {
        let splat_scene = world_of(&[Plain {
            mean: [tangent * 2.0, 0.0, 2.0],
            scales: [0.0, 0.0, 0.5],
            opacity: 1.0,
            rgb: WHITE,
        }]);
        // A splat with extent along z only: its variance along x is (f s tangent / z)^2 + 0.3 with
        // the clamped tangent.
        let xx = projected(&splat_scene, &view, &Rules::DEFAULT)
            .unwrap()
            .conic
            .inverse_xx
            .recip();
        (xx - 0.3).sqrt() * 2.0 / (100.0 * 0.5)
    };
    for (tangent, clamped) in [
        (0.5, 0.5),
        (0.7, 0.7),
        (0.72, 0.72),
        (0.9, 0.72),
        (50.0, 0.72),
        (-0.3, 0.3),
        (-0.4, 0.32),
        (-9.0, 0.32),
    ] {
        assert!(
            (width_at(tangent) - clamped).abs() < 1e-6,
            "at {tangent}: {}",
            width_at(tangent)
        );
    }
}

#[test]
fn color_depends_on_the_direction_from_the_eye_to_the_splat() {
    let mut splat_scene = world_of(&[Plain::ball([0.0, 0.0, 0.0], 0.3, 0.9, [0.5; 3])]);
    splat_scene.splats.set_degree(1);
    // Coefficient 3 goes with -x.
    splat_scene.splats.sh_rest[2] = [0.5; 3];
    let seen_from = |eye: DVec3| {
        let view = Camera {
            world_from_camera: Pose::look_at(eye, DVec3::ZERO, DVec3::Z).unwrap(),
            ..camera(9)
        };
        let image = render(&splat_scene, &view, &Rules::DEFAULT);
        image.rgb[middle(&image)][0] / image.alpha[middle(&image)]
    };
    let band_1 = 0.488_602_511_902_919_9;
    assert!(
        (seen_from(DVec3::new(-4.0, 0.0, 0.0)) - (0.5 - 0.5 * band_1)).abs() < 1e-6,
        "looking along +x"
    );
    assert!(
        (seen_from(DVec3::new(4.0, 0.0, 0.0)) - (0.5 + 0.5 * band_1)).abs() < 1e-6,
        "looking along -x"
    );
}

#[test]
fn a_world_at_utm_coordinates_gives_the_same_image() {
    let plain: Vec<Plain> = (0..60u8)
        .map(|i| {
            let a = f32::from(i);
            Plain {
                mean: [a.sin() * 0.8, (a * 1.7).cos() * 0.8, 4.0 + a * 0.05],
                scales: [0.1, 0.05 + 0.002 * a, 0.02],
                opacity: 0.1 + 0.014 * a,
                rgb: [a / 60.0, 0.5, 1.0 - a / 60.0],
            }
        })
        .collect();
    let here = world_of(&plain);
    let offset = DVec3::new(4.5e6, -6.1e5, 120.0);
    let there = SplatScene {
        origin: offset,
        ..here.clone()
    };
    for step in 0..5 {
        // A millimeter a step, chosen as a power of two so that f64 holds it exactly at both
        // positions.
        let eye = DVec3::new(f64::from(step) / 1024.0, 0.0, 0.0);
        let at = |translation| Camera {
            world_from_camera: Pose {
                translation,
                ..Pose::IDENTITY
            },
            ..camera(48)
        };
        let (a, b) = (
            render(&here, &at(eye), &Rules::DEFAULT),
            render(&there, &at(eye + offset), &Rules::DEFAULT),
        );
        assert_eq!(a, b);
        let moved = render(&here, &at(eye + DVec3::X / 1024.0), &Rules::DEFAULT);
        assert!(
            largest_difference(&a, &moved) > 1e-4,
            "a millimeter is seen"
        );
    }
}

#[test]
fn a_needle_of_one_to_a_hundred_thousand_keeps_its_width() {
    // 100 m long and 1 mm thick at 10 m, turned by 30 degrees in the image: across it the variance
    // is the dilation alone.
    let mut splat_scene = world_of(&[Plain {
        mean: [0.0, 0.0, 10.0],
        scales: [100.0, 1e-3, 1e-3],
        opacity: 1.0,
        rgb: WHITE,
    }]);
    let half_rad = std::f32::consts::PI / 12.0;
    splat_scene.splats.rotations[0] = [half_rad.cos(), 0.0, 0.0, half_rad.sin()];
    let found = projected(&splat_scene, &camera(65), &Rules::DEFAULT).unwrap();
    let turn = DQuat::from_xyzw(
        0.0,
        0.0,
        f64::from(half_rad.sin()),
        f64::from(half_rad.cos()),
    )
    .normalize();
    let (along, across) = ((turn * DVec3::X).truncate(), (turn * DVec3::Y).truncate());
    let (variance_along, variance_across) = (
        1000.0f64.powi(2) + 0.3,
        (100.0 * f64::from(1e-3f32) / 10.0).powi(2) + 0.3,
    );
    assert!((found.conic.q(along * 700.0) * variance_along / 490_000.0 - 1.0).abs() < 1e-9);
    assert!((found.conic.q(across * 2.0) * variance_across / 4.0 - 1.0).abs() < 1e-9);
    assert!(
        (found.conic.q(across + along * 700.0)
            - (1.0 / variance_across + 490_000.0 / variance_along))
            .abs()
            < 1e-8
    );
}
