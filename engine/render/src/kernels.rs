//! The kernels of a frame, built when the first frame needs them.

use decouplegs_gpu::{DeviceKind, Gpu, GpuError};
use decouplegs_scene::Rules;

use crate::options::RenderOptions;
use crate::output::{ColorFormat, Outputs};
use crate::stages::{
    Blend, BlendPass, CompositeSegments, Cull, CullAgents, CullShadows, KeySplats, PlanSegments,
    PostProcess, Project, ProjectAgents, ProjectVariant, Relight, Scan, TileSort, finishes,
};

/// Longer segments are no segments.
const SEGMENT_PAIRS_MAX: u32 = 1 << 24;

/// Longest segment that a software device blends: llvmpipe ends all loops of a thread after 65,535
/// rounds in total, silently, and a thread of blend generates to two per entry of a segment.
const SEGMENT_PAIRS_MAX_IN_SOFTWARE: u32 = 10_000;

/// Kernels that every frame runs.
pub(crate) struct CommonStages {
    pub scan: Scan,
    /// `None` where no depth keys are kept.
    pub key_splats: Option<KeySplats>,
    pub tile_sort: TileSort,
    pub plan_segments: PlanSegments,
}

/// Kernels that make images of sorted lists, for one format of color.
pub(crate) struct ImageStages {
    pub blend: Blend,
    pub composite: CompositeSegments,
    /// Blends again the segments in which pixels end, where that depends on what lies before them.
    pub finish: Option<Blend>,
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

/// All kernels of a renderer.
pub(crate) struct Kernels {
    rules: Rules,
    outputs: Outputs,
    segment_pairs: u32,
    keep_keys: bool,
    common: Option<CommonStages>,
    images: Vec<(ColorFormat, ImageStages)>,
    post_process: Option<PostProcess>,
    background: Vec<(ProjectVariant, BackgroundStages)>,
    agents: Vec<(AgentVariant, AgentStages)>,
    shadows: Option<CullShadows>,
}

/// The kernels of one frame.
#[derive(Clone, Copy)]
pub(crate) struct FrameStages<'a> {
    pub common: &'a CommonStages,
    pub images: &'a ImageStages,
    /// `None` where images are not post-processed.
    pub post_process: Option<&'a PostProcess>,
    pub background: &'a BackgroundStages,
    pub agents: Option<&'a AgentStages>,
    pub shadows: Option<&'a CullShadows>,
}

/// Specialization of the agents' kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct AgentVariant {
    /// Degree of their colors.
    pub sh_degree: u8,
    /// True if some agents are relit.
    pub relit: bool,
    /// True if some camera is not a pinhole.
    pub lenses: bool,
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
        let RenderOptions {
            rules,
            outputs,
            segment_pairs,
            keep_keys,
            ..
        } = *options;
        Self {
            rules,
            outputs,
            keep_keys,
            segment_pairs: match device {
                DeviceKind::Cpu => segment_pairs.clamp(1, SEGMENT_PAIRS_MAX_IN_SOFTWARE),
                _ if segment_pairs > SEGMENT_PAIRS_MAX => u32::MAX,
                _ => segment_pairs.max(1),
            },
            common: None,
            images: Vec::new(),
            post_process: None,
            background: Vec::new(),
            agents: Vec::new(),
            shadows: None,
        }
    }

    /// The kernels for `variant`, those that are new built now.
    pub fn of(&mut self, gpu: &Gpu, variant: FrameVariant) -> Result<FrameStages<'_>, GpuError> {
        let Self {
            rules,
            outputs,
            segment_pairs,
            keep_keys,
            ..
        } = self;
        if self.common.is_none() {
            self.common = Some(CommonStages {
                scan: Scan::new(gpu)?,
                key_splats: keep_keys.then(|| KeySplats::new(gpu)).transpose()?,
                tile_sort: TileSort::new(gpu, rules)?,
                plan_segments: PlanSegments::new(gpu, *segment_pairs)?,
            });
        }
        // What is post-processed is not rounded before.
        let color = match variant.post_processed {
            true => ColorFormat::F32,
            false => outputs.color,
        };
        if !self.images.iter().any(|(built, _)| *built == color) {
            let outputs = Outputs { color, ..*outputs };
            let blend = |pass| Blend::new(gpu, rules, &outputs, pass, *segment_pairs);
            let finish = finishes(rules, &outputs) && *segment_pairs < u32::MAX;
            let stages = ImageStages {
                blend: blend(BlendPass::Segments)?,
                composite: CompositeSegments::new(gpu, rules, &outputs)?,
                finish: if finish {
                    Some(blend(BlendPass::Finish)?)
                } else {
                    None
                },
            };
            self.images.push((color, stages));
        }
        if variant.post_processed && self.post_process.is_none() {
            self.post_process = Some(PostProcess::new(gpu, outputs)?);
        }
        let kind = variant.background;
        if !self.background.iter().any(|(built, _)| *built == kind) {
            let (cull, project) = (
                Cull::new(gpu, rules, kind.lenses)?,
                Project::new(gpu, rules, kind)?,
            );
            self.background
                .push((kind, BackgroundStages { cull, project }));
        }
        if let Some(kind) = variant.agents
            && !self.agents.iter().any(|(built, _)| *built == kind)
        {
            let stages = AgentStages {
                cull: CullAgents::new(gpu, rules, kind.lenses)?,
                project: ProjectAgents::new(gpu, rules, kind.sh_degree, kind.relit, kind.lenses)?,
                relight: if kind.relit {
                    Some(Relight::new(gpu, kind.sh_degree)?)
                } else {
                    None
                },
            };
            self.agents.push((kind, stages));
        }
        if variant.background.shadows && self.shadows.is_none() {
            self.shadows = Some(CullShadows::new(gpu)?);
        }
        let built = |what| GpuError::Driver {
            call: "building kernels",
            code: format!("{what} was not built"),
        };
        Ok(FrameStages {
            common: self.common.as_ref().ok_or_else(|| built("a stage"))?,
            images: self
                .images
                .iter()
                .find_map(|(built, stages)| (*built == color).then_some(stages))
                .ok_or_else(|| built("blending"))?,
            post_process: self
                .post_process
                .as_ref()
                .filter(|_| variant.post_processed),
            background: self
                .background
                .iter()
                .find_map(|(built, stages)| (*built == variant.background).then_some(stages))
                .ok_or_else(|| built("the background's projection"))?,
            agents: self
                .agents
                .iter()
                .find_map(|(built, stages)| (Some(*built) == variant.agents).then_some(stages)),
            shadows: self.shadows.as_ref().filter(|_| variant.background.shadows),
        })
    }
}
