//! Alpha compositing of partial results: joins the segments of cut lists.

use bytemuck::bytes_of;
use decouplegs_gpu::{Constant, Gpu, GpuError, Kernel, Recorder};

use super::{
    IndirectArguments, PixelEnd, Projected, Segments, Target, Views, kernel, push_constants,
};
use crate::output::Outputs;

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

    /// Joins the results of `segments` of lists of `projected` splats into the target.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        views: Views<'_>,
        projected: &Projected,
        segments: Segments<'_>,
        target: Target<'_>,
    ) {
        let Segments {
            counters,
            plan,
            partials,
        } = segments;
        let Target { images, sky } = target;
        let push = Push {
            sky,
            camera_count: views.count as u32,
            image_pixels: images.pixels() as u32,
        };
        let [images_f32, images_u8, planes] = images.bindings();
        let buffers = [
            ("cameras", views.cameras.binding()),
            images_f32,
            images_u8,
            planes,
            ("required", counters.required.binding()),
            ("composites", plan.composites.binding()),
            ("partial_colors", partials.colors.binding()),
            ("partial_planes", partials.planes.binding()),
            ("partial_tiles", partials.tiles.binding()),
            ("partial_unfinished", partials.unfinished.binding()),
            ("partial_transmittances", partials.transmittances.binding()),
            ("partial_medians", partials.medians.binding()),
            ("medians_unfinished", partials.medians_unfinished.binding()),
            ("depths", projected.depths.binding()),
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
