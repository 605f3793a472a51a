//! Alpha compositing of the segments of coarse tiles' lists.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::{EarlyStop, Rules};
use decouplegs_shaders::constants;

use super::{
    FrameCounters, IndirectArguments, PURPOSE, Plan, Projected, Views, kernel, least_response,
    push_constants,
};
use crate::capacity::Capacity;
use crate::layout::{COARSE_PIXELS, FINE_TILES, PartialTiles, response_squares_max};
use crate::output::{OutputBuffers, Outputs};

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

    /// Specialization constants of the kernels.
    pub(super) fn constants(self) -> [(&'static str, Constant); 2] {
        [
            ("EARLY_STOP", Constant::Bool(self != Self::Full)),
            ("INCLUSIVE_STOP", Constant::Bool(self == Self::Inclusive)),
        ]
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

push_constants! {
    struct Push {
        sky: [f32; 3],
        camera_count: u32,
        items_max: u32,
        tiles_max: u32,
        contribution_scale: f32,
        image_pixels: u32,
    }
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
    kernel: Kernel,
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
        let own = [
            ("ALPHA_MAX", Constant::F32(rules.alpha_max as f32)),
            ("LANES", Constant::U32(gpu.limits().subgroup_size)),
            (
                "ONE_BATCH",
                Constant::Bool(item_pairs_max <= constants::BATCH),
            ),
            ("CONTRIBUTIONS", Constant::Bool(outputs.contributions)),
            ("FINISH", Constant::Bool(pass != BlendPass::Segments)),
            (
                "FINISH_MEDIANS",
                Constant::Bool(pass == BlendPass::FinishMedians),
            ),
        ];
        let constants: Vec<_> = (outputs.constants())
            .chain(own)
            .chain(end.constants())
            .chain(least_response(response_squares_max(rules)))
            .collect();
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::BLEND, &constants)?,
            pass,
        })
    }

    /// Blends `segments` of the lists of `splats` into the target or partial results.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        views: Views<'_>,
        splats: ListedSplats<'_>,
        segments: Segments<'_>,
        target: Target<'_>,
    ) {
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
        let [images_f32, images_u8, planes] = images.bindings();
        let buffers = [
            ("cameras", views.cameras.binding()),
            images_f32,
            images_u8,
            planes,
            ("required", counters.required.binding()),
            ("items", plan.items.binding()),
            ("records", records.binding()),
            ("footprints", projected.footprints.binding()),
            ("labels", projected.labels.binding()),
            ("attributes", projected.attributes.binding()),
            ("depths", projected.depths.binding()),
            ("partial_colors", partials.colors.binding()),
            ("partial_planes", partials.planes.binding()),
            ("partial_transmittances", partials.transmittances.binding()),
            ("partial_unfinished", unfinished.binding()),
            ("partial_medians", partials.medians.binding()),
            ("partial_tiles", partials.tiles.binding()),
            ("contributions", images.contributions.binding()),
        ];
        recorder.dispatch_indirect(
            &self.kernel,
            &buffers,
            bytes_of(&push),
            counters.arguments.binding(),
            IndirectArguments::Blend.byte_offset(),
        );
    }
}
