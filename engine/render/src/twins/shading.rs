//! Light on an agent by the normals of its splats: `shading.glsl`.

use glam::{Mat3, Vec3};

use decouplegs_shaders::constants::SHADING_LIGHT_MIN;

use crate::layout::ShadingRecord;

/// The inverse of the covariance of `axes`, squared `squarings` times, but for a factor.
#[must_use]
pub fn inverse_power(axes: Mat3, squarings: u32) -> Mat3 {
    let columns = [axes.x_axis, axes.y_axis, axes.z_axis];
    let unit = columns
        .iter()
        .map(|axis| axis.length())
        .fold(1e-30, f32::max);
    let [x, y, z] = columns.map(|axis| axis / unit);
    let adjugate = Mat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    let mut power = adjugate * adjugate.transpose();
    for _ in 0..squarings {
        let trace = power.x_axis.x + power.y_axis.y + power.z_axis.z;
        power *= trace.max(1e-30).recip();
        power *= power;
    }
    power
}

/// Normal by which a splat of an agent is shaded, a unit vector in the agent's frame.
#[must_use]
pub fn shading_normal(shading: &ShadingRecord, axes: Mat3, mean_m: Vec3) -> Vec3 {
    let outward = (mean_m * Vec3::from_array(shading.outward)).normalize_or(Vec3::Z);
    (inverse_power(axes, 2) * outward).normalize_or(outward)
}

/// Factor on the displayed color of a surface of the given normal at `mean_m`.
#[must_use]
pub fn shading_gain(shading: &ShadingRecord, normal: Vec3, mean_m: Vec3) -> Vec3 {
    let [up, upright, upward] = [shading.up, shading.upright, shading.upward].map(Vec3::from_array);
    let mut light = upright + normal.dot(up) * upward;
    let slope_per_m = Vec3::from_array(shading.first_slope_per_m);
    let mut share = (shading.first_middle + slope_per_m.dot(mean_m)).clamp(0.0, 1.0);
    for (towards, rgb) in shading.towards.into_iter().zip(shading.rgb) {
        light += share * normal.dot(Vec3::from_array(towards)).max(0.0) * Vec3::from_array(rgb);
        share = 1.0;
    }
    light.map(|value| value.max(SHADING_LIGHT_MIN).powf(1.0 / 2.2))
}
