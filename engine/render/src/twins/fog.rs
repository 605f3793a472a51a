//! Fog between splats and the camera: `fog.glsl`.

use glam::Vec3;

/// Color of a splat of `color` at `range_m`; `fog` is the color of the air, and extinction per
/// meter.
#[must_use]
pub fn in_fog(color: Vec3, range_m: f32, [red, green, blue, extinction_per_m]: [f32; 4]) -> Vec3 {
    let left = (-extinction_per_m * range_m).exp();
    Vec3::new(red, green, blue).lerp(color, left)
}
