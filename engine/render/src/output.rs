//! Outputs of a frame, and their buffers on the device.

use bytemuck::Pod;
use decouplegs_gpu::{Bound, Buffer, Constant, Gpu, GpuError, MemoryKind};

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
    /// Expected depth along z (or distance, where the order is radial), meters; 0 where nothing was
    /// hit.
    pub depth: bool,
    /// Instance of the splat with the largest weight; 0 is the background.
    pub instance: bool,
    /// The sum of each background splat's weights over all pixels
    /// ([`crate::Renderer::read_contributions`]). Instances cannot be had beside it, and agents
    /// take part as what hides the background.
    pub contributions: bool,
    /// True if another API on the device may import the images
    /// ([`crate::Renderer::take_images`]).
    pub exported: bool,
}

impl Outputs {
    pub(crate) fn constants(&self) -> [(&'static str, Constant); 3] {
        [
            ("COLOR_U8", Constant::Bool(self.color == ColorFormat::U8)),
            ("DEPTH", Constant::Bool(self.depth)),
            ("INSTANCE", Constant::Bool(self.instance)),
        ]
    }
}

/// Images on the device, of all cameras one after the other, rows from the top. Of length 0 where
/// not asked for.
#[derive(Clone)]
pub struct OutputBuffers {
    /// RGB over the sky, unclamped, and alpha.
    pub images_f32: Buffer<[f32; 4]>,
    /// The same in four bytes, red lowest.
    pub images_u8: Buffer<u32>,
    /// Expected depth, meters.
    pub depths_m: Buffer<f32>,
    /// Instance of the splat with the largest weight.
    pub instance_ids: Buffer<u32>,
    /// Sum of the weights of each background splat over all pixels, in steps of 1 /
    /// [`Self::contribution_scale`].
    pub contributions: Buffer<u32>,
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
            images_f32: image(gpu, "images_f32", f32, pixels, outputs)?,
            images_u8: image(gpu, "images_u8", u8, pixels, outputs)?,
            depths_m: image(gpu, "depths_m", outputs.depth, pixels, outputs)?,
            instance_ids: image(gpu, "instance_ids", outputs.instance, pixels, outputs)?,
            contributions: gpu.buffer(
                "contributions",
                PURPOSE,
                if outputs.contributions { splats } else { 0 },
                MemoryKind::Device,
            )?,
            pixels,
        })
    }

    /// Steps of a contribution to 1: as many as all pixels together can be counted in.
    #[must_use]
    pub fn contribution_scale(&self) -> f32 {
        (2147483648.0 / self.pixels.max(1) as f64).min(65_536.0) as f32
    }

    pub(crate) fn bindings(&self) -> [(&'static str, Bound<'_>); 4] {
        [
            ("images_f32", self.images_f32.binding()),
            ("images_u8", self.images_u8.binding()),
            ("depths_m", self.depths_m.binding()),
            ("instance_ids", self.instance_ids.binding()),
        ]
    }
}

/// A buffer for a value of each pixel, of length 0 where it is not asked for.
fn image<T: Pod>(
    gpu: &Gpu,
    name: &'static str,
    asked: bool,
    pixels: usize,
    outputs: &Outputs,
) -> Result<Buffer<T>, GpuError> {
    let len = if asked { pixels } else { 0 };
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
