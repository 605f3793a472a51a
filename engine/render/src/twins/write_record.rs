//! Record of a visible (camera, splat), written by both projections: `write_record.glsl`.

use glam::Vec3;

use super::record::{Record, pack_record_high, pack_record_low};

/// Writes the record and its color to `slot`.
pub fn write_record(
    slot: usize,
    record: &Record,
    color: Vec3,
    footprints: &mut [[f32; 4]],
    colors: &mut [[f32; 4]],
) {
    footprints[2 * slot] = pack_record_low(record);
    footprints[2 * slot + 1] = pack_record_high(record);
    colors[slot] = color.extend(0.0).to_array();
}
