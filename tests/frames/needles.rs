//! Splats far thinner than a pixel, which half of those of a captured street are: rounding of their
//! means decides alpha >= 1/255.

use decouplegs::render::metrics::{Difference, Flips};
use decouplegs::render::reference;
use decouplegs::scene::{Camera, Intrinsics, Pose, Rules};
use glam::{DQuat, DVec3};

use super::{Splat, camera_at, draw, world_of};
use crate::device::Validated;
use crate::stages::Random;

/// Needles and blades in front of a camera that drives along z, some of them faint.
fn needles(count: usize) -> Vec<Splat> {
    let mut random = Random(7);
    (0..count)
        .map(|_| {
            let depth_m = random.across_scales(3.0, 60.0);
            Splat {
                mean_m: [
                    512.0 + random.between(-0.9, 0.9) * depth_m,
                    random.between(-0.28, 0.3) * depth_m,
                    depth_m,
                ],
                scale_m: [
                    depth_m * random.across_scales(0.003, 0.03),
                    depth_m * random.across_scales(1e-5, 3e-3),
                    1e-4,
                ],
                rotation: std::array::from_fn(|_| random.between(-1.0, 1.0)),
                opacity: random.across_scales(0.01, 0.8),
                rgb: std::array::from_fn(|_| random.between(0.0, 1.0)),
            }
        })
        .collect()
}

#[test]
fn needles_in_a_wide_image_are_exact() {
    let gpu = Validated::open();
    let world = world_of(&needles(6000));
    let camera = Camera {
        intrinsics: Intrinsics::pinhole([1242, 375], [721.5377; 2], [609.5593, 172.854]),
        world_from_camera: Pose::new(
            DQuat::from_rotation_y(0.0123) * DQuat::from_rotation_x(-0.0071),
            DVec3::new(512.0321, 0.0123, 0.0456),
        ),
        ..camera_at(DVec3::ZERO, 1242, 375)
    };
    let image = draw(&gpu, &world, std::slice::from_ref(&camera), Rules::DEFAULT).remove(0);
    let truth = reference::render(&world, &camera, &Rules::DEFAULT).to_image();
    let difference = Difference::between(&image, &truth).unwrap();
    let flips = Flips::between(&image, &truth).unwrap();
    println!(
        "{:.1} dB, max {:.5}, {flips:?}",
        difference.psnr_db, difference.max_abs
    );
    assert!(difference.psnr_db >= 105.0, "{:.2} dB", difference.psnr_db);
    assert!(flips.pixels <= 25, "{flips:?}");
}
