//! What must be true of the definition itself, against closed forms worked out by hand.

use decouplegs_scene::{Camera, DepthOrder, Intrinsics, Pose, Rules, SplatCloud, World, sh};
use glam::{DQuat, DVec2, DVec3};

use super::project::{Projected64, View};
use super::{Picture64, Window, render, render_window};

/// A splat of one colour; `rgb` is what it shows.
struct Plain {
    mean: [f32; 3],
    scales: [f32; 3],
    opacity: f32,
    rgb: [f32; 3],
}

impl Plain {
    fn ball(mean: [f32; 3], scale: f32, opacity: f32, rgb: [f32; 3]) -> Self {
        Self { mean, scales: [scale; 3], opacity, rgb }
    }
}

fn world_of(plain: &[Plain]) -> World {
    World::of(SplatCloud {
        means: plain.iter().map(|splat| splat.mean).collect(),
        scales: plain.iter().map(|splat| splat.scales).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; plain.len()],
        opacities: plain.iter().map(|splat| splat.opacity).collect(),
        sh_degree: 0,
        sh_dc: plain.iter().map(|splat| splat.rgb.map(|value| ((f64::from(value) - 0.5) / sh::Y0) as f32)).collect(),
        sh_rest: vec![],
    })
}

/// At the world's zero, looking along +z with x right and y down; an odd size puts a pixel's centre on the axis.
fn camera(size_px: u32) -> Camera {
    let focal_px = 100.0;
    let centre_px = 0.5 * f64::from(size_px);
    Camera {
        name: "front".into(),
        intrinsics: Intrinsics {
            width_px: size_px,
            height_px: size_px,
            fx_px: focal_px,
            fy_px: focal_px,
            cx_px: centre_px,
            cy_px: centre_px,
        },
        world_from_camera: Pose::IDENTITY,
    }
}

fn middle(picture: &Picture64) -> usize {
    (picture.width * picture.height / 2) as usize
}

fn projected(world: &World, camera: &Camera, rules: &Rules) -> Option<Projected64> {
    View::new(world.origin, camera, rules).project(&world.splats, 0)
}

fn largest_difference(a: &Picture64, b: &Picture64) -> f64 {
    let channels = |picture: &Picture64| picture.rgb.iter().flatten().copied().collect::<Vec<_>>();
    channels(a).iter().zip(channels(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

const WHITE: [f32; 3] = [1.0; 3];
const RED: [f32; 3] = [1.0, 0.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];

#[test]
fn one_ball_on_the_axis_is_a_gaussian_of_the_projected_width() {
    let world = World { sky: [0.0, 0.0, 0.25], ..world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, 0.8, WHITE)]) };
    let picture = render(&world, &camera(33), &Rules::DEFAULT);
    // On the axis J is (f / z) I, so the variance is (f s / z)^2 + 0.3.
    let variance_px2 = (100.0 * f64::from(0.08f32) / 4.0).powi(2) + 0.3;
    for y in 0..33u32 {
        for x in 0..33u32 {
            let (dx, dy) = (f64::from(x) - 16.0, f64::from(y) - 16.0);
            let alpha = f64::from(0.8f32) * (-0.5 * (dx * dx + dy * dy) / variance_px2).exp();
            let alpha = if alpha < 1.0 / 255.0 { 0.0 } else { alpha };
            let at = (y * 33 + x) as usize;
            assert!((picture.alpha[at] - alpha).abs() < 1e-12, "alpha at ({x}, {y})");
            assert!((picture.rgb[at][0] - alpha).abs() < 1e-6, "white at ({x}, {y})");
            assert!((picture.rgb[at][2] - (alpha + 0.25 * (1.0 - alpha))).abs() < 1e-6, "sky through ({x}, {y})");
            assert_eq!(picture.depth[at], if alpha > 0.0 { 4.0 } else { 0.0 });
        }
    }
}

#[test]
fn the_projected_covariance_is_the_derivative_of_the_projection() {
    // A turned, stretched splat off the axis: S must equal the covariance found by moving the mean along each axis.
    let mut world = world_of(&[Plain { mean: [0.5, -0.3, 5.0], scales: [0.3, 0.02, 0.1], opacity: 1.0, rgb: WHITE }]);
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.8, 1.9);
    world.splats.rotations[0] = [turn.w as f32 * 3.0, turn.x as f32 * 3.0, turn.y as f32 * 3.0, turn.z as f32 * 3.0];
    let view = camera(64);
    let found = projected(&world, &view, &Rules::DEFAULT).unwrap();
    let project = |p: DVec3| DVec2::new(100.0 * p.x / p.z + 32.0, 100.0 * p.y / p.z + 32.0);
    let mean = DVec3::from_array(world.splats.means[0].map(f64::from));
    assert!((found.mean_px - project(mean)).length() < 1e-12);
    let step = 1e-5;
    let (mut xx, mut xy, mut yy) = (0.3, 0.0, 0.3);
    for (axis, scale) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().zip(world.splats.scales[0]) {
        let along = turn * axis * step;
        let column = (project(mean + along) - project(mean - along)) / (2.0 * step) * f64::from(scale);
        xx += column.x * column.x;
        xy += column.x * column.y;
        yy += column.y * column.y;
    }
    let det = xx * yy - xy * xy;
    for d in [DVec2::new(1.0, 0.0), DVec2::new(0.0, 1.0), DVec2::new(2.0, -3.0), DVec2::new(-1.5, -0.5)] {
        let q = (yy * d.x * d.x - 2.0 * xy * d.x * d.y + xx * d.y * d.y) / det;
        assert!((found.conic.q(d) / q - 1.0).abs() < 1e-6, "q at {d}: {} against {q}", found.conic.q(d));
    }
}

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
    let world = World { sky: [0.1, 0.2, 1.5], ..World::default() };
    let picture = render(&world, &camera(3), &Rules::DEFAULT);
    assert!(picture.rgb.iter().all(|rgb| *rgb == [0.1f32, 0.2, 1.5].map(f64::from)));
    assert!(picture.alpha.iter().chain(&picture.depth).all(|&value| value == 0.0));
}

#[test]
fn antialiasing_keeps_the_light_of_a_splat_far_below_a_pixel() {
    // The integral of alpha over the image is o 2 pi sqrt(det S'); with the factor sqrt(det S / det S') it is o 2 pi sqrt(det S).
    let sum = |scale: f32, antialias: bool| {
        let world = world_of(&[Plain::ball([0.003, -0.002, 4.0], scale, 0.9, WHITE)]);
        render(&world, &camera(33), &Rules { antialias, ..Rules::DEFAULT }).alpha.iter().sum::<f64>()
    };
    let area = |scale: f32| f64::from(0.9f32) * std::f64::consts::TAU * (100.0 * f64::from(scale) / 4.0).powi(2);
    // Tolerance: what lies below 1/255 of alpha is cut away, (1/255) / peak of the whole, 2.7 % for the small splat.
    assert!((sum(0.012, true) / area(0.012) - 1.0).abs() < 0.05);
    assert!((sum(0.08, true) / area(0.08) - 1.0).abs() < 0.01);
    assert!(sum(0.012, false) > 3.0 * area(0.012), "without it the dilated splat is far too bright");
}

#[test]
fn a_splat_is_dropped_just_before_the_near_plane_and_not_on_it() {
    let visible = |z: f32, rules: &Rules| {
        projected(&world_of(&[Plain::ball([0.0, 0.0, z], 0.001, 0.9, WHITE)]), &camera(9), rules).is_some()
    };
    let near = Rules { near_m: 0.25, ..Rules::DEFAULT };
    assert!(visible(0.25, &near) && !visible(0.25f32.next_down(), &near));
    assert!(!visible(-3.0, &near), "behind the camera");
    assert!(!visible(0.15, &Rules::INRIA) && visible(0.15, &Rules::DEFAULT));
    assert!(!visible(0.0, &Rules { near_m: 0.0, ..Rules::DEFAULT }), "no division by zero where the near plane is at the eye");
}

#[test]
fn the_jacobian_is_clamped_a_margin_beyond_the_true_image_edges() {
    // Principal point off the middle: the edges lie at tangents -0.2 and 0.6, the margin is 0.3 * 0.4.
    let mut view = camera(80);
    view.intrinsics.cx_px = 20.0;
    let width_at = |tangent: f32| {
        let world = world_of(&[Plain { mean: [tangent * 2.0, 0.0, 2.0], scales: [0.0, 0.0, 0.5], opacity: 1.0, rgb: WHITE }]);
        // A splat with extent along z only: its variance along x is (f s tangent / z)^2 + 0.3 with the clamped tangent.
        let xx = projected(&world, &view, &Rules::DEFAULT).unwrap().conic.inverse_xx.recip();
        (xx - 0.3).sqrt() * 2.0 / (100.0 * 0.5)
    };
    for (tangent, clamped) in
        [(0.5, 0.5), (0.7, 0.7), (0.72, 0.72), (0.9, 0.72), (50.0, 0.72), (-0.3, 0.3), (-0.4, 0.32), (-9.0, 0.32)]
    {
        assert!((width_at(tangent) - clamped).abs() < 1e-6, "at {tangent}: {}", width_at(tangent));
    }
}

#[test]
fn a_splat_counts_from_one_255th_on() {
    // The f32 nearest to 1/255 lies above it, the one before below.
    let nearest = 1.0f32 / 255.0;
    assert!(f64::from(nearest) > 1.0 / 255.0);
    let alpha = |opacity: f32| {
        let picture = render(&world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, opacity, WHITE)]), &camera(9), &Rules::DEFAULT);
        picture.alpha[middle(&picture)]
    };
    assert!((alpha(nearest.next_up()) - f64::from(nearest.next_up())).abs() < 1e-15);
    assert!((alpha(nearest) - f64::from(nearest)).abs() < 1e-15);
    assert_eq!(alpha(nearest.next_down()), 0.0);
    assert_eq!(alpha(0.0), 0.0);
}

#[test]
fn alpha_has_the_bound_that_the_rules_say() {
    let alpha = |rules: &Rules| {
        let picture = render(&world_of(&[Plain::ball([0.0, 0.0, 4.0], 0.08, 1.0, WHITE)]), &camera(9), rules);
        picture.alpha[middle(&picture)]
    };
    assert!((alpha(&Rules::DEFAULT) - 0.99).abs() < 1e-15);
    assert!((alpha(&Rules::GSPLAT15) - 0.999).abs() < 1e-15);
    assert!((alpha(&Rules::INRIA) - 0.99).abs() < 1e-15);
}

#[test]
fn the_exclusive_stop_leaves_out_the_splat_that_would_fill_the_pixel() {
    // Three splats of alpha 0.98: T would go 2e-2, 4e-4, 8e-6; the last is below 1e-4.
    let layers: Vec<Plain> = (0..3).map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, 0.98, WHITE)).collect();
    let left = |rules: &Rules| {
        let picture = render(&world_of(&layers), &camera(9), rules);
        1.0 - picture.alpha[middle(&picture)]
    };
    let through = 1.0 - f64::from(0.98f32);
    assert!((left(&Rules::DEFAULT) - through.powi(3)).abs() < 1e-15);
    assert!((left(&Rules::INRIA) - through.powi(2)).abs() < 1e-15);
}

#[test]
fn equal_depths_are_blended_in_the_order_of_their_indices() {
    let ball = |rgb| Plain::ball([0.0, 0.0, 4.0], 0.2, 0.9, rgb);
    let many = |first: [f32; 3], second: [f32; 3]| {
        world_of(&(0..64).map(|i| ball(if i == 0 { first } else { second })).collect::<Vec<_>>())
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
    let world = world_of(&[
        Plain { mean: [2.6, 0.0, 3.0], scales: [3.0, 3.0, 0.0], opacity: 0.9, rgb: RED },
        Plain { mean: [0.0, 0.0, 3.2], scales: [3.0, 3.0, 0.0], opacity: 0.9, rgb: BLUE },
    ]);
    let z = render(&world, &camera(9), &Rules::DEFAULT);
    let radial = render(&world, &camera(9), &Rules { order: DepthOrder::Radial, ..Rules::DEFAULT });
    let at = middle(&z);
    assert!(z.rgb[at][0] > 0.55 && z.rgb[at][2] < 0.5, "{:?}", z.rgb[at]);
    assert!(radial.rgb[at][2] > 0.85, "{:?}", radial.rgb[at]);
    assert!(z.depth[at] > 3.0 && z.depth[at] < 3.2, "a mean of 3 and 3.2");
    assert!(radial.depth[at] > 3.2 && radial.depth[at] < 3.3, "a mean of 3.2 and 3.97 that the nearer dominates");
}

#[test]
fn colour_depends_on_the_direction_from_the_eye_to_the_splat() {
    let mut world = world_of(&[Plain::ball([0.0, 0.0, 0.0], 0.3, 0.9, [0.5; 3])]);
    world.splats.set_degree(1);
    // Coefficient 3 goes with -x.
    world.splats.sh_rest[2] = [0.5; 3];
    let seen_from = |eye: DVec3| {
        let view = Camera { world_from_camera: Pose::look_at(eye, DVec3::ZERO, DVec3::Z).unwrap(), ..camera(9) };
        let picture = render(&world, &view, &Rules::DEFAULT);
        picture.rgb[middle(&picture)][0] / picture.alpha[middle(&picture)]
    };
    let band_1 = 0.488_602_511_902_919_9;
    assert!((seen_from(DVec3::new(-4.0, 0.0, 0.0)) - (0.5 - 0.5 * band_1)).abs() < 1e-6, "looking along +x");
    assert!((seen_from(DVec3::new(4.0, 0.0, 0.0)) - (0.5 + 0.5 * band_1)).abs() < 1e-6, "looking along -x");
}

#[test]
fn a_world_at_utm_coordinates_gives_the_same_picture() {
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
    let there = World { origin: offset, ..here.clone() };
    for step in 0..5 {
        // A millimetre a step, chosen as a power of two so that f64 holds it exactly at both places.
        let eye = DVec3::new(f64::from(step) / 1024.0, 0.0, 0.0);
        let at = |translation| Camera { world_from_camera: Pose { translation, ..Pose::IDENTITY }, ..camera(48) };
        let (a, b) = (render(&here, &at(eye), &Rules::DEFAULT), render(&there, &at(eye + offset), &Rules::DEFAULT));
        assert_eq!(a, b);
        let moved = render(&here, &at(eye + DVec3::X / 1024.0), &Rules::DEFAULT);
        assert!(largest_difference(&a, &moved) > 1e-4, "a millimetre is seen");
    }
}

#[test]
fn a_stack_of_a_hundred_thousand_layers_has_its_closed_form() {
    const LAYERS: i32 = 100_000;
    let opacity = 0.004f32;
    let layers: Vec<Plain> =
        (0..LAYERS).map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32 * 1e-4], 1e-7, opacity, [0.75; 3])).collect();
    let world = World { sky: [1.0; 3], ..world_of(&layers) };
    let picture = render(&world, &camera(1), &Rules::DEFAULT);
    let left = (1.0 - f64::from(opacity)).powi(LAYERS);
    assert!(left < 1e-170 && left > 0.0);
    assert!((picture.alpha[0] - (1.0 - left)).abs() < 1e-11);
    assert!((picture.rgb[0][0] - (0.75 * (1.0 - left) + left)).abs() < 1e-6, "colour is stored as f32");
    // Sum over i of (2 + i h) a (1 - a)^i is 2 + h (1 - a) / a.
    let depth_m = 2.0 + 1e-4 * (1.0 - f64::from(opacity)) / f64::from(opacity);
    assert!((picture.depth[0] - depth_m).abs() < 1e-6, "{} against {depth_m}: means are stored as f32", picture.depth[0]);
}

#[test]
fn the_instance_is_the_one_of_the_largest_weight_and_the_nearer_of_equals() {
    let instance = |opacities: [f32; 3]| {
        let plain: Vec<Plain> = (0..3).map(|i| Plain::ball([0.0, 0.0, 2.0 + i as f32], 0.5, opacities[i], WHITE)).collect();
        let world = World { instance_from_splat: vec![3, 0, 7], ..world_of(&plain) };
        let picture = render(&world, &camera(3), &Rules::DEFAULT);
        picture.instance[middle(&picture)]
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
    let plain = [Plain::ball([0.0, 0.0, 2.0], 0.5, 0.5, WHITE), Plain::ball([0.0, 0.0, 3.0], 0.5, 1.0, WHITE)];
    let world = World { instance_from_splat: vec![1, 2], ..world_of(&plain) };
    let rules = Rules { alpha_max: 1.0, ..Rules::DEFAULT };
    let picture = render(&world, &camera(3), &rules);
    assert_eq!(picture.instance[middle(&picture)], 1);
    assert_eq!(picture.alpha[middle(&picture)], 1.0);
}

#[test]
fn a_needle_of_one_to_a_hundred_thousand_keeps_its_width() {
    // 100 m long and 1 mm thick at 10 m, turned by 30 degrees in the image: across it the variance is the dilation alone.
    let mut world = world_of(&[Plain { mean: [0.0, 0.0, 10.0], scales: [100.0, 1e-3, 1e-3], opacity: 1.0, rgb: WHITE }]);
    let half_rad = std::f32::consts::PI / 12.0;
    world.splats.rotations[0] = [half_rad.cos(), 0.0, 0.0, half_rad.sin()];
    let found = projected(&world, &camera(65), &Rules::DEFAULT).unwrap();
    let turn = DQuat::from_xyzw(0.0, 0.0, f64::from(half_rad.sin()), f64::from(half_rad.cos())).normalize();
    let (along, across) = ((turn * DVec3::X).truncate(), (turn * DVec3::Y).truncate());
    let (variance_along, variance_across) = (1000.0f64.powi(2) + 0.3, (100.0 * f64::from(1e-3f32) / 10.0).powi(2) + 0.3);
    assert!((found.conic.q(along * 700.0) * variance_along / 490_000.0 - 1.0).abs() < 1e-9);
    assert!((found.conic.q(across * 2.0) * variance_across / 4.0 - 1.0).abs() < 1e-9);
    assert!((found.conic.q(across + along * 700.0) - (1.0 / variance_across + 490_000.0 / variance_along)).abs() < 1e-8);
}

#[test]
fn what_the_boxes_pass_over_adds_nothing() {
    // The same alphas without any box: every splat asked at every pixel by the definition.
    let plain: Vec<Plain> = (0..200u16)
        .map(|i| {
            let a = f32::from(i);
            Plain {
                mean: [(a * 0.37).sin() * 0.8, (a * 0.91).cos() * 0.8, 4.0 + (a * 0.13).sin() * 3.9],
                scales: [0.12 * (a * 0.7).sin().abs(), 0.002, 0.01 * (a * 0.3).cos().abs()],
                opacity: (a * 0.77).sin().abs(),
                rgb: [1.0, a / 200.0, 0.0],
            }
        })
        .collect();
    let world = world_of(&plain);
    let view = camera(37);
    let picture = render(&world, &view, &Rules::DEFAULT);
    let lens = View::new(world.origin, &view, &Rules::DEFAULT);
    let mut splats: Vec<Projected64> = (0..world.splats.len()).filter_map(|index| lens.project(&world.splats, index)).collect();
    splats.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
    for (at, &alpha) in picture.alpha.iter().enumerate() {
        let centre_px = DVec2::new((at % 37) as f64 + 0.5, (at / 37) as f64 + 0.5);
        let mut left = 1.0;
        for splat in &splats {
            let a = (splat.opacity * (-0.5 * splat.conic.q(centre_px - splat.mean_px)).exp()).min(0.99);
            if a >= 1.0 / 255.0 {
                left *= 1.0 - a;
            }
        }
        assert_eq!(alpha, 1.0 - left, "at pixel {at}");
    }
    let pixels_with = |test: fn(f64) -> bool| picture.alpha.iter().filter(|&&alpha| test(alpha)).count();
    let (empty, dense) = (pixels_with(|alpha| alpha == 0.0), pixels_with(|alpha| alpha > 0.7));
    assert!(empty > 50 && dense > 50, "the scene must have both: {empty} empty, {dense} dense of {}", picture.alpha.len());
}

#[test]
fn a_window_is_a_part_of_the_whole_bit_for_bit() {
    let plain: Vec<Plain> = (0..40u8)
        .map(|i| Plain::ball([f32::from(i).sin(), f32::from(i).cos(), 2.0 + f32::from(i) * 0.1], 0.2, 0.4, RED))
        .collect();
    let world = world_of(&plain);
    let view = camera(50);
    let whole = render(&world, &view, &Rules::DEFAULT);
    let part = render_window(&world, &view, &Rules::DEFAULT, Window { left_px: 11, top_px: 23, width_px: 17, height_px: 19 });
    assert_eq!((part.width, part.height, part.rgb.len()), (17, 19, 17 * 19));
    for y in 0..19usize {
        for x in 0..17usize {
            let (here, there) = (y * 17 + x, (y + 23) * 50 + x + 11);
            assert_eq!((part.rgb[here], part.depth[here]), (whole.rgb[there], whole.depth[there]));
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
        let mut world = world_of(&[good(), good()]);
        change(&mut world.splats);
        assert_eq!(render(&world, &camera(9), &Rules::DEFAULT), expected);
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
        Plain { mean: [1e6, 0.0, 0.011], scales: [1e-3, 1e5, 1e-3], opacity: 1.0, rgb: RED },
    ];
    for antialias in [false, true] {
        let picture = render(&world_of(&plain), &camera(17), &Rules { antialias, ..Rules::DEFAULT });
        assert!(picture.rgb.iter().flatten().chain(&picture.alpha).chain(&picture.depth).all(|value| value.is_finite()));
        assert!(picture.alpha[middle(&picture)] > 0.9, "the one that covers the image is seen");
    }
}
