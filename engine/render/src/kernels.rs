//! The kernels of a frame, built when the first frame needs them.

use decouplegs_gpu::{DeviceKind, Gpu, GpuError};
use decouplegs_scene::Rules;

use crate::options::RenderOptions;
use crate::output::{ColorFormat, Outputs};
use crate::plane::{Attribute, Plane};
use crate::stages::{
    AgentVariant, Begin, Blend, BlendPass, BlendVariant, CompositeSegments, Cull, CullAgents,
    CullShadows, KeySplats, MergeLists, PixelEnd, PlanSegments, PostProcess, Project,
    ProjectAgents, ProjectVariant, Relight, ResolvePlane, Scan, TileSort, finishes,
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
}

impl ImageStages {
    fn new(
        gpu: &Gpu,
        (rules, end): (&Rules, PixelEnd),
        outputs: &Outputs,
        attributes: bool,
        segment_pairs: u32,
    ) -> Result<Self, GpuError> {
        let blend = |pass| {
            let variant = BlendVariant {
                end,
                pass,
                attributes,
                item_pairs_max: segment_pairs,
            };
            Blend::new(gpu, rules, outputs, variant)
        };
        let finishes = finishes(end, outputs) && segment_pairs < u32::MAX;
        Ok(Self {
            blend: blend(BlendPass::Segments)?,
            composite: CompositeSegments::new(gpu, end, outputs, attributes)?,
            finish: finishes.then(|| blend(BlendPass::Finish)).transpose()?,
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

/// Kernels of the planes of geometry: attributes instead of color, and their means and
/// medians.
pub(crate) struct GeometryStages {
    /// `None` where no plane is a mean.
    means: Option<ImageStages>,
    /// `None` where no plane is a median.
    medians: Option<ImageStages>,
    pub resolve: ResolvePlane,
    attributes: Vec<AttributeStages>,
}

/// Projections that write an attribute.
pub(crate) struct AttributeStages {
    attribute: Attribute,
    pub background: Project,
    /// `None` without agents.
    pub agents: Option<ProjectAgents>,
}

impl GeometryStages {
    /// Blending for `plane`.
    pub fn images(&self, plane: Plane) -> Option<&ImageStages> {
        match plane.is_median() {
            true => self.medians.as_ref(),
            false => self.means.as_ref(),
        }
    }

    /// Projections for `plane`.
    pub fn projections(&self, plane: Plane) -> Option<&AttributeStages> {
        let mut built = self.attributes.iter();
        built.find(|stages| stages.attribute == plane.attribute())
    }
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
    /// `None` where no plane of geometry is asked for.
    pub geometry: Option<GeometryStages>,
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

impl FrameVariant {
    /// The variant whose projections write an attribute instead of color. It does not depend
    /// on what colors and instances need.
    fn with_attribute(self, attribute: Attribute) -> Self {
        Self {
            background: ProjectVariant {
                sh_degree: 0,
                labels: false,
                instances: false,
                splat_ids: false,
                shadows: false,
                shadows_by_camera: false,
                cameras: self.background.cameras,
                attribute,
                fog: false,
                storage: self.background.storage,
            },
            agents: self.agents.map(|agents| AgentVariant {
                sh_degree: 0,
                labels: false,
                relit: false,
                shaded: false,
                cameras: agents.cameras,
                attribute,
                fog: false,
            }),
            ..self
        }
    }
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
        let has_planes = self.outputs.planes.geometry().next().is_some();
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
                self.images(gpu, PixelEnd::for_rules(rules), &outputs, false)?
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
            geometry: has_planes
                .then(|| self.geometry(gpu, variant))
                .transpose()?,
        })
    }

    fn images(
        &self,
        gpu: &Gpu,
        end: PixelEnd,
        outputs: &Outputs,
        attributes: bool,
    ) -> Result<ImageStages, GpuError> {
        let ends = (&self.rules, end);
        ImageStages::new(gpu, ends, outputs, attributes, self.segment_pairs)
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

    /// The kernels that the planes of geometry need.
    fn geometry(&self, gpu: &Gpu, variant: FrameVariant) -> Result<GeometryStages, GpuError> {
        let outputs = Outputs {
            color: ColorFormat::F32,
            ..Outputs::default()
        };
        let planes = || self.outputs.planes.geometry();
        let images = |end, medians: bool| {
            let is_needed = planes().any(|plane| plane.is_median() == medians);
            is_needed
                .then(|| self.images(gpu, end, &outputs, true))
                .transpose()
        };
        let mut stages = GeometryStages {
            means: images(PixelEnd::for_rules(&self.rules), false)?,
            medians: images(PixelEnd::Median, true)?,
            resolve: ResolvePlane::new(gpu)?,
            attributes: Vec::new(),
        };
        for plane in planes() {
            if stages.projections(plane).is_none() {
                let variant = variant.with_attribute(plane.attribute());
                let agents = |kind| ProjectAgents::new(gpu, &self.rules, kind);
                stages.attributes.push(AttributeStages {
                    attribute: plane.attribute(),
                    background: Project::new(gpu, &self.rules, variant.background)?,
                    agents: variant.agents.map(agents).transpose()?,
                });
            }
        }
        Ok(stages)
    }
}
