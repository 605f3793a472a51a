//! Images as bytes on the host: what a planner or an encoder takes, without a detour over floats.

use decouplegs_gpu::{Buffer, MemoryKind, QueueRole};
use rayon::prelude::*;

use crate::output::{ColorFormat, PURPOSE};
use crate::{RenderError, Renderer};

/// The images of a frame, four bytes per pixel: red, green, blue, alpha.
#[derive(Default)]
pub struct ImageBytes {
    /// First pixel, width and height of each.
    ranges: Vec<(usize, [u32; 2])>,
    /// The images: memory that the device writes and the host reads, kept from frame to frame. To
    /// make it takes longer than a copy.
    pixels: Option<Buffer<u32>>,
}

impl ImageBytes {
    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// Forgets the images and keeps their memory.
    pub fn clear(&mut self) {
        self.ranges.clear();
    }

    /// Width and height of image `index`, pixels.
    #[must_use]
    pub fn size_px(&self, index: usize) -> [u32; 2] {
        self.ranges[index].1
    }

    /// Image `index`, row by row from the top.
    #[must_use]
    pub fn rgba(&self, index: usize) -> &[u8] {
        let (first, [width, height]) = self.ranges[index];
        let end = first + width as usize * height as usize;
        let pixels = self.pixels.as_ref();
        let pixels = pixels.map_or(&[][..], |pixels| pixels.as_host(end));
        bytemuck::cast_slice(&pixels[first..end])
    }
}

/// Bytes that a thread adds up at once.
const SUMMED_BYTES: usize = 1 << 18;

/// Mean opacity of the lower half of an image of four bytes per pixel, 0 to 1.
///
/// # Panics
/// Panics if the image has no whole number of rows.
#[must_use]
pub fn lower_half_opacity(rgba: &[u8], height_px: u32) -> f64 {
    let rows = height_px.max(1) as usize;
    assert!(
        rgba.len().is_multiple_of(4 * rows),
        "no whole number of rows"
    );
    let lower = &rgba[rgba.len() / rows * (rows / 2)..];
    let sum_of = |piece: &[u8]| -> u64 {
        let (pixels, _) = piece.as_chunks::<4>();
        let sum: u32 = pixels.iter().map(|pixel| u32::from(pixel[3])).sum();
        u64::from(sum)
    };
    let sum: u64 = lower.par_chunks(SUMMED_BYTES).map(sum_of).sum();
    sum as f64 / (255.0 * (lower.len() / 4).max(1) as f64)
}

impl Renderer {
    /// Reads the images of the frame that was finished last into `bytes`, in the order of its
    /// cameras. None before the first frame.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory.
    ///
    /// # Panics
    /// Panics if the renderer does not store [`ColorFormat::U8`].
    pub fn read_bytes(&self, bytes: &mut ImageBytes) -> Result<(), RenderError> {
        assert!(
            self.options().outputs.color == ColorFormat::U8,
            "the images are stored as floats"
        );
        bytes.ranges.clear();
        let (Some((view, buffers)), Some(frame)) = (self.shown_images(), self.shown_frame()) else {
            return Ok(());
        };
        let has_room = |pixels: &Buffer<u32>| pixels.len() >= view.pixels;
        let pixels = match bytes.pixels.take().filter(has_room) {
            Some(pixels) => pixels,
            None => {
                let (gpu, kind) = (self.gpu(), MemoryKind::Readback);
                gpu.buffer("staged_images", PURPOSE, view.pixels, kind)?
            }
        };
        // On the main queue it would wait for the next frame, which may be in flight.
        let mut recorder = self.gpu().record(QueueRole::Update);
        recorder.copy(&buffers.images_u8, 0, &pixels, 0, view.pixels);
        self.gpu().submit(recorder, &[frame])?.wait()?;
        bytes.pixels = Some(pixels);
        bytes.ranges = view.ranges();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lower_half_alone_tells_its_opacity() {
        // Two columns and five rows: the last three count.
        let mut rgba = vec![255; 4 * 2 * 5];
        for (pixel, bytes) in rgba.chunks_exact_mut(4).enumerate() {
            bytes[3] = if pixel < 4 { 0 } else { 51 * (pixel as u8 % 2) };
        }
        assert!((lower_half_opacity(&rgba, 5) - 0.1).abs() < 1e-12);
        let large = vec![255; 4 * 1000 * 700];
        assert_eq!(lower_half_opacity(&large, 700), 1.0);
    }
}
