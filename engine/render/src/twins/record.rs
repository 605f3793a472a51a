//! A visible splat as one camera sees it, and its form in memory: `record.glsl`.

use glam::vec2;

use super::footprint::Footprint;

/// A visible splat as one camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// The pixels it reaches and how much it adds there.
    pub splat: Footprint,
    /// Camera-space z, or distance where the order is radial, meters.
    pub depth_m: f32,
    /// The instance it belongs to.
    pub instance: u32,
}

/// The first of its two vectors.
#[must_use]
pub fn pack_record_low(record: &Record) -> [f32; 4] {
    [
        record.splat.mean_px.x,
        record.splat.mean_px.y,
        record.splat.slope,
        record.splat.rate_x,
    ]
}

/// The second of its two vectors.
#[must_use]
pub fn pack_record_high(record: &Record) -> [f32; 4] {
    [
        record.splat.rate_y,
        record.splat.log2_opacity,
        record.depth_m,
        f32::from_bits(record.instance),
    ]
}

/// The footprint in the two vectors.
#[must_use]
pub fn unpack_footprint(low: [f32; 4], high: [f32; 4]) -> Footprint {
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
pub fn load_footprint(footprints: &[[f32; 4]], record: usize) -> Footprint {
    unpack_footprint(footprints[2 * record], footprints[2 * record + 1])
}
