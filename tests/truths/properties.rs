//! Truths of random worlds.

use decouplegs::scene::{Camera, Pose, Rules, SplatScene};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestCaseError, TestRunner};

use super::{Easel, ROUNDING, Splat, square_camera, world_of, worst_difference};

/// Tolerance of early termination (the transmittance at which a pixel is full), and of rounding.
const FULL: f32 = 1e-4 + ROUNDING;

fn splat() -> impl Strategy<Value = Splat> {
    // In steps of 1/1024 m, so that f32 still holds them exactly when a world is moved by whole
    // meters.
    let steps =
        |first: i16, end: i16| (first * 1024..end * 1024).prop_map(|step| f32::from(step) / 1024.0);
    let mean = (
        steps(-2, 2),
        steps(-2, 2),
        (512i16..8 * 1024).prop_map(|step| f32::from(step) / 1024.0),
    );
    let scale = prop::array::uniform3(-4.0f32..0.5);
    let rotation = prop::array::uniform4(-1.0f32..1.0).prop_filter("a rotation", |q| {
        q.iter().map(|v| v * v).sum::<f32>() > 0.01
    });
    (
        mean,
        scale,
        rotation,
        0.0f32..1.0,
        prop::array::uniform3(0.0f32..1.0),
    )
        .prop_map(|((x, y, z), scale, rotation, opacity, rgb)| Splat {
            scale_m: scale.map(f32::exp),
            rotation,
            opacity,
            rgb,
            ..Splat::at(x, y, z)
        })
}

/// Holds `truth` to 24 random worlds on one device; what fails is made small and printed.
fn for_random_worlds(truth: impl Fn(&mut Easel, &[Splat]) -> Result<(), TestCaseError>) {
    let easel = std::cell::RefCell::new(Easel::new(Rules::DEFAULT));
    let config = Config {
        cases: 24,
        max_shrink_iters: 200,
        failure_persistence: None,
        ..Config::default()
    };
    let worlds = prop::collection::vec(splat(), 1..120);
    let outcome =
        TestRunner::new(config).run(&worlds, |splats| truth(&mut easel.borrow_mut(), &splats));
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

#[test]
fn a_world_of_one_color_under_a_sky_of_that_color_is_that_color() {
    // The weights of all splats and of the sky sum to one at every pixel.
    for_random_worlds(|easel, splats| {
        let rgb = splats[0].rgb;
        let splats: Vec<Splat> = splats.iter().map(|splat| Splat { rgb, ..*splat }).collect();
        let image = easel.draw(
            &SplatScene {
                sky: rgb,
                ..world_of(&splats)
            },
            &square_camera(48),
        );
        for found in &image.rgb {
            let worst = (0..3)
                .map(|channel| (found[channel] - rgb[channel]).abs())
                .fold(0.0, f32::max);
            prop_assert!(worst < ROUNDING, "{found:?}, not {rgb:?}");
        }
        Ok(())
    });
}

#[test]
fn the_sky_shows_with_what_is_left() {
    for_random_worlds(|easel, splats| {
        let sky = [0.25, 1.5, 0.75];
        let dark = easel.draw(&world_of(splats), &square_camera(48));
        let bright = easel.draw(
            &SplatScene {
                sky,
                ..world_of(splats)
            },
            &square_camera(48),
        );
        for ((alpha, dark), bright) in dark.alpha.iter().zip(&dark.rgb).zip(&bright.rgb) {
            for ((dark, bright), sky) in dark.iter().zip(bright).zip(sky) {
                prop_assert!(
                    (bright - (dark + (1.0 - alpha) * sky)).abs() < ROUNDING,
                    "{bright} over {dark}"
                );
            }
        }
        prop_assert!(bright.alpha == dark.alpha);
        Ok(())
    });
}

#[test]
fn one_more_splat_never_lets_more_of_the_sky_through() {
    for_random_worlds(|easel, splats| {
        let all = easel.draw(&world_of(splats), &square_camera(48));
        let fewer = easel.draw(&world_of(&splats[1..]), &square_camera(48));
        for (more, less) in all.alpha.iter().zip(&fewer.alpha) {
            prop_assert!(more + FULL >= *less, "alpha fell from {less} to {more}");
        }
        Ok(())
    });
}

#[test]
fn colors_and_depths_are_means_of_what_is_there() {
    for_random_worlds(|easel, splats| {
        let image = easel.draw(&world_of(splats), &square_camera(48));
        let depths = splats.iter().map(|splat| splat.mean_m[2]);
        let (nearest_m, farthest_m) = depths.fold((f32::MAX, f32::MIN), |(near, far), z| {
            (near.min(z), far.max(z))
        });
        for ((rgb, &alpha), &depth_m) in image
            .rgb
            .iter()
            .zip(&image.alpha)
            .zip(image.depth().into_iter().flatten())
        {
            prop_assert!((0.0..=1.0).contains(&alpha));
            prop_assert!(
                rgb.iter()
                    .all(|&value| value >= 0.0 && value <= alpha + ROUNDING),
                "{rgb:?} of {alpha}"
            );
            let seen = (nearest_m * 0.999..=farthest_m * 1.001).contains(&depth_m);
            prop_assert!(
                if alpha > 0.0 { seen } else { depth_m == 0.0 },
                "{depth_m} m, of {nearest_m} to {farthest_m}"
            );
        }
        Ok(())
    });
}

/// The splats and the camera turned by a quarter about y and moved by whole meters; the means are
/// exact in f32.
fn turned_and_moved(splats: &[Splat]) -> (Vec<Splat>, Camera) {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let moved = |splat: &Splat| {
        let ([x, y, z], [qw, qx, qy, qz]) = (splat.mean_m, splat.rotation);
        // (x, y, z) turns to (z, y, -x); the quaternion is multiplied by (half, 0, half, 0) from
        // the left.
        let rotation = [
            half * (qw - qy),
            half * (qx + qz),
            half * (qy + qw),
            half * (qz - qx),
        ];
        Splat {
            mean_m: [z + 4.0, y - 2.0, 16.0 - x],
            rotation,
            ..*splat
        }
    };
    let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    let world_from_camera = Pose::new(turn, DVec3::new(4.0, -2.0, 16.0));
    (
        splats.iter().map(moved).collect(),
        Camera {
            world_from_camera,
            ..square_camera(48)
        },
    )
}

#[test]
fn moving_the_world_and_the_camera_together_changes_nothing() {
    for_random_worlds(|easel, splats| {
        let here = easel.draw(&world_of(splats), &square_camera(48));
        let (moved, camera) = turned_and_moved(splats);
        let there = easel.draw(&world_of(&moved), &camera);
        // Rotations are rounded otherwise, which may turn a decision at 1/255.
        let off = here
            .rgb
            .iter()
            .zip(&there.rgb)
            .filter(|(a, b)| (0..3).any(|c| (a[c] - b[c]).abs() > 2e-4))
            .count();
        prop_assert!(
            off <= 4 && worst_difference(&here, &there) < 0.02,
            "{off} pixels, {}",
            worst_difference(&here, &there)
        );
        Ok(())
    });
}

#[test]
fn splats_of_one_depth_keep_their_order_when_the_world_and_the_camera_turn() {
    // The quarter turn is rounded: it adds 1e-16 of x to a depth, which must not untie what was
    // equal.
    for first in 0..2 {
        let ball = |i: u16| {
            let rgb = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]][usize::from(i % 2 == first)];
            Splat {
                scale_m: [1.0; 3],
                opacity: 0.5,
                rgb,
                ..Splat::at((f32::from(i) - 20.0) / 1024.0, 0.0, 2.143_554_7)
            }
        };
        let splats: Vec<Splat> = (0..40).map(ball).collect();
        let (moved, camera) = turned_and_moved(&splats);
        let mut easel = Easel::new(Rules::DEFAULT);
        let [here, there] = [(splats, square_camera(48)), (moved, camera)]
            .map(|(splats, camera)| easel.draw(&world_of(&splats), &camera));
        assert!(
            worst_difference(&here, &there) < 1e-3,
            "{}",
            worst_difference(&here, &there)
        );
    }
}

#[test]
fn moving_the_principal_point_by_whole_pixels_moves_the_image() {
    for_random_worlds(|easel, splats| {
        // Balls near the axis: where the Jacobian is clamped depends on the image's edges, and
        // there the truth ends.
        let near_axis = |splat: &Splat| Splat {
            mean_m: [
                0.02 * splat.mean_m[0],
                0.02 * splat.mean_m[1],
                splat.mean_m[2],
            ],
            scale_m: [0.03; 3],
            ..*splat
        };
        let splats: Vec<Splat> = splats.iter().map(near_axis).collect();
        let mut shifted = square_camera(48);
        shifted.intrinsics.cx_px += 5.0;
        shifted.intrinsics.cy_px -= 3.0;
        let (still, moved) = (
            easel.draw(&world_of(&splats), &square_camera(48)),
            easel.draw(&world_of(&splats), &shifted),
        );
        let mut off = 0;
        for y in 3..48usize {
            for x in 0..43usize {
                let (a, b) = (still.rgb[y * 48 + x], moved.rgb[(y - 3) * 48 + x + 5]);
                let difference = (0..3)
                    .map(|channel| (a[channel] - b[channel]).abs())
                    .fold(0.0, f32::max);
                prop_assert!(difference < 0.005, "{difference} at ({x}, {y})");
                off += usize::from(difference > ROUNDING);
            }
        }
        // A decision at 1/255 may turn at a pixel here and there.
        prop_assert!(off <= 4, "{off} pixels");
        Ok(())
    });
}

#[test]
#[should_panic(expected = "Test failed")]
fn a_truth_that_is_false_is_found_out() {
    for_random_worlds(|easel, splats| {
        let image = easel.draw(&world_of(splats), &square_camera(48));
        prop_assert!(image.alpha.iter().all(|&alpha| alpha < 0.05));
        Ok(())
    });
}
