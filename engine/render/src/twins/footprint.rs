//! The pixels a projected splat can reach: `footprint.glsl`.

pub use decouplegs_shaders::constants::{LOG2_255, SQUARED_RADIUS_SLACK};
use glam::{Vec2, vec2};

use crate::layout::{COARSE_HEIGHT_PX, COARSE_WIDTH_PX};

/// A projected Gaussian in the factored form that blending evaluates: with d = pixel center - mean,
/// log2(alpha) = log2_opacity - ((d.x - slope d.y) rate_x)^2 - (d.y rate_y)^2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// Projected mean, pixels from the top left corner of the image.
    pub mean_px: Vec2,
    /// Shift of the ridge along x per pixel along y.
    pub slope: f32,
    /// Square root of the exponent's fall along x, per pixel.
    pub rate_x: f32,
    /// Square root of the exponent's fall along y on the ridge, per pixel.
    pub rate_y: f32,
    /// log2 of the peak alpha.
    pub log2_opacity: f32,
}

/// Squared radius, in units of the exponent, beyond which the splat adds nothing: at most
/// `squares_max` ([`crate::layout::response_squares_max`]), as in all functions here.
#[must_use]
pub fn squared_radius(splat: &Footprint, squares_max: f32) -> f32 {
    (splat.log2_opacity + LOG2_255).min(squares_max)
}

/// log2 of the least alpha of the splat that is blended.
#[must_use]
pub fn log2_alpha_min(splat: &Footprint, squares_max: f32) -> f32 {
    (splat.log2_opacity - squares_max).max(-LOG2_255)
}

/// Pixel coordinates `[first, last]` along one axis whose centers lie in `[low, high]`, clipped to
/// the image. Empty when first > last.
#[must_use]
pub fn pixels_between(low: f32, high: f32, size_px: u32) -> [i32; 2] {
    let size = size_px as f32;
    [
        (low - 0.5).ceil().max(0.0).min(size) as i32,
        (high - 0.5).floor().max(-1.0).min(size - 1.0) as i32,
    ]
}

/// Rows of pixels `[first, last]` that the splat can reach.
#[must_use]
pub fn reached_rows(splat: &Footprint, squares_max: f32, height_px: u32) -> [i32; 2] {
    let half_height =
        (squared_radius(splat, squares_max) + SQUARED_RADIUS_SLACK).sqrt() / splat.rate_y;
    pixels_between(
        splat.mean_px.y - half_height,
        splat.mean_px.y + half_height,
        height_px,
    )
}

/// Columns of pixels `[first, last]` that the splat can reach in the rows whose centers lie in
/// `[low_y, high_y]`.
#[must_use]
pub fn reached_columns(
    splat: &Footprint,
    squares_max: f32,
    [low_y, high_y]: [f32; 2],
    width_px: u32,
) -> [i32; 2] {
    let r2 = squared_radius(splat, squares_max) + SQUARED_RADIUS_SLACK;
    let r = r2.sqrt();
    let low_v = ((low_y - splat.mean_px.y) * splat.rate_y).max(-r);
    let high_v = ((high_y - splat.mean_px.y) * splat.rate_y).min(r);
    // Written so that a NaN gives an empty range.
    if !matches!(
        low_v.partial_cmp(&high_v),
        Some(std::cmp::Ordering::Less | std::cmp::Ordering::Equal)
    ) {
        return [0, -1];
    }
    let a = splat.slope / splat.rate_y;
    let b = 1.0 / splat.rate_x;
    let top_v = r * a * (1.0 / (a * a + b * b).sqrt());
    let right_v = top_v.max(low_v).min(high_v);
    let left_v = (-top_v).max(low_v).min(high_v);
    let right = a * right_v + b * (r2 - right_v * right_v).max(0.0).sqrt();
    let left = a * left_v - b * (r2 - left_v * left_v).max(0.0).sqrt();
    let rounding = 1e-6 * (a.abs() * r + b * r);
    pixels_between(
        splat.mean_px.x + left - rounding,
        splat.mean_px.x + right + rounding,
        width_px,
    )
}

/// Coarse tiles `[first, last]` of row `row` of the camera's tiles that the splat can reach; empty
/// when first > last.
#[must_use]
pub fn reached_coarse_tiles(
    splat: &Footprint,
    squares_max: f32,
    row: u32,
    size_px: [u32; 2],
) -> [i32; 2] {
    let top = (row * COARSE_HEIGHT_PX) as f32;
    let bottom = (top + COARSE_HEIGHT_PX as f32).min(size_px[1] as f32);
    let [first, last] = reached_columns(splat, squares_max, [top + 0.5, bottom - 0.5], size_px[0]);
    if first > last {
        [0, -1]
    } else {
        [
            first / COARSE_WIDTH_PX as i32,
            last / COARSE_WIDTH_PX as i32,
        ]
    }
}

/// Rows `[first, last]` of coarse tiles that the splat can reach; empty when first > last.
#[must_use]
pub fn reached_coarse_rows(splat: &Footprint, squares_max: f32, height_px: u32) -> [i32; 2] {
    let [first, last] = reached_rows(splat, squares_max, height_px);
    if first > last {
        [0, -1]
    } else {
        [
            first / COARSE_HEIGHT_PX as i32,
            last / COARSE_HEIGHT_PX as i32,
        ]
    }
}

/// The exponent at a pixel center, log2 of alpha before its upper bound.
#[must_use]
pub fn log2_alpha(splat: &Footprint, center_px: Vec2) -> f32 {
    let d = center_px - splat.mean_px;
    let shear = splat.slope * d.y;
    let v = d.y * splat.rate_y;
    let exponent = splat.log2_opacity - v * v;
    let u = (d.x - shear) * splat.rate_x;
    exponent - u * u
}

/// Center of pixel `(column, row)`.
#[must_use]
pub fn center_of(column: u32, row: u32) -> Vec2 {
    vec2(column as f32 + 0.5, row as f32 + 0.5)
}
