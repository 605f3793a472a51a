//! Projection of a Gaussian in the world to its footprint in an image, in f32: `projection.glsl`.

use decouplegs_scene::{Rules, rules};
pub use decouplegs_shaders::constants::HALF_LOG2_E;
use glam::{Mat3, Vec2, Vec3, vec3};

use super::footprint::{Footprint, LOG2_255};
use crate::layout::{CameraRecord, near_m, response_squares_max};

pub(super) const DILATION_PX2: f32 = rules::DILATION_PX2 as f32;
pub(super) const ALPHA_MIN: f32 = rules::ALPHA_MIN as f32;

/// Variants of an image's rules that the projection is built for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// A splat nearer than this is dropped, meters.
    pub near_m: f32,
    /// True if opacity compensates dilation.
    pub antialias: bool,
    /// Largest sum of squares at a pixel that a splat adds to.
    pub squares_max: f32,
}

impl Variant {
    /// The variant for `rules`.
    #[must_use]
    pub fn for_rules(rules: &Rules) -> Self {
        Self {
            near_m: near_m(rules),
            antialias: rules.antialias,
            squares_max: response_squares_max(rules),
        }
    }
}

/// The mean relative to the camera, world axes, meters.
#[must_use]
pub fn from_camera_m(mean_m: [f32; 3], camera: &CameraRecord) -> Vec3 {
    (Vec3::from_array(mean_m) - Vec3::from_array(camera.center_high_m))
        - Vec3::from_array(camera.center_low_m)
}

/// An offset from the camera in camera axes.
#[must_use]
pub fn to_camera_axes(camera: &CameraRecord, offset: Vec3) -> Vec3 {
    vec3(
        Vec3::from_array(camera.row_x).dot(offset),
        Vec3::from_array(camera.row_y).dot(offset),
        Vec3::from_array(camera.row_z).dot(offset),
    )
}

/// The rotation of a unit quaternion w, x, y, z.
#[must_use]
pub fn matrix_from_quaternion(q: [f32; 4]) -> Mat3 {
    let [w, x, y, z] = q;
    Mat3::from_cols(
        vec3(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
        ),
        vec3(
            2.0 * (x * y - w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + w * x),
        ),
        vec3(
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ),
    )
}

/// The splat's own axes in the world, each as long as its standard deviation; `shape` is scales and
/// opacity.
#[must_use]
pub fn axes_of(shape: [f32; 4], rotation: [f32; 4]) -> Mat3 {
    let turned = matrix_from_quaternion(rotation);
    Mat3::from_cols(
        turned.x_axis * shape[0],
        turned.y_axis * shape[1],
        turned.z_axis * shape[2],
    )
}

/// The footprint of a splat whose mean is `t` in camera space and whose covariance is `axes` times
/// its transpose in world space. The second value is false when the splat is behind the near plane
/// or adds nothing to any pixel.
#[must_use]
pub fn project_splat(
    camera: &CameraRecord,
    t: Vec3,
    axes: Mat3,
    opacity: f32,
    variant: Variant,
) -> (Footprint, bool) {
    // Written so that a NaN fails.
    if !matches!(
        t.z.partial_cmp(&variant.near_m),
        Some(std::cmp::Ordering::Greater | std::cmp::Ordering::Equal)
    ) {
        return (Footprint::default(), false);
    }
    let focal_px = Vec2::from_array(camera.focal_px);
    let xy = t.truncate() / t.z;
    let slope = xy
        .max(Vec2::from_array(camera.slope_min))
        .min(Vec2::from_array(camera.slope_max));
    let [row_x, row_y, row_z] = [camera.row_x, camera.row_y, camera.row_z]
        .map(|row| axes.transpose() * Vec3::from_array(row));
    let mut m0 = (row_x - slope.x * row_z) * (focal_px.x / t.z);
    let mut m1 = (row_y - slope.y * row_z) * (focal_px.y / t.z);
    let unit_px = m0.abs().max(m1.abs()).max_element().max(1.0);
    m0 /= unit_px;
    m1 /= unit_px;
    let dilation = DILATION_PX2 / (unit_px * unit_px);
    let area = m0.cross(m1);
    let undilated = area.dot(area);
    let (xx, yy) = (m0.dot(m0), m1.dot(m1));
    let determinant = undilated + dilation * (xx + yy) + dilation * dilation;
    let variance_y = yy + dilation;
    let opacity = if variant.antialias {
        opacity * (undilated / determinant).sqrt()
    } else {
        opacity
    };
    let splat = Footprint {
        mean_px: focal_px * xy + Vec2::from_array(camera.principal_px),
        slope: m0.dot(m1) / variance_y,
        rate_x: (HALF_LOG2_E * variance_y / determinant).sqrt() / unit_px,
        rate_y: (HALF_LOG2_E / variance_y).sqrt() / unit_px,
        log2_opacity: opacity.log2().max(-LOG2_255),
    };
    let drawn = opacity >= ALPHA_MIN
        && splat.rate_x > 0.0
        && splat.rate_y > 0.0
        && splat.slope.abs() < 1e30
        && splat.mean_px.x.abs() < 1e30
        && splat.mean_px.y.abs() < 1e30;
    (splat, drawn)
}
