//! Images as bytes on the host: what a planner or an encoder takes, without a detour over floats.

use decouplegs_gpu::{Buffer, MemoryKind, QueueRole};
use rayon::prelude::*;

use crate::output::{ColorFormat, PURPOSE};
use crate::{RenderError, Renderer};

/// Pixels that a thread copies at once: a megabyte.
const COPY_PIXELS: usize = 1 << 18;

/// The images of a frame, four bytes per pixel: red, green, blue, alpha.
#[derive(Default)]
pub struct ImageBytes {
    words: Vec<u32>,
    /// First pixel, width and height of each.
    ranges: Vec<(usize, [u32; 2])>,
    /// Memory that the device writes and the host reads, kept from frame to frame: to make it takes
    /// longer than a copy.
    staging: Option<Buffer<u32>>,
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
        bytemuck::cast_slice(&self.words[first..first + width as usize * height as usize])
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
        if bytes
            .staging
            .as_ref()
            .is_none_or(|staging| staging.len() < view.pixels)
        {
            bytes.staging = Some(self.gpu().buffer(
                "staged_images",
                PURPOSE,
                view.pixels,
                MemoryKind::Readback,
            )?);
        }
        if let Some(staging) = &bytes.staging {
            let mut recorder = self.gpu().record(QueueRole::Main);
            recorder.copy(&buffers.images_u8, 0, staging, 0, view.pixels);
            self.gpu().submit(recorder, &[])?.wait()?;
            bytes.words.resize(view.pixels, 0);
            // One thread alone copies tens of megabytes in milliseconds.
            let pieces = bytes.words.par_chunks_mut(COPY_PIXELS);
            staging.with_host(view.pixels, |host| {
                pieces
                    .zip(host.par_chunks(COPY_PIXELS))
                    .for_each(|(to, from)| to.copy_from_slice(from));
            });
        }
        bytes.ranges = view.ranges();
        Ok(())
    }
}
