//! A visible splat as one camera sees it, and its form in memory: `record.glsl`.

use glam::Vec3;

use super::color_code::{pack_color, unpack_color};
use super::footprint::Footprint;
use super::mean_px::unpack_mean;

/// A visible splat as one camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// The pixels it reaches and how much it adds there.
    pub splat: Footprint,
    /// Code of its mean ([`pack_mean`](super::mean_px::pack_mean)).
    pub mean: [u32; 2],
    /// RGB, not negative.
    pub color: Vec3,
    /// Camera-space z, or distance where the order is radial, meters.
    pub depth_m: f32,
    /// The instance it belongs to.
    pub instance: u32,
}

/// The first of its two vectors.
#[must_use]
pub fn pack_record_low(record: &Record) -> [u32; 4] {
    let [x, y] = record.mean;
    [
        x,
        y,
        record.splat.slope.to_bits(),
        record.splat.rate_x.to_bits(),
    ]
}

/// The second of its two vectors.
#[must_use]
pub fn pack_record_high(record: &Record) -> [u32; 4] {
    let [low, high] = pack_color(record.color);
    [
        record.splat.rate_y.to_bits(),
        record.splat.log2_opacity.to_bits(),
        low,
        high,
    ]
}

/// The footprint in the two vectors, its mean relative to pixel `origin` of an image whose records
/// have this [`mean_shift`](crate::layout::CameraRecord::mean_shift).
#[must_use]
pub fn unpack_footprint(
    low: [u32; 4],
    high: [u32; 4],
    mean_shift: u32,
    origin: [u32; 2],
) -> Footprint {
    let [x, y, rest @ ..] = low;
    let ([slope, rate_x], high) = (rest.map(f32::from_bits), high.map(f32::from_bits));
    Footprint {
        mean_px: unpack_mean([x, y], origin, mean_shift),
        slope,
        rate_x,
        rate_y: high[0],
        log2_opacity: high[1],
    }
}

/// The footprint of record `record` in a buffer of two vectors a record, as [`unpack_footprint`]
/// gives it.
#[must_use]
pub fn load_footprint(
    footprints: &[[u32; 4]],
    record: usize,
    mean_shift: u32,
    origin: [u32; 2],
) -> Footprint {
    unpack_footprint(
        footprints[2 * record],
        footprints[2 * record + 1],
        mean_shift,
        origin,
    )
}

/// The color of record `record` in such a buffer.
#[must_use]
pub fn load_color(footprints: &[[u32; 4]], record: usize) -> Vec3 {
    let [.., low, high] = footprints[2 * record + 1];
    unpack_color([low, high])
}
