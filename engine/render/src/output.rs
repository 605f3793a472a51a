//! Outputs of a frame, and their buffers on the device.

use std::ops::Range;

use bytemuck::Pod;
use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind};

use crate::plane::{Plane, Planes};

/// Purpose under which the memory of images is counted.
pub const PURPOSE: &str = "images";

/// Storage format of color.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum ColorFormat {
    /// Four f32: RGB as blended, unclamped, and alpha.
    #[default]
    F32,
    /// Four bytes: RGB clamped to 0 to 1 and rounded, and alpha. What a camera delivers.
    U8,
}

/// Requested outputs beside color and alpha. What is not asked for costs nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Outputs {
    /// Storage format of color.
    pub color: ColorFormat,
    /// Planes beside color.
    pub planes: Planes,
    /// The sum of each background splat's weights over all pixels
    /// ([`crate::Renderer::read_contributions`]). [`Plane::Instance`] cannot be had beside it, and
    /// agents take part as what hides the background.
    pub contributions: bool,
    /// True if another API on the device may import the images
    /// ([`crate::Renderer::take_images`]).
    pub exported: bool,
}

impl Outputs {
    /// Words per pixel of the planes in the partial result of a segment.
    pub(crate) fn partial_plane_words(&self) -> usize {
        self.planes.iter().map(Plane::partial_words).sum()
    }
}

/// Images on the device, of all cameras one after the other, rows from the top. Of length 0 where
/// not asked for.
#[derive(Clone)]
pub struct OutputBuffers {
    /// RGB over the sky, unclamped, and alpha.
    pub images_f32: Buffer<[f32; 4]>,
    /// Color and alpha in four bytes, red lowest.
    pub images_u8: Buffer<u32>,
    /// The planes that were asked for, one after the other: see [`Self::plane_words`].
    pub planes: Buffer<u32>,
    /// Sum of the weights of each background splat over all pixels, in steps of 1 /
    /// [`Self::contribution_scale`].
    pub contributions: Buffer<u32>,
    asked: Planes,
    pixels: usize,
}

impl OutputBuffers {
    /// Buffers for `pixels` pixels of a background of `splats`.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(
        gpu: &Gpu,
        pixels: usize,
        splats: usize,
        outputs: &Outputs,
    ) -> Result<Self, GpuError> {
        let (f32, u8) = (
            outputs.color == ColorFormat::F32,
            outputs.color == ColorFormat::U8,
        );
        Ok(Self {
            images_f32: image(gpu, "images_f32", if f32 { pixels } else { 0 }, outputs)?,
            images_u8: image(gpu, "images_u8", if u8 { pixels } else { 0 }, outputs)?,
            planes: image(gpu, "planes", outputs.planes.words() * pixels, outputs)?,
            contributions: gpu.buffer(
                "contributions",
                PURPOSE,
                if outputs.contributions { splats } else { 0 },
                MemoryKind::Device,
            )?,
            asked: outputs.planes,
            pixels,
        })
    }

    /// The same buffers, with color in `blended`.
    pub(crate) fn with_color_in(&self, blended: &Buffer<[f32; 4]>) -> Self {
        Self {
            images_f32: blended.clone(),
            ..self.clone()
        }
    }

    /// Steps of a contribution to 1: as many as all pixels together can be counted in.
    #[must_use]
    pub fn contribution_scale(&self) -> f32 {
        (2147483648.0 / self.pixels.max(1) as f64).min(65_536.0) as f32
    }

    /// Offset of `plane` in [`Self::planes`], words; `None` where it was not asked for.
    #[must_use]
    pub fn plane_words(&self, plane: Plane) -> Option<Range<usize>> {
        let mut first = 0;
        for asked in self.asked.iter() {
            let words = asked.channels() * self.pixels;
            if asked == plane {
                return Some(first..first + words);
            }
            first += words;
        }
        None
    }

    /// Pixels of all images together.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.pixels
    }
}

/// A buffer of `len` values that another API may import if `outputs` says so.
fn image<T: Pod>(
    gpu: &Gpu,
    name: &'static str,
    len: usize,
    outputs: &Outputs,
) -> Result<Buffer<T>, GpuError> {
    gpu.buffer(
        name,
        PURPOSE,
        len,
        if outputs.exported && len > 0 {
            MemoryKind::Exported
        } else {
            MemoryKind::Device
        },
    )
}
