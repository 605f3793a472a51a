//! Alpha compositing of partial results: joins the segments of cut lists.

use decouplegs_gpu::{Gpu, GpuError, Kernel, Recorder};

use super::{IndirectArguments, PixelEnd, Projected, Segments, Target, Views};
use crate::interfaces::composite::{Bindings, Constants, Module, Push};
use crate::output::{ColorFormat, Outputs};
use crate::plane::Plane;

/// `composite.comp`.
pub struct CompositeSegments {
    kernel: Kernel<Module>,
}

impl CompositeSegments {
    /// The stage for images whose pixels end at `end`.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, end: PixelEnd, outputs: &Outputs) -> Result<Self, GpuError> {
        let draws = |plane| outputs.planes.contains(plane);
        let constants = Constants {
            color_u8: outputs.color == ColorFormat::U8,
            depth: draws(Plane::Depth),
            instance: draws(Plane::Instance),
            range: draws(Plane::Range),
            normal: draws(Plane::Normal),
            flow_forward: draws(Plane::FlowForward),
            flow_backward: draws(Plane::FlowBackward),
            scene_flow: draws(Plane::SceneFlow),
            depth_median: draws(Plane::DepthMedian),
            range_median: draws(Plane::RangeMedian),
            early_stop: end != PixelEnd::Full,
            inclusive_stop: end == PixelEnd::Inclusive,
            contributions: outputs.contributions,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Joins the results of `segments` of lists of `projected` splats into the target. Returns the
    /// segments, with marks on what is to be finished.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        views: Views<'_>,
        projected: &Projected,
        segments: Segments<'a>,
        target: Target<'_>,
    ) -> Segments<'a> {
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
        let bindings = Bindings {
            cameras: views.cameras.bound(),
            images_f32: images.images_f32.bound(),
            images_u8: images.images_u8.bound(),
            planes: images.planes.bound(),
            required: counters.required.bound(),
            composites: plan.composites.bound(),
            partial_colors: partials.colors.bound(),
            partial_planes: partials.planes.bound(),
            partial_tiles: partials.tiles.bound(),
            partial_unfinished: partials.unfinished.bound(),
            partial_transmittances: partials.transmittances.bound().cast(),
            partial_medians: partials.medians.bound(),
            medians_unfinished: partials.medians_unfinished.bound(),
            depths: projected.depths.bound(),
        };
        let offset = IndirectArguments::Composite.byte_offset();
        recorder.dispatch_indirect(&self.kernel, bindings, push, &counters.arguments, offset);
        segments
    }
}
