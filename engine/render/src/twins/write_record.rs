//! Record of a visible (camera, splat), written by both projections: `write_record.glsl`.

use glam::Vec2;

use super::mean_px::{PixelPair, exact_mean_px, pack_mean};
use super::record::{Record, pack_record_high, pack_record_low};
use crate::layout::{CameraRecord, LensRecord};

/// The code of the mean of a projected splat whose f32 is `plain`. Through a lens and under a
/// rolling shutter, it is that.
#[must_use]
pub(super) fn code_of_mean(
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    mean_m: [f32; 3],
    plain: Vec2,
) -> [u32; 2] {
    let pair = if camera.rolls() || lens.is_some() {
        PixelPair {
            coarse: plain,
            fine: Vec2::ZERO,
        }
    } else {
        exact_mean_px(camera, mean_m)
    };
    pack_mean(pair, plain, camera.mean_shift)
}

/// Records that projection writes; the length of `labels` is their capacity.
pub struct Records<'a> {
    /// Two per record.
    pub footprints: &'a mut [[u32; 4]],
    /// Bits of the depth and instance, one per record.
    pub labels: &'a mut [[u32; 2]],
    /// Depth keys, one per record.
    pub keys: &'a mut [u32],
}

impl Records<'_> {
    /// Writes the record and its depth key to `slot`.
    pub(super) fn write(&mut self, slot: usize, record: &Record, key: u32) {
        self.footprints[2 * slot] = pack_record_low(record);
        self.footprints[2 * slot + 1] = pack_record_high(record);
        self.labels[slot] = [record.depth_m.to_bits(), record.instance];
        self.keys[slot] = key;
    }
}
