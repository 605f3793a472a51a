//! The mean of a splat in the image, more exact than an f32: `mean_px.glsl`.

use decouplegs_shaders::constants::GRID_ANCHOR;
use glam::{Vec2, Vec3, vec3};

use crate::layout::CameraRecord;

/// The multiples of `unit` * 2^-11 next to `v`; `unit` is a power of two.
fn on_grid(v: Vec3, unit: f32) -> Vec3 {
    let anchor = Vec3::splat(GRID_ANCHOR * unit);
    (v + anchor) - anchor
}

/// A position in the image in two parts whose sum it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelPair {
    /// A multiple of 2^(7 - mean_shift) pixels.
    pub coarse: Vec2,
    /// Remainder that the coarse part leaves.
    pub fine: Vec2,
}

/// Projection of a mean by a pinhole.
#[must_use]
pub fn exact_mean_px(camera: &CameraRecord, mean_m: [f32; 3]) -> PixelPair {
    let [center_high, center_low] =
        [camera.center_high_m, camera.center_low_m].map(Vec3::from_array);
    let mean = Vec3::from_array(mean_m);
    let offset = mean - center_high;
    let center_part = offset - mean;
    let rest = (mean - (offset - center_part)) + (-center_high - center_part) - center_low;
    let longest = offset.abs().max_element();
    let unit = 2.0 * f32::from_bits(longest.to_bits() & 0x7f80_0000);
    let coarse = on_grid(offset, unit);
    let fine = (offset - coarse) + rest;
    let both = coarse + fine;
    let coarse_rows = [
        camera.row_x_coarse,
        camera.row_y_coarse,
        camera.row_z_coarse,
    ]
    .map(Vec3::from_array);
    let fine_rows = [camera.row_x_fine, camera.row_y_fine, camera.row_z_fine].map(Vec3::from_array);
    let t = Vec3::from_array(coarse_rows.map(|row| row.dot(coarse)));
    let t_fine = vec3(
        coarse_rows[0].dot(fine) + fine_rows[0].dot(both),
        coarse_rows[1].dot(fine) + fine_rows[1].dot(both),
        coarse_rows[2].dot(fine) + fine_rows[2].dot(both),
    );
    let z = t.z + t_fine.z;
    let ratio = on_grid(((t.truncate() + t_fine.truncate()) / z).extend(0.0), 1.0).truncate();
    let z_coarse = on_grid(vec3(t.z, 0.0, 0.0), unit).x;
    let z_fine = (t.z - z_coarse) + t_fine.z;
    let remainder = ((t.truncate() - ratio * z_coarse) - ratio * z_fine) + t_fine.truncate();
    let [
        focal,
        focal_coarse,
        focal_fine,
        principal_coarse,
        principal_fine,
    ] = [
        camera.focal_px,
        camera.focal_coarse_px,
        camera.focal_fine_px,
        camera.principal_coarse_px,
        camera.principal_fine_px,
    ]
    .map(Vec2::from_array);
    PixelPair {
        coarse: focal_coarse * ratio + principal_coarse,
        fine: focal_fine * ratio + principal_fine + focal * (remainder / z),
    }
}

/// A coordinate of the image in 32 bits: steps of 2^-`shift` pixels from 0 to 2^(31 - `shift`)
/// pixels, or `plain`, its f32, without the last digit.
#[must_use]
pub fn pack_coordinate(coarse: f32, fine: f32, plain: f32, shift: u32) -> u32 {
    let steps_per_px = f32::from_bits((127 + shift) << 23);
    let place = (coarse + fine) * steps_per_px;
    if (0.0..2_147_483_648.0).contains(&place) {
        let steps = |part: f32| (part * steps_per_px).round_ties_even() as i32;
        return (steps(coarse) + steps(fine)) as u32;
    }
    0x8000_0000 | plain.to_bits().wrapping_add(1) >> 1
}

/// The code of a position whose f32 is `plain`.
#[must_use]
pub fn pack_mean(pair: PixelPair, plain: Vec2, shift: u32) -> [u32; 2] {
    let PixelPair { coarse, fine } = pair;
    [
        pack_coordinate(coarse.x, fine.x, plain.x, shift),
        pack_coordinate(coarse.y, fine.y, plain.y, shift),
    ]
}

/// A coordinate relative to pixel coordinate `origin` of the image.
#[must_use]
pub fn unpack_coordinate(code: u32, origin: u32, shift: u32) -> f32 {
    let px_per_step = f32::from_bits((127 - shift) << 23);
    if code >= 0x8000_0000 {
        f32::from_bits(code << 1) - origin as f32
    } else {
        code.wrapping_sub(origin << shift) as i32 as f32 * px_per_step
    }
}

/// A position relative to pixel `origin`.
#[must_use]
pub fn unpack_mean(code: [u32; 2], origin: [u32; 2], shift: u32) -> Vec2 {
    Vec2::from_array(std::array::from_fn(|axis| {
        unpack_coordinate(code[axis], origin[axis], shift)
    }))
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::{Camera, Intrinsics, Motion, Pose, Rules, SplatCloud};
    use glam::{DQuat, DVec2, DVec3};
    use proptest::prelude::*;

    use super::*;
    use crate::reference::project::View;

    /// A camera of a car, far from the world's origin.
    fn camera(width_px: u32, yaw_rad: f64) -> Camera {
        let size = f64::from(width_px);
        Camera {
            name: "front".into(),
            intrinsics: Intrinsics::pinhole(
                [width_px, width_px * 3 / 8],
                [0.5809 * size, 0.5812 * size],
                [0.490_788_5 * size, 0.1391 * size],
            ),
            world_from_camera: Pose::new(
                DQuat::from_rotation_y(yaw_rad) * DQuat::from_rotation_x(0.0123),
                DVec3::new(1_234.567_89, -3.21, 98.765_432_1),
            ),
            motion: Motion::REST,
        }
    }

    /// The code of a mean in an image of `camera`, and its position by definition, pixels.
    fn projected(camera: &Camera, mean_m: [f32; 3]) -> ([u32; 2], DVec2, CameraRecord) {
        let record = CameraRecord::new(camera, DVec3::ZERO, 1.0, 0, 0);
        let ball = SplatCloud {
            means: vec![mean_m],
            scales: vec![[0.01; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![1.0],
            sh_dc: vec![[0.0; 3]],
            ..SplatCloud::default()
        };
        let view = View::new(DVec3::ZERO, camera, &Rules::DEFAULT);
        let truth = view.project(&ball, 0).unwrap().mean_px;
        let plain = truth.as_vec2();
        (
            pack_mean(exact_mean_px(&record, mean_m), plain, record.mean_shift),
            truth,
            record,
        )
    }

    proptest! {
        #[test]
        fn a_mean_in_the_image_is_exact_to_a_step(
            width_px in prop_oneof![Just(1242u32), Just(1600), Just(3848)],
            yaw_rad in -3.1f64..3.1,
            place in [0.0f64..1.0, 0.0..1.0],
            depth_m in prop_oneof![0.05f64..1.0, 1.0..80.0, 80.0..5000.0],
        ) {
            let camera = camera(width_px, yaw_rad);
            let k = &camera.intrinsics;
            let pixel = DVec2::from_array(place) * DVec2::new(k.width_px.into(), k.height_px.into());
            let ray = k.unproject(pixel).unwrap();
            let mean = camera.world_from_camera.transform(ray * (depth_m / ray.z));
            let (code, truth, record) = projected(&camera, mean.as_vec3().to_array());
            let origin = truth.to_array().map(|px| px.max(0.0) as u32);
            let found = unpack_mean(code, origin, record.mean_shift).as_dvec2();
            let error_px = (found - (truth - DVec2::from_array(origin.map(f64::from)))).abs();
            prop_assert!(
                error_px.max_element() <= 0.75 * record.mean_step_px(),
                "{error_px} of a step of {:e} px", record.mean_step_px()
            );
        }
    }

    #[test]
    fn means_beyond_the_image_are_floats() {
        let shift = 20;
        for plain in [-0.25f32, -1e6, 2048.0, 1e9, -1e30] {
            let code = pack_coordinate(plain, 0.0, plain, shift);
            assert_eq!(code >> 31, 1, "{plain}");
            let error = (unpack_coordinate(code, 0, shift) - plain).abs();
            assert!(error <= 1.3e-7 * plain.abs(), "{plain}: {error:e}");
        }
        // What is no number stays none, and takes the f32.
        let code = pack_coordinate(f32::NAN, 0.0, 7.0, shift);
        assert_eq!(unpack_coordinate(code, 0, shift), 7.0);
    }

    #[test]
    fn coordinates_are_taken_relative_to_a_pixel_before_they_are_rounded() {
        let code = pack_coordinate(1000.0, 2f32.powi(-20), 1000.0, 20);
        assert_eq!(unpack_coordinate(code, 0, 20), 1000.0);
        assert_eq!(unpack_coordinate(code, 1000, 20), 2f32.powi(-20));
        assert_eq!(unpack_coordinate(code, 1984, 20), -984.0);
    }
}
