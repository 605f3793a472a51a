//! The sky: splats on a dome about the place, colored by the probe.

use glam::Vec3;

use super::canvas::{Canvas, Disc, Look};
use super::illumination::Illumination;

/// Distance from the land's end to the dome, meters.
pub(super) const BEYOND_M: f32 = 150.0;

/// The dome reaches this far below the horizon, over its radius: the land ends before it.
const BELOW: f32 = -0.12;

/// Standard deviation over the spacing.
const SCALE_OVER_SPACING: f32 = 0.75;

/// `count` splats on a dome of `radius_m`, its middle at height `z_m`, evenly on a spiral (Vogel, A
/// better way to construct the sunflower head, 1979).
pub(super) fn dome(
    canvas: &mut Canvas,
    count: usize,
    radius_m: f32,
    light: &Illumination,
    z_m: f32,
) {
    canvas.grow(count);
    let golden_rad = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let spacing_m = (std::f32::consts::TAU * (1.0 - BELOW) / count.max(1) as f32).sqrt() * radius_m;
    for index in 0..count {
        let height = 1.0 - (1.0 - BELOW) * ((index as f64 + 0.5) / count as f64) as f32;
        let (sin, cos) = (golden_rad * index as f64)
            .rem_euclid(std::f64::consts::TAU)
            .sin_cos();
        let ring = (1.0 - height * height).max(0.0).sqrt();
        let outward = Vec3::new(ring * cos as f32, ring * sin as f32, height);
        let along = outward.cross(Vec3::Z).normalize_or(Vec3::X);
        let size_m = SCALE_OVER_SPACING * spacing_m;
        canvas.push(Disc {
            middle: outward * radius_m + Vec3::Z * z_m,
            along: along * size_m,
            across: outward.cross(along) * size_m,
            albedo: light.seen(outward.with_z(outward.z.max(0.01))),
            look: Look::Shown,
        });
    }
}
