//! Images as bytes on the host: what a planner or an encoder takes, without a detour over floats.

use decouplegs_gpu::{Buffer, MemoryKind, QueueRole};

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
        let Some((view, buffers)) = self.shown_images() else {
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
        let mut recorder = self.gpu().record(QueueRole::Main);
        recorder.copy(&buffers.images_u8, 0, &pixels, 0, view.pixels);
        self.gpu().submit(recorder, &[])?.wait()?;
        bytes.pixels = Some(pixels);
        bytes.ranges = view.ranges();
        Ok(())
    }
}
