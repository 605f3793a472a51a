//! A visible splat as one camera sees it, and its form in memory: `record.glsl`.

use glam::{Vec3, vec2};

use super::color_code::{pack_color, unpack_color};
use super::footprint::Footprint;

/// A visible splat as one camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// The pixels it reaches and how much it adds there.
    pub splat: Footprint,
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
    let values = [
        record.splat.mean_px.x,
        record.splat.mean_px.y,
        record.splat.slope,
        record.splat.rate_x,
    ];
    values.map(f32::to_bits)
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

/// The footprint in the two vectors.
#[must_use]
pub fn unpack_footprint(low: [u32; 4], high: [u32; 4]) -> Footprint {
    let (low, high) = (low.map(f32::from_bits), high.map(f32::from_bits));
    Footprint {
        mean_px: vec2(low[0], low[1]),
        slope: low[2],
        rate_x: low[3],
        rate_y: high[0],
        log2_opacity: high[1],
    }
}

/// The footprint of record `record` in a buffer of two vectors a record.
#[must_use]
pub fn load_footprint(footprints: &[[u32; 4]], record: usize) -> Footprint {
    unpack_footprint(footprints[2 * record], footprints[2 * record + 1])
}

/// The color of record `record` in such a buffer.
#[must_use]
pub fn load_color(footprints: &[[u32; 4]], record: usize) -> Vec3 {
    let [.., low, high] = footprints[2 * record + 1];
    unpack_color([low, high])
}
