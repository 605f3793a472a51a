//! The hard cases of a static scene, each by name.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{Image, RenderOptions, Renderer, reference};
use decouplegs::scene::rules::ALPHA_MIN;
use decouplegs::scene::{Camera, Intrinsics, Pose, Rules, SplatScene, sh};
use decouplegs_shaders::constants::COLOR_MAX;
use glam::{DQuat, DVec3};

use super::{ERROR_MAX, PSNR_MIN_DB, Splat, assert_exact, camera_at, draw, world_of};
use crate::device::Validated;

const SIZE: (u32, u32) = (200, 120);

fn camera() -> Camera {
    camera_at(DVec3::ZERO, SIZE.0, SIZE.1)
}

/// Numbers in 0 to 1 without a pattern that matters here; the same every run.
fn noise(index: usize, stream: u64) -> f32 {
    let mut x = (index as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ x >> 31) >> 40) as f32 / 16_777_216.0
}

/// Splats of all kinds in front of the camera.
pub fn crowd(count: usize) -> Vec<Splat> {
    (0..count)
        .map(|i| Splat {
            mean_m: [
                (noise(i, 1) - 0.5) * 12.0,
                (noise(i, 2) - 0.5) * 8.0,
                1.0 + 20.0 * noise(i, 3),
            ],
            scale_m: std::array::from_fn(|axis| (noise(i, 4 + axis as u64) * 4.0 - 5.0).exp()),
            rotation: std::array::from_fn(|axis| noise(i, 8 + axis as u64) - 0.5),
            opacity: if noise(i, 12) < 0.45 {
                0.15 * noise(i, 13)
            } else {
                0.5 + 0.5 * noise(i, 13)
            },
            rgb: std::array::from_fn(|axis| noise(i, 14 + axis as u64)),
        })
        .collect()
}

#[test]
fn near_plane_crossing() {
    let mut splats = vec![];
    for (i, z) in [0.2, 0.010_001, 0.01, 0.009_999, 0.005, 0.0, -0.01]
        .into_iter()
        .enumerate()
    {
        splats.push(Splat {
            scale_m: [0.002; 3],
            opacity: 0.5,
            ..Splat::at(0.001 * i as f32, 0.0, z)
        });
        splats.push(Splat {
            scale_m: [0.5, 0.5, 0.5],
            opacity: 0.3,
            ..Splat::at(0.0, 0.1, z)
        });
    }
    splats.extend(crowd(200));
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    assert_exact(&world_of(&splats), &[camera()], Rules::INRIA);
}

#[test]
fn colors_beyond_every_display_are_as_bright_as_a_record_holds() {
    let gpu = Validated::open();
    for brightness in [1e9, 1e10, 1e30] {
        let mut splats = crowd(300);
        for splat in splats.iter_mut().step_by(3) {
            splat.rgb = splat.rgb.map(|value| value * brightness);
        }
        let world = world_of(&splats);
        // In units of the largest color, so that the bounds are those of other images.
        let scaled = |mut image: Image| {
            let peak = brightness.min(COLOR_MAX);
            for rgb in &mut image.rgb {
                *rgb = rgb.map(|value| value / peak);
            }
            image
        };
        let drawn = draw(&gpu, &world, &[camera()], Rules::DEFAULT).remove(0);
        let defined = reference::render(&world, &camera(), &Rules::DEFAULT).to_image();
        let difference = Difference::between(&scaled(drawn), &scaled(defined)).unwrap();
        println!(
            "{brightness:e}: {:.1} dB, max {:.2e} of the largest",
            difference.psnr_db, difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{brightness:e}: {:.2} dB and {:.2e}",
            difference.psnr_db,
            difference.max_abs
        );
    }
}

#[test]
fn behind_the_camera() {
    let mut splats = crowd(300);
    for splat in &mut splats[..150] {
        splat.mean_m[2] = -splat.mean_m[2];
    }
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    // What lies behind adds nothing at all.
    let gpu = Validated::open();
    let ahead = draw(&gpu, &world_of(&splats[150..]), &[camera()], Rules::DEFAULT);
    assert_eq!(
        draw(&gpu, &world_of(&splats), &[camera()], Rules::DEFAULT),
        ahead
    );
}

#[test]
fn far_off_axis() {
    // The Jacobian grows without bound towards 90 degrees; its clamp must be the definition's, at
    // every image edge and with the principal point off center.
    let mut splats = vec![];
    for i in 0..40 {
        let angle = i as f32 * 0.157;
        let (x, y) = (angle.cos(), angle.sin());
        for slope in [0.6, 0.8, 1.0, 3.0, 30.0] {
            splats.push(Splat {
                scale_m: [0.05, 0.3, 0.1],
                opacity: 0.4,
                ..Splat::at(x * slope, y * slope, 1.0)
            });
        }
    }
    let mut shifted = camera();
    shifted.intrinsics.cx_px = 20.0;
    shifted.intrinsics.cy_px = 130.0;
    shifted.name = "principal point at the edge".into();
    let mut wide = camera();
    wide.intrinsics = Intrinsics::from_horizontal_fov(SIZE.0, SIZE.1, 150f64.to_radians());
    wide.name = "150 degrees".into();
    assert_exact(
        &world_of(&splats),
        &[camera(), shifted, wide],
        Rules::DEFAULT,
    );
}

#[test]
fn needles() {
    // 1 : 1e5. Their projected covariance has a determinant that a difference of products would
    // lose.
    let splats: Vec<Splat> = (0..60)
        .map(|i| Splat {
            mean_m: [
                (noise(i, 1) - 0.5) * 4.0,
                (noise(i, 2) - 0.5) * 2.0,
                2.0 + noise(i, 3) * 4.0,
            ],
            scale_m: [1.0 + noise(i, 4), 1e-5, 1e-5],
            rotation: std::array::from_fn(|axis| noise(i, 5 + axis as u64) - 0.5),
            opacity: 0.9,
            rgb: std::array::from_fn(|axis| noise(i, 10 + axis as u64)),
        })
        .collect();
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    assert_exact(
        &world_of(&splats),
        &[camera()],
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
    );
}

#[test]
fn discs() {
    let splats: Vec<Splat> = (0..200)
        .map(|i| Splat {
            scale_m: [0.3 + noise(i, 20), 0.3 + noise(i, 21), 1e-6],
            ..crowd(200)[i]
        })
        .collect();
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
}

#[test]
fn huge_splats_that_cover_the_image() {
    let mut splats: Vec<Splat> = (0..20)
        .map(|i| Splat {
            scale_m: [10f32.powi(i % 4); 3],
            opacity: 0.1 + 0.04 * i as f32,
            ..Splat::at(0.1 * i as f32, 0.0, 5.0 + i as f32)
        })
        .collect();
    // A kilometer across, its center a meter away.
    splats.push(Splat {
        scale_m: [1e3, 1e3, 1e3],
        opacity: 0.2,
        ..Splat::at(0.0, 0.0, 1.0)
    });
    splats.extend(crowd(100));
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
}

#[test]
fn splats_below_a_pixel() {
    let splats: Vec<Splat> = crowd(4000)
        .into_iter()
        .map(|splat| Splat {
            scale_m: [1e-5; 3],
            ..splat
        })
        .collect();
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    assert_exact(
        &world_of(&splats),
        &[camera()],
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
    );
}

#[test]
fn opacities_at_the_threshold() {
    let threshold = ALPHA_MIN as f32;
    let next = |steps: i32| f32::from_bits((threshold.to_bits() as i32 + steps) as u32);
    let opacities = [
        0.0,
        1.0,
        threshold,
        next(1),
        next(-1),
        next(2),
        next(-2),
        f32::from_bits(1),
        0.99,
        0.999,
    ];
    // Centerd on pixel centers, where alpha is the opacity itself.
    let k = camera().intrinsics;
    let splats: Vec<Splat> = opacities
        .iter()
        .enumerate()
        .map(|(i, &opacity)| {
            let x = (10.5 + 18.0 * i as f64 - k.cx_px) / k.fx_px * 4.0;
            let y = (60.5 - k.cy_px) / k.fy_px * 4.0;
            Splat {
                opacity,
                ..Splat::at(x as f32, y as f32, 4.0)
            }
        })
        .collect();
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    // Decided by the opacity itself, to its last digit.
    let gpu = Validated::open();
    let image = &draw(&gpu, &world_of(&splats), &[camera()], Rules::DEFAULT)[0];
    let alpha = |i: usize| image.alpha[60 * SIZE.0 as usize + 10 + 18 * i];
    assert_eq!(alpha(0), 0.0);
    assert!((alpha(1) - 0.99).abs() < 1e-6);
    for drawn in [2, 3, 5] {
        assert!(
            (alpha(drawn) - threshold).abs() < 1e-6,
            "{} is drawn, not {}",
            opacities[drawn],
            alpha(drawn)
        );
    }
    for unseen in [4, 6, 7] {
        assert_eq!(
            alpha(unseen),
            0.0,
            "{} is below the threshold",
            opacities[unseen]
        );
    }
}

#[test]
fn a_stack_of_100_000_layers_on_a_pixel() {
    // Each layer takes 1 part in 254 or so; T = (1 - a)^n must not stall or drift. The sum of all
    // weights is 1 - T.
    let layers = 100_000;
    let splats: Vec<Splat> = (0..layers)
        .map(|i| Splat {
            opacity: 0.004,
            scale_m: [5.0, 5.0, 0.001],
            rgb: [1.0, i as f32 / layers as f32, 0.0],
            ..Splat::at(0.0, 0.0, 10.0 + i as f32 * 1e-4)
        })
        .collect();
    let small = camera_at(DVec3::ZERO, 40, 24);
    let world = world_of(&splats);
    assert_exact(&world, std::slice::from_ref(&small), Rules::DEFAULT);
    let gpu = Validated::open();
    let image = &draw(&gpu, &world, &[small], Rules::DEFAULT)[0];
    let center = 12 * 40 + 20;
    assert!(
        (image.rgb[center][0] - image.alpha[center]).abs() < 1e-4,
        "all layers are 1 in red"
    );
    assert!(image.alpha[center] > 0.999_9);
}

#[test]
fn equal_depths_are_ordered_by_index() {
    // The same place a hundred times, every one another color: only the order decides.
    let splats: Vec<Splat> = (0..100)
        .map(|i| Splat {
            opacity: 0.3,
            rgb: std::array::from_fn(|c| noise(i, c as u64)),
            ..Splat::at(0.0, 0.0, 3.0)
        })
        .collect();
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    let reversed: Vec<Splat> = splats.iter().rev().copied().collect();
    let gpu = Validated::open();
    let (a, b) = (
        draw(&gpu, &world_of(&splats), &[camera()], Rules::DEFAULT),
        draw(&gpu, &world_of(&reversed), &[camera()], Rules::DEFAULT),
    );
    assert_ne!(
        a, b,
        "the order must be seen in the image, or this proves nothing"
    );
}

#[test]
fn defective_splats_change_nothing() {
    let sound = crowd(300);
    let mut mixed = sound.clone();
    let broken: [fn(&mut Splat); 8] = [
        |s| s.mean_m[0] = f32::NAN,
        |s| s.mean_m[2] = f32::INFINITY,
        |s| s.scale_m[1] = f32::NAN,
        |s| s.scale_m[0] = f32::INFINITY,
        |s| s.rotation = [0.0; 4],
        |s| s.rotation[3] = f32::NAN,
        |s| s.opacity = f32::NAN,
        |s| s.rgb[1] = f32::NEG_INFINITY,
    ];
    for (i, breaking) in broken.iter().enumerate() {
        let mut splat = Splat {
            opacity: 1.0,
            ..Splat::at(0.0, 0.0, 2.0)
        };
        breaking(&mut splat);
        mixed.insert(i * 30, splat);
    }
    let gpu = Validated::open();
    assert_eq!(
        draw(&gpu, &world_of(&mixed), &[camera()], Rules::DEFAULT),
        draw(&gpu, &world_of(&sound), &[camera()], Rules::DEFAULT)
    );
}

#[test]
fn zero_and_denormal_scales() {
    let mut splats = crowd(50);
    for (i, scale) in [
        [0.0; 3],
        [0.0, 0.1, 0.0],
        [f32::from_bits(1); 3],
        [0.2, f32::from_bits(77), 0.2],
    ]
    .into_iter()
    .enumerate()
    {
        splats.push(Splat {
            scale_m: scale,
            ..Splat::at(0.3 * i as f32 - 0.4, 0.1, 2.0)
        });
    }
    assert_exact(&world_of(&splats), &[camera()], Rules::DEFAULT);
    assert_exact(
        &world_of(&splats),
        &[camera()],
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
    );
}

#[test]
fn everything_culled_leaves_the_sky() {
    let sky = [0.1, 0.2, 0.3];
    let world = SplatScene {
        sky,
        ..world_of(&[
            Splat::at(0.0, 0.0, -5.0),
            Splat {
                opacity: 0.001,
                ..Splat::at(0.0, 0.0, 5.0)
            },
        ])
    };
    let gpu = Validated::open();
    let image = &draw(&gpu, &world, &[camera()], Rules::DEFAULT)[0];
    assert!(
        image.rgb.iter().all(|rgb| *rgb == sky) && image.alpha.iter().all(|&alpha| alpha == 0.0)
    );
    assert!(image.depth().unwrap().iter().all(|&depth| depth == 0.0));
}

#[test]
fn a_world_of_no_splats() {
    let world = SplatScene {
        sky: [0.5; 3],
        ..SplatScene::default()
    };
    let gpu = Validated::open();
    assert!(
        draw(&gpu, &world, &[camera()], Rules::DEFAULT)[0]
            .rgb
            .iter()
            .all(|rgb| *rgb == [0.5; 3])
    );
}

#[test]
fn one_splat() {
    assert_exact(
        &world_of(&[Splat::at(0.1, -0.2, 3.0)]),
        &[camera()],
        Rules::DEFAULT,
    );
}

#[test]
fn sh_extremes() {
    // Coefficients of +-10: colors far above 1 are kept, those below 0 are cut before blending.
    let splats = crowd(300);
    let mut world = world_of(&splats);
    let cloud = &mut world.splats;
    cloud.sh_degree = 3;
    cloud.sh_rest = (0..splats.len() * (sh::coefficient_count(3) - 1))
        .map(|i| std::array::from_fn(|c| 20.0 * noise(i, 30 + c as u64) - 10.0))
        .collect();
    let gpu = Validated::open();
    let image = &draw(&gpu, &world, &[camera()], Rules::DEFAULT)[0];
    let truth = reference::render(&world, &camera(), &Rules::DEFAULT).to_image();
    let brightest = truth.rgb.iter().flatten().fold(0.0f32, |m, &c| m.max(c));
    assert!(brightest > 5.0, "the case must be extreme: {brightest}");
    // Colors reach some tens, so the bound is relative to the brightest: 16 bits of the largest
    // coefficient.
    let worst = image
        .rgb
        .iter()
        .flatten()
        .zip(truth.rgb.iter().flatten())
        .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst <= 1e-3 * brightest, "{worst} of {brightest}");
    assert!(image.rgb.iter().flatten().all(|&c| c >= 0.0));
}

#[test]
fn utm_coordinates_with_millimeter_motion() {
    // The same street corner at the origin and 4.5e6 m away: the origin is taken out in f64.
    let splats = crowd(400);
    let near = world_of(&splats);
    let origin = DVec3::new(4.5e6, 5.4e6, 320.0);
    let far = SplatScene {
        origin,
        ..near.clone()
    };
    let gpu = Validated::open();
    for step in 0..4 {
        let moved = DVec3::new(0.001 * f64::from(step), 0.0, 0.0005 * f64::from(step));
        let a = draw(
            &gpu,
            &near,
            &[camera_at(moved, SIZE.0, SIZE.1)],
            Rules::DEFAULT,
        );
        let b = draw(
            &gpu,
            &far,
            &[camera_at(origin + moved, SIZE.0, SIZE.1)],
            Rules::DEFAULT,
        );
        let worst = worst_difference(&a[0], &b[0]);
        // 5.4e6 m in f64 has an ulp of 1 nm.
        assert!(worst <= 0.005, "step {step}: {worst}");
    }
    assert_exact(
        &far,
        &[camera_at(origin + DVec3::X * 0.001, SIZE.0, SIZE.1)],
        Rules::DEFAULT,
    );
}

fn worst_difference(a: &Image, b: &Image) -> f32 {
    a.rgb
        .iter()
        .flatten()
        .zip(b.rgb.iter().flatten())
        .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()))
}

#[test]
fn image_sizes_that_are_no_multiple_of_the_tile() {
    let world = world_of(&crowd(400));
    let cameras: Vec<Camera> = [(1, 1), (1, 50), (65, 33), (63, 31), (64, 32), (129, 7)]
        .into_iter()
        .map(|(width, height)| Camera {
            name: format!("{width}x{height}"),
            ..camera_at(DVec3::ZERO, width, height)
        })
        .collect();
    // All in one submission: images must not reach into each other.
    assert_exact(&world, &cameras, Rules::DEFAULT);
}

#[test]
fn an_8k_wide_image() {
    let world = world_of(&crowd(300));
    let mut camera = camera_at(DVec3::ZERO, 8192, 40);
    camera.intrinsics.fy_px = 80.0;
    assert_exact(&world, &[camera], Rules::DEFAULT);
}

#[test]
fn interpenetrating_clouds_of_the_same_kind() {
    // Two clouds through each other, met in one depth order whichever comes first in the world.
    let a = crowd(300);
    let b: Vec<Splat> = crowd(300)
        .into_iter()
        .map(|s| Splat {
            rgb: [s.rgb[2], s.rgb[0], 1.0],
            mean_m: [s.mean_m[1], s.mean_m[0], s.mean_m[2] + 0.01],
            ..s
        })
        .collect();
    let turned = Camera {
        world_from_camera: Pose::new(DQuat::from_rotation_y(0.4), DVec3::new(-1.0, 0.0, 0.0)),
        ..camera()
    };
    assert_exact(
        &world_of(&[a, b].concat()),
        &[camera(), turned],
        Rules::DEFAULT,
    );
}

#[test]
fn every_rule_set_is_drawn_as_defined() {
    let world = SplatScene {
        sky: [0.2, 0.4, 0.9],
        ..world_of(&crowd(3000))
    };
    for name in Rules::NAMES {
        for antialias in [false, true] {
            assert_exact(
                &world,
                &[camera()],
                Rules {
                    antialias,
                    ..Rules::by_name(name).unwrap()
                },
            );
        }
    }
}

#[test]
fn a_scene_larger_than_the_device_is_refused_with_its_bytes() {
    let gpu = Validated::open();
    let mut renderer = Renderer::new(&gpu, RenderOptions::default());
    let resident = renderer.upload(&world_of(&crowd(10))).unwrap();
    // Three images of 32768 x 32768 pixels: 48 GiB in one buffer, where devices bind 4 GiB at most.
    let cameras: Vec<Camera> = (0..3)
        .map(|_| camera_at(DVec3::ZERO, 32_768, 32_768))
        .collect();
    let error = renderer
        .render(&resident, &cameras)
        .expect_err("no device has it")
        .to_string();
    assert!(
        error.contains("51539607552") || error.contains("bytes"),
        "{error}"
    );
    assert!(error.chars().any(|c| c.is_ascii_digit()), "{error}");
    // And the renderer goes on.
    renderer.render(&resident, &[camera()]).unwrap();
}
