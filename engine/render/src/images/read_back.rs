//! Images from the device to the host.

use crate::plane::PlaneValues;
use crate::rendered_image::Image;
use crate::{RenderError, Renderer};

impl Renderer {
    /// The images of the frame that was finished last, one per camera, in the order the cameras
    /// were given.
    ///
    /// Colors of [`crate::ColorFormat::U8`] come back as multiples of 1/255. Empty before the first
    /// frame, and once its place is taken by a frame submitted later
    /// (`RenderOptions::frames_in_flight`).
    ///
    /// # Errors
    /// Returns an error if the device was lost.
    pub fn read_images(&self) -> Result<Vec<Image>, RenderError> {
        let Some((view, buffers)) = self.shown_images() else {
            return Ok(Vec::new());
        };
        let pixels: Vec<[f32; 4]> = match self.options().outputs.color {
            crate::ColorFormat::F32 => self.gpu().read(&buffers.images_f32)?,
            crate::ColorFormat::U8 => {
                let words = self.gpu().read(&buffers.images_u8)?;
                words
                    .iter()
                    .map(|word| word.to_le_bytes().map(|byte| f32::from(byte) / 255.0))
                    .collect()
            }
        };
        let outputs = self.options().outputs;
        let words: Vec<u32> = if outputs.planes.is_empty() {
            Vec::new()
        } else {
            self.gpu().read(&buffers.planes)?
        };
        let images = view.cameras.iter().map(|camera| {
            let range = camera.first_pixel as usize..camera.first_pixel as usize + camera.pixels();
            Image {
                width: camera.size_px[0],
                height: camera.size_px[1],
                rgb: pixels[range.clone()]
                    .iter()
                    .map(|pixel| [pixel[0], pixel[1], pixel[2]])
                    .collect(),
                alpha: pixels[range.clone()].iter().map(|pixel| pixel[3]).collect(),
                planes: (outputs.planes.iter())
                    .filter_map(|plane| {
                        let channels = plane.channels();
                        let own = channels * range.start..channels * range.end;
                        let own = &words[buffers.plane_words(plane)?][own];
                        Some((plane, PlaneValues::new(plane, own)))
                    })
                    .collect(),
            }
        });
        Ok(images.collect())
    }
}
