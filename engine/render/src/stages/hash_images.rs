//! Sums over the blocks of images, of which the host makes their hashes.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{kernel, push_constants};
use crate::capacity::groups_for;
use crate::image_hash::{LANES, units_of};

push_constants! {
    struct Push {
        first_pixel: u32,
        pixel_count: u32,
        first_unit: u32,
        unit_count: u32,
    }
}

/// Threads of a workgroup.
const THREADS: usize = 256;

/// `hash_images.comp`.
pub struct HashImages {
    kernel: Kernel,
}

impl HashImages {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::HASH_IMAGES, &[])?,
        })
    }

    /// Writes the sums of the image of `pixel_count` pixels from `first_pixel` of `pixels` on to
    /// unit `first_unit` of `sums`, 8 of 64 bits each. `keys` are [`crate::image_hash::keys`].
    pub fn record(
        &self,
        recorder: &mut Recorder,
        (pixels, first_pixel, pixel_count): (&Buffer<u32>, usize, usize),
        keys: &Buffer<u64>,
        (sums, first_unit): (&Buffer<u64>, usize),
    ) {
        let units = units_of(4 * pixel_count);
        let push = Push {
            first_pixel: first_pixel as u32,
            pixel_count: pixel_count as u32,
            first_unit: first_unit as u32,
            unit_count: units as u32,
        };
        let buffers = [
            ("pixels", pixels.binding()),
            ("keys", keys.binding()),
            ("sums", sums.binding()),
        ];
        let groups = groups_for((units * LANES).div_ceil(THREADS));
        recorder.dispatch(&self.kernel, &buffers, bytes_of(&push), groups);
    }
}
