//! The kernels of a frame, built when the first frame needs them.

use decouplegs_gpu::{DeviceKind, Gpu, GpuError};
use decouplegs_scene::Rules;

use crate::options::RenderOptions;
use crate::output::{ColorFormat, Outputs};
use crate::stages::{
    AgentVariant, Begin, Blend, BlendPass, BlendVariant, CompositeSegments, Cull, CullAgents,
    CullShadows, KeySplats, MergeLists, PixelEnd, PlanSegments, PostProcess, Project,
    ProjectAgents, ProjectVariant, Relight, Scan, TileSort, finishes,
};

/// Largest number of pairs of a segment.
const SEGMENT_PAIRS_MAX: u32 = 1 << 24;

/// Longest segment that a software device blends: llvmpipe ends all loops of a thread after 65,535
/// rounds in total, silently, and a thread of blend generates to two per entry of a segment.
const SEGMENT_PAIRS_MAX_IN_SOFTWARE: u32 = 10_000;

/// Kernels that every frame runs.
pub(crate) struct CommonStages {
    pub begin: Begin,
    pub scan: Scan,
    /// `None` where no depth keys are kept.
    pub key_splats: Option<KeySplats>,
    pub tile_sort: TileSort,
    /// `None` where no lists are kept.
    pub merge_lists: Option<MergeLists>,
    pub plan_segments: PlanSegments,
}

/// Kernels that make images of sorted lists, for one format of color.
pub(crate) struct ImageStages {
    pub blend: Blend,
    pub composite: CompositeSegments,
    /// Blends again the segments in which pixels end, where that depends on what lies before them.
    pub finish: Option<Blend>,
    /// Finds medians likewise; `None` where no median is asked for.
    pub finish_medians: Option<Blend>,
}

impl ImageStages {
    fn new(
        gpu: &Gpu,
        rules: &Rules,
        outputs: &Outputs,
        segment_pairs: u32,
    ) -> Result<Self, GpuError> {
        let end = PixelEnd::for_rules(rules);
        let blend = |pass| {
            let variant = BlendVariant {
                end,
                pass,
                item_pairs_max: segment_pairs,
            };
            Blend::new(gpu, rules, outputs, variant)
        };
        let cuts = segment_pairs < u32::MAX;
        let finishes = finishes(end, outputs) && cuts;
        let finishes_medians = outputs.planes.has_medians() && cuts;
        Ok(Self {
            blend: blend(BlendPass::Segments)?,
            composite: CompositeSegments::new(gpu, end, outputs)?,
            finish: finishes.then(|| blend(BlendPass::Finish)).transpose()?,
            finish_medians: finishes_medians
                .then(|| blend(BlendPass::FinishMedians))
                .transpose()?,
        })
    }
}

/// Kernels for one kind of background.
pub(crate) struct BackgroundStages {
    pub cull: Cull,
    pub project: Project,
}

/// Additional kernels for frames with agents.
pub(crate) struct AgentStages {
    pub cull: CullAgents,
    pub project: ProjectAgents,
    /// Kernel that relights agents.
    pub relight: Option<Relight>,
}

/// All kernels of a renderer, by the kind of frame.
pub(crate) struct Kernels {
    options: KernelOptions,
    built: Vec<FrameStages>,
}

/// Options of a renderer that kernels depend on.
struct KernelOptions {
    rules: Rules,
    outputs: Outputs,
    segment_pairs: u32,
    keep_keys: bool,
    keep_lists: bool,
    /// Limit of the background's levels of detail; 0: the finest.
    pitch_px: f32,
}

/// The kernels of one kind of frame.
pub(crate) struct FrameStages {
    variant: FrameVariant,
    pub common: CommonStages,
    pub images: ImageStages,
    /// `None` where images are not post-processed.
    pub post_process: Option<PostProcess>,
    pub background: BackgroundStages,
    /// `None` without agents.
    pub agents: Option<AgentStages>,
    /// `None` without shadows.
    pub shadows: Option<CullShadows>,
}

/// Specialization of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameVariant {
    pub background: ProjectVariant,
    /// True if images are post-processed: there is a sky map, or a camera has a calibration.
    pub post_processed: bool,
    /// `None` without agents.
    pub agents: Option<AgentVariant>,
}

impl Kernels {
    /// For images as `options` say; nothing is built yet.
    pub fn new(options: &RenderOptions, device: DeviceKind) -> Self {
        let segment_pairs = options.segment_pairs;
        let options = KernelOptions {
            rules: options.rules,
            outputs: options.outputs,
            keep_keys: options.keep_keys,
            keep_lists: options.keep_lists,
            pitch_px: options.background_pitch_px.unwrap_or(0.0) as f32,
            segment_pairs: match device {
                DeviceKind::Cpu => segment_pairs.clamp(1, SEGMENT_PAIRS_MAX_IN_SOFTWARE),
                _ if segment_pairs > SEGMENT_PAIRS_MAX => u32::MAX,
                _ => segment_pairs.max(1),
            },
        };
        Self {
            options,
            built: Vec::new(),
        }
    }

    /// The kernels for `variant`. The device shares those that other variants have, too.
    pub fn stages(&mut self, gpu: &Gpu, variant: FrameVariant) -> Result<&FrameStages, GpuError> {
        let is_wanted = |stages: &FrameStages| stages.variant == variant;
        let index = match self.built.iter().position(is_wanted) {
            Some(index) => index,
            None => {
                self.built.push(self.options.build(gpu, variant)?);
                self.built.len() - 1
            }
        };
        Ok(&self.built[index])
    }
}

impl KernelOptions {
    fn build(&self, gpu: &Gpu, variant: FrameVariant) -> Result<FrameStages, GpuError> {
        let (rules, background) = (&self.rules, variant.background);
        Ok(FrameStages {
            variant,
            common: CommonStages {
                begin: Begin::new(gpu)?,
                scan: Scan::new(gpu)?,
                key_splats: self.keep_keys.then(|| KeySplats::new(gpu)).transpose()?,
                tile_sort: TileSort::new(gpu, rules)?,
                merge_lists: self.keep_lists.then(|| MergeLists::new(gpu)).transpose()?,
                plan_segments: PlanSegments::new(gpu, self.segment_pairs)?,
            },
            images: {
                // What is post-processed is not rounded before.
                let color = match variant.post_processed {
                    true => ColorFormat::F32,
                    false => self.outputs.color,
                };
                let outputs = Outputs {
                    color,
                    ..self.outputs
                };
                ImageStages::new(gpu, rules, &outputs, self.segment_pairs)?
            },
            post_process: (variant.post_processed)
                .then(|| PostProcess::new(gpu, &self.outputs))
                .transpose()?,
            background: BackgroundStages {
                cull: Cull::new(
                    gpu,
                    rules,
                    background.cameras,
                    background.storage,
                    self.pitch_px,
                )?,
                project: Project::new(gpu, rules, background)?,
            },
            agents: (variant.agents)
                .map(|kind| self.agents(gpu, kind))
                .transpose()?,
            shadows: (background.shadows)
                .then(|| CullShadows::new(gpu))
                .transpose()?,
        })
    }

    fn agents(&self, gpu: &Gpu, kind: AgentVariant) -> Result<AgentStages, GpuError> {
        Ok(AgentStages {
            cull: CullAgents::new(gpu, &self.rules, kind.cameras)?,
            project: ProjectAgents::new(gpu, &self.rules, kind)?,
            relight: (kind.relit)
                .then(|| Relight::new(gpu, kind.sh_degree))
                .transpose()?,
        })
    }
}
