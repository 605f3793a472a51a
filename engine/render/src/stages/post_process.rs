//! Post-processing of images: the sky map.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder};

use super::{kernel, push_constants};
use crate::capacity::groups_for;
use crate::layout::CameraRecord;
use crate::output::{ColorFormat, OutputBuffers, Outputs};
use crate::sky::{SkyBuffers, SkyCamera};

push_constants! {
    struct Push {
        right: [f32; 3],
        down: [f32; 3],
        forward: [f32; 3],
        camera: u32,
        face_texels: u32,
        clamps_sky: u32,
        clamps_splats: u32,
    }
}

/// `post_process.comp`.
pub struct PostProcess {
    pinhole: Kernel,
    /// Kernel for cameras that are no pinhole.
    lens: Kernel,
}

impl PostProcess {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses a kernel.
    pub fn new(gpu: &Gpu, outputs: &Outputs) -> Result<Self, GpuError> {
        let built = |lens: bool| {
            let constants = [
                ("COLOR_U8", Constant::Bool(outputs.color == ColorFormat::U8)),
                ("LENS", Constant::Bool(lens)),
            ];
            kernel::<Push>(gpu, &decouplegs_shaders::POST_PROCESS, &constants)
        };
        Ok(Self {
            pinhole: built(false)?,
            lens: built(true)?,
        })
    }

    /// Adds `sky` to `blended`, the colors of splats over black, for each of `seen_by`, and writes
    /// `images`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        cameras: &Buffer<CameraRecord>,
        seen_by: &[SkyCamera],
        sky: &SkyBuffers,
        blended: &Buffer<[f32; 4]>,
        images: &OutputBuffers,
    ) {
        let [images_f32, images_u8, _] = images.bindings();
        for (camera, view) in seen_by.iter().enumerate() {
            let [right, down, forward] = view.sky_from_camera;
            let push = Push {
                right,
                down,
                forward,
                camera: camera as u32,
                face_texels: sky.face_texels,
                clamps_sky: sky.clamps.into(),
                clamps_splats: sky.clamps_splats.into(),
            };
            let (kernel, rays) = match &view.rays {
                Some(rays) => (&self.lens, rays),
                None => (&self.pinhole, &sky.no_rays),
            };
            let bound = [
                ("cameras", cameras.binding()),
                ("blended", blended.binding()),
                ("rays", rays.binding()),
                ("sky_texels", sky.texels.binding()),
                images_f32,
                images_u8,
            ];
            let groups = groups_for(view.pixels.div_ceil(256));
            recorder.dispatch(kernel, &bound, bytes_of(&push), groups);
        }
    }
}
