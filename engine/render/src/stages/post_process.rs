//! Post-processing of images: the sky map, and the photometric calibration of cameras.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::PURPOSE;
use crate::capacity::groups_for;
use crate::interfaces::post_process::{Bindings, Constants, Module, Push};
use crate::layout::CameraRecord;
use crate::output::{ColorFormat, OutputBuffers, Outputs};
use crate::post_processing::{NO_FOG, PhotometryRecord, ProcessedView, SkyBuffers};

/// Inputs of [`PostProcess`] beside the blended images.
#[derive(Clone, Copy)]
pub struct PostProcessInputs<'a> {
    /// Cameras of the frame.
    pub cameras: &'a Buffer<CameraRecord>,
    /// Photometric calibrations of those cameras.
    pub photometry: &'a Buffer<PhotometryRecord>,
    /// Views of those cameras, as post-processing needs them.
    pub views: &'a [ProcessedView],
    /// The sky map.
    pub sky: Option<&'a SkyBuffers>,
}

/// `post_process.comp`.
pub struct PostProcess {
    without_sky: Kernel<Module>,
    pinhole: Kernel<Module>,
    /// Kernel for cameras that are no pinhole.
    lens: Kernel<Module>,
    /// Buffer for rays and texels that are absent.
    none: Buffer<[f32; 3]>,
}

impl PostProcess {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses a kernel.
    pub fn new(gpu: &Gpu, outputs: &Outputs) -> Result<Self, GpuError> {
        let built = |sky: bool, lens: bool| {
            gpu.kernel(&Constants {
                color_u8: outputs.color == ColorFormat::U8,
                sky,
                lens,
            })
        };
        Ok(Self {
            without_sky: built(false, false)?,
            pinhole: built(true, false)?,
            lens: built(true, true)?,
            none: gpu.buffer("none", PURPOSE, 0, MemoryKind::Device)?,
        })
    }

    /// Adds the sky to `blended`, the colors of splats, for each view, applies the calibration of
    /// its camera, and writes `images`. Without a sky map, the color behind the splats is in
    /// `blended`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        inputs: PostProcessInputs<'_>,
        blended: &Buffer<[f32; 4]>,
        images: &OutputBuffers,
    ) {
        let PostProcessInputs {
            cameras,
            photometry,
            views,
            sky,
        } = inputs;
        for (camera, view) in views.iter().enumerate() {
            let [right, down, forward] = view.sky_from_camera;
            let push = Push {
                right,
                down,
                forward,
                camera: camera as u32,
                face_texels: sky.map_or(0, |sky| sky.face_texels),
                clamps_sky: sky.is_some_and(|sky| sky.clamps).into(),
                clamps_splats: sky.is_some_and(|sky| sky.clamps_splats).into(),
                fog: sky.map_or(NO_FOG, |sky| sky.fog),
            };
            let kernel = match (sky, &view.rays) {
                (None, _) => &self.without_sky,
                (Some(_), None) => &self.pinhole,
                (Some(_), Some(_)) => &self.lens,
            };
            let rays = view.rays.as_ref().unwrap_or(&self.none);
            let texels = sky.map_or(&self.none, |sky| &sky.texels);
            let bindings = Bindings {
                cameras: cameras.bound(),
                blended: blended.bound(),
                rays: rays.bound(),
                sky_texels: texels.bound(),
                photometry: photometry.bound(),
                images_f32: images.images_f32.bound(),
                images_u8: images.images_u8.bound(),
            };
            let groups = groups_for(view.pixels.div_ceil(256));
            recorder.dispatch(kernel, bindings, push, groups);
        }
    }
}
