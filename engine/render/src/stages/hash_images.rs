//! Sums over the blocks of images, of which the host makes their hashes.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use crate::capacity::groups_for;
use crate::interfaces::hash_images::{Bindings, Constants, Module, Push};

/// Sums of a block.
pub const LANES: usize = 8;
/// Bytes of a piece, and of a block.
pub(crate) const PIECE_BYTES: usize = 1 << 20;
const BLOCK_BYTES: usize = 1024;

/// Units of a piece: its whole blocks, what is left of stripes before its last byte, and its last
/// 64 bytes.
pub(crate) fn units_of_piece(bytes: usize) -> usize {
    (bytes - 1) / BLOCK_BYTES + 2
}

/// Lengths of the pieces of an image, bytes.
pub(crate) fn pieces(bytes: usize) -> impl Iterator<Item = usize> {
    (0..bytes)
        .step_by(PIECE_BYTES)
        .map(move |first| PIECE_BYTES.min(bytes - first))
}

/// Units of an image of `bytes` bytes.
pub(crate) fn units_of(bytes: usize) -> usize {
    pieces(bytes).map(units_of_piece).sum()
}

/// Image that is hashed: `pixel_count` of `pixels` from `first_pixel` on.
#[derive(Clone, Copy)]
pub struct HashedImage<'a> {
    /// Four bytes per pixel.
    pub pixels: &'a Buffer<u32>,
    /// Index of its first pixel.
    pub first_pixel: usize,
    /// Number of its pixels.
    pub pixel_count: usize,
}

/// Sums of images.
#[derive(Clone, Copy)]
pub struct ImageSums<'a> {
    /// Keys of the hash ([`crate::image_hash::keys`]).
    pub keys: &'a Buffer<u64>,
    /// Sums of units, [`LANES`] each.
    pub sums: &'a Buffer<u64>,
    /// Index of the unit that is written first.
    pub first_unit: usize,
}

/// Threads of a workgroup.
const THREADS: usize = 256;

/// `hash_images.comp`.
pub struct HashImages {
    kernel: Kernel<Module>,
}

impl HashImages {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Writes the sums of `image` to `to`.
    pub fn record(&self, recorder: &mut Recorder, image: HashedImage<'_>, to: ImageSums<'_>) {
        let units = units_of(4 * image.pixel_count);
        let push = Push {
            first_pixel: image.first_pixel as u32,
            pixel_count: image.pixel_count as u32,
            first_unit: to.first_unit as u32,
            unit_count: units as u32,
        };
        let bindings = Bindings {
            pixels: image.pixels.bound(),
            keys: to.keys.bound().cast(),
            sums: to.sums.bound().cast(),
        };
        let groups = groups_for((units * LANES).div_ceil(THREADS));
        recorder.dispatch(&self.kernel, bindings, push, groups);
    }
}
