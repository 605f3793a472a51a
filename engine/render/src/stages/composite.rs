//! Alpha compositing of partial results: joins the segments of cut lists.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder};

use super::{
    FrameCounters, IndirectArguments, PartialResults, PixelEnd, Plan, kernel, push_constants,
};
use crate::layout::CameraRecord;
use crate::output::{OutputBuffers, Outputs};

push_constants! {
    struct Push {
        sky: [f32; 3],
        camera_count: u32,
        image_pixels: u32,
    }
}

/// `composite.comp`.
pub struct CompositeSegments {
    kernel: Kernel,
}

impl CompositeSegments {
    /// The stage for images whose pixels end at `end`.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, end: PixelEnd, outputs: &Outputs) -> Result<Self, GpuError> {
        let contributions = ("CONTRIBUTIONS", Constant::Bool(outputs.contributions));
        let constants: Vec<_> = (outputs.constants())
            .chain(end.constants())
            .chain([contributions])
            .collect();
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::COMPOSITE, &constants)?,
        })
    }

    /// Writes the pixels of every coarse tile that `plan` cut.
    #[expect(
        clippy::too_many_arguments,
        reason = "one argument a buffer that the stage reads or writes"
    )]
    pub fn record(
        &self,
        recorder: &mut Recorder,
        counters: &FrameCounters,
        cameras: &Buffer<CameraRecord>,
        camera_count: usize,
        sky: [f32; 3],
        plan: &Plan,
        partials: &PartialResults,
        images: &OutputBuffers,
    ) {
        let push = Push {
            sky,
            camera_count: camera_count as u32,
            image_pixels: images.pixels() as u32,
        };
        let [images_f32, images_u8, planes] = images.bindings();
        let buffers = [
            ("cameras", cameras.binding()),
            images_f32,
            images_u8,
            planes,
            ("required", counters.required.binding()),
            ("composites", plan.composites.binding()),
            ("partial_colors", partials.colors.binding()),
            ("partial_planes", partials.planes.binding()),
            ("partial_tiles", partials.tiles.binding()),
            ("partial_unfinished", partials.unfinished.binding()),
        ];
        let offset = IndirectArguments::Composite.byte_offset();
        recorder.dispatch_indirect(
            &self.kernel,
            &buffers,
            bytes_of(&push),
            counters.arguments.binding(),
            offset,
        );
    }
}
