//! Alpha compositing of the segments of coarse tiles' lists.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::{EarlyStop, Rules};
use decouplegs_shaders::constants;

use super::{FrameCounters, IndirectArguments, PURPOSE, Plan, Projected, Views, least_response};
use crate::capacity::Capacity;
use crate::interfaces::blend::{Bindings, Constants, Module, Push};
use crate::layout::{COARSE_PIXELS, FINE_TILES, PartialTiles, response_squares_max};
use crate::output::{ColorFormat, OutputBuffers, Outputs};
use crate::plane::Plane;

/// Partial accumulations of segments for composite: one per pixel of the fine tiles that a segment
/// draws something in. Of length 0 where the output was not asked for.
pub struct PartialResults {
    /// Fine tiles that have results.
    pub tiles: Buffer<PartialTiles>,
    /// Color in 64 bits and transmittance, three words per pixel.
    pub colors: Buffer<u32>,
    /// Sums of the planes, all words of a pixel together: see `planes.glsl`.
    pub planes: Buffer<u32>,
    /// Bits of the largest transmittance by fine tile; zero before the frame.
    pub transmittances: Buffer<[u32; 32]>,
    /// Fine tiles with pixels that are to be finished, as bits; zero before the frame. Of length 0
    /// where nothing is finished.
    pub unfinished: Buffer<u32>,
    /// Record in which half of the light is gone, or bits of a negative transmittance: see
    /// `blend.comp`. Of length 0 where no median is asked for.
    pub medians: Buffer<u32>,
    /// Fine tiles with medians that are to be finished, likewise.
    pub medians_unfinished: Buffer<u32>,
    tiles_max: usize,
}

impl PartialResults {
    /// Buffers for as many segments and fine tiles as `capacity` says.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(
        gpu: &Gpu,
        capacity: &Capacity,
        rules: &Rules,
        outputs: &Outputs,
    ) -> Result<Self, GpuError> {
        let buffer = |name, len| gpu.buffer(name, PURPOSE, len, MemoryKind::Device);
        let if_asked = |asked: bool, len| if asked { len } else { 0 };
        let finishes = finishes(PixelEnd::for_rules(rules), outputs);
        let has_medians = outputs.planes.has_medians();
        let slots = capacity.partials;
        let pixels = capacity.tiles * (COARSE_PIXELS / FINE_TILES);
        Ok(Self {
            tiles_max: capacity.tiles,
            tiles: gpu.buffer("partial_tiles", PURPOSE, slots, MemoryKind::Device)?,
            colors: buffer("partial_colors", 3 * pixels)?,
            planes: buffer("partial_planes", pixels * outputs.partial_plane_words())?,
            transmittances: gpu.buffer(
                "partial_transmittances",
                PURPOSE,
                slots,
                MemoryKind::Device,
            )?,
            unfinished: buffer("partial_unfinished", if_asked(finishes, slots))?,
            medians: buffer("partial_medians", if_asked(has_medians, pixels))?,
            medians_unfinished: buffer("medians_unfinished", if_asked(has_medians, slots))?,
        })
    }
}

/// End of a pixel: the splat behind which nothing counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelEnd {
    /// Ends at the splat that leaves next to no light.
    Full,
    /// Ends at the last splat before the limit of an exclusive stop.
    Exclusive,
    /// Ends at the splat that reaches the limit of an inclusive stop.
    Inclusive,
}

impl PixelEnd {
    /// The end of pixels of color by `rules`.
    #[must_use]
    pub fn for_rules(rules: &Rules) -> Self {
        match rules.stop {
            EarlyStop::Exclusive => Self::Exclusive,
            EarlyStop::Inclusive => Self::Inclusive,
            EarlyStop::None => Self::Full,
        }
    }

    /// Transmittance at which a pixel ends by an early stop; `None` without one.
    #[must_use]
    pub fn stop_limit(self) -> Option<f32> {
        match self {
            Self::Full => None,
            Self::Exclusive => Some(constants::TRANSMITTANCE_MIN),
            Self::Inclusive => Some(constants::TRANSMITTANCE_MIN_INCLUSIVE),
        }
    }
}

/// True if segments of a list are blended again from what lies before them: by an early stop,
/// and where weights are counted.
#[must_use]
pub fn finishes(end: PixelEnd, outputs: &Outputs) -> bool {
    end != PixelEnd::Full || outputs.contributions
}

/// Purpose of a run of [`Blend`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendPass {
    /// Blends every segment by itself.
    Segments,
    /// Blends again what composite has left to be finished, where [`finishes`] is true.
    Finish,
    /// Finds the medians that composite has left to be finished.
    FinishMedians,
}

/// Specialization of [`Blend`], beside rules and outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlendVariant {
    /// End of a pixel.
    pub end: PixelEnd,
    /// Purpose of the run.
    pub pass: BlendPass,
    /// Pairs of an item, at most.
    pub item_pairs_max: u32,
}

/// Splats by lists.
#[derive(Clone, Copy)]
pub struct ListedSplats<'a> {
    /// Entries of the lists: indices of projected splats.
    pub records: &'a Buffer<u32>,
    /// Projected splats.
    pub projected: &'a Projected,
}

/// Segments of lists.
#[derive(Clone, Copy)]
pub struct Segments<'a> {
    /// Counts of the frame.
    pub counters: &'a FrameCounters,
    /// The plan of the work.
    pub plan: &'a Plan,
    /// Results of segments of cut lists.
    pub partials: &'a PartialResults,
}

/// Images that are drawn.
#[derive(Clone, Copy)]
pub struct Target<'a> {
    /// The images.
    pub images: &'a OutputBuffers,
    /// Color behind all splats.
    pub sky: [f32; 3],
}

/// `blend.comp`.
pub struct Blend {
    kernel: Kernel<Module>,
    pass: BlendPass,
}

impl Blend {
    /// The stage for images of the given rules and outputs.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(
        gpu: &Gpu,
        rules: &Rules,
        outputs: &Outputs,
        variant: BlendVariant,
    ) -> Result<Self, GpuError> {
        let BlendVariant {
            end,
            pass,
            item_pairs_max,
        } = variant;
        let draws = |plane| outputs.planes.contains(plane);
        let (least_response, least_response_squares) = least_response(response_squares_max(rules));
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
            alpha_max: rules.alpha_max as f32,
            log2_alpha_max: rules.alpha_max.log2() as f32,
            early_stop: end != PixelEnd::Full,
            inclusive_stop: end == PixelEnd::Inclusive,
            lanes: gpu.limits().subgroup_size,
            one_batch: item_pairs_max <= constants::BATCH,
            contributions: outputs.contributions,
            finish: pass != BlendPass::Segments,
            finish_medians: pass == BlendPass::FinishMedians,
            least_response,
            least_response_squares,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
            pass,
        })
    }

    /// Blends `segments` of the lists of `splats` into the target or partial results, and returns
    /// the segments.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        views: Views<'_>,
        splats: ListedSplats<'_>,
        segments: Segments<'a>,
        target: Target<'_>,
    ) -> Segments<'a> {
        let ListedSplats { records, projected } = splats;
        let Segments {
            counters,
            plan,
            partials,
        } = segments;
        let Target { images, sky } = target;
        let push = Push {
            sky,
            camera_count: views.count as u32,
            items_max: plan.items.len() as u32,
            tiles_max: partials.tiles_max as u32,
            contribution_scale: images.contribution_scale(),
            image_pixels: images.pixels() as u32,
        };
        let unfinished = match self.pass {
            BlendPass::FinishMedians => &partials.medians_unfinished,
            BlendPass::Segments | BlendPass::Finish => &partials.unfinished,
        };
        let bindings = Bindings {
            cameras: views.cameras.bound(),
            images_f32: images.images_f32.bound(),
            images_u8: images.images_u8.bound(),
            planes: images.planes.bound(),
            required: counters.required.bound(),
            items: plan.items.bound(),
            records: records.bound(),
            footprints: projected.footprints.bound(),
            labels: projected.labels.bound(),
            attributes: projected.attributes.bound(),
            depths: projected.depths.bound(),
            partial_colors: partials.colors.bound(),
            partial_planes: partials.planes.bound(),
            partial_transmittances: partials.transmittances.bound().cast(),
            partial_unfinished: unfinished.bound(),
            partial_medians: partials.medians.bound(),
            partial_tiles: partials.tiles.bound(),
            contributions: images.contributions.bound(),
        };
        recorder.dispatch_indirect(
            &self.kernel,
            bindings,
            push,
            &counters.arguments,
            IndirectArguments::Blend.byte_offset(),
        );
        segments
    }
}
