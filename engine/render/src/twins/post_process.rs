//! Post-processing of an image: `post_process.comp`.

use decouplegs_scene::SkyMap;
use glam::{Vec2, Vec3};

use crate::post_processing::PhotometryRecord;

/// Color of `sky` in a direction of its cube, of any length but zero.
#[must_use]
pub fn sky_color(sky: &SkyMap, direction: Vec3) -> Vec3 {
    let (d, size) = (direction, direction.abs());
    let longest = size.x.max(size.y.max(size.z));
    let (face, s, t) = if size.x == longest {
        let ahead = d.x > 0.0;
        (u32::from(!ahead), if ahead { -d.z } else { d.z }, -d.y)
    } else if size.y == longest {
        let ahead = d.y > 0.0;
        (2 + u32::from(!ahead), d.x, if ahead { d.z } else { -d.z })
    } else {
        let ahead = d.z > 0.0;
        (4 + u32::from(!ahead), if ahead { d.x } else { -d.x }, -d.y)
    };
    let texels = sky.face_texels() as f32;
    let split = |at: f32| {
        let texel = 0.5 * (at / longest + 1.0) * texels + 0.5;
        let first = texel.floor().min(texels);
        (first as usize, texel - first)
    };
    let ((column, right), (row, down)) = (split(s), split(t));
    let side = sky.face_texels() + 2;
    let corner = (face as usize * side + row) * side + column;
    let texel = |at: usize| Vec3::from_array(sky.bordered_texels()[at]);
    let upper = texel(corner).lerp(texel(corner + 1), right);
    let lower = texel(corner + side).lerp(texel(corner + side + 1), right);
    let color = upper.lerp(lower, down);
    if sky.clamps {
        color.clamp(Vec3::ZERO, Vec3::ONE)
    } else {
        color
    }
}

/// Color of the image at `center_px` of a color of the scene.
#[must_use]
pub fn calibrated(own: &PhotometryRecord, color: Vec3, center_px: Vec2) -> Vec3 {
    let r2 = Vec3::from_array(own.vignetting_center_px.map(|own_center_px| {
        let from_center_px = center_px - Vec2::from_array(own_center_px);
        (from_center_px * Vec2::from_array(own.vignetting_scale)).length_squared()
    }));
    let [a, b, c] = own.vignetting.map(Vec3::from_array);
    let through = (1.0 + r2 * (a + r2 * (b + r2 * c))).clamp(Vec3::ZERO, Vec3::ONE);
    let mut exposed = own.gain * color * through;
    if own.has_balance != 0 {
        exposed = balanced(own, exposed);
    }
    let rows = own.matrix.map(|row| Vec3::from_array(row).dot(exposed));
    let mixed = Vec3::from_array(rows) + Vec3::from_array(own.offset);
    let curved = |channel: usize| match own.gamma[channel] {
        1.0 => mixed[channel],
        gamma => mixed[channel].max(0.0).powf(gamma),
    };
    let curved: [f32; 3] = std::array::from_fn(curved);
    if own.has_response == 0 {
        return Vec3::from_array(curved);
    }
    Vec3::from_array(std::array::from_fn(|channel| {
        response(own, channel, curved[channel])
    }))
}

/// `color` after the homography of its red, its green and its sum, at the sum that it had.
fn balanced(own: &PhotometryRecord, color: Vec3) -> Vec3 {
    let sum = color.x + color.y + color.z;
    let of = Vec3::new(color.x, color.y, sum);
    let [red, green, of_sum] = own.balance.map(|row| Vec3::from_array(row).dot(of));
    let divisor = of_sum + 1e-5;
    if divisor <= 0.0 {
        return Vec3::ZERO;
    }
    let scale = sum / divisor;
    let (red, green) = (red * scale, green * scale);
    Vec3::new(red, green, of_sum * scale - red - green)
}

/// Response of the sensor's `channel` to `light`.
fn response(own: &PhotometryRecord, channel: usize, light: f32) -> f32 {
    let [toe, shoulder, gamma, center, at_center] = own.response.map(|of| of[channel]);
    let light = light.clamp(0.0, 1.0);
    let joined = if light <= center {
        at_center * (light / center).max(1e-6).powf(toe)
    } else {
        let from_white = (1.0 - light) / (1.0 - center);
        1.0 - (1.0 - at_center) * from_white.max(1e-6).powf(shoulder)
    };
    joined.max(1e-6).powf(gamma)
}

/// Color and alpha of a pixel: `blended`, the color of its splats and alpha, over `sky` along
/// `ray`, a direction of the cube; zero where no ray falls.
#[must_use]
pub fn over_sky(sky: &SkyMap, blended: [f32; 4], ray: Vec3) -> [f32; 4] {
    let [red, green, blue, alpha] = blended;
    let color = Vec3::new(red, green, blue);
    let splats = if sky.clamps_splats {
        color.min(Vec3::ONE)
    } else {
        color
    };
    let behind = if ray == Vec3::ZERO {
        Vec3::ZERO
    } else {
        sky_color(sky, ray)
    };
    (splats + (1.0 - alpha) * behind).extend(alpha).to_array()
}
