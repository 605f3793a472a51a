//! Record of a visible (camera, splat), written by both projections: `write_record.glsl`.

use glam::Vec3;

use super::record::{Record, pack_record_high, pack_record_low};

/// Records that projection writes; the length of `colors` is their capacity.
pub struct Records<'a> {
    /// Two per record.
    pub footprints: &'a mut [[f32; 4]],
    /// One per record.
    pub colors: &'a mut [[f32; 4]],
    /// Depth keys, one per record.
    pub keys: &'a mut [u32],
}

impl Records<'_> {
    /// Writes the record, its color and its depth key to `slot`.
    pub(super) fn write(&mut self, slot: usize, record: &Record, color: Vec3, key: u32) {
        self.footprints[2 * slot] = pack_record_low(record);
        self.footprints[2 * slot + 1] = pack_record_high(record);
        self.colors[slot] = color.extend(0.0).to_array();
        self.keys[slot] = key;
    }
}
