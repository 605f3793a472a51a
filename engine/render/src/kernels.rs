//! The kernels of a frame, built when the first frame needs them.

use decouplegs_gpu::{DeviceKind, Gpu, GpuError};
use decouplegs_scene::Rules;

use crate::options::RenderOptions;
use crate::output::{ColorFormat, Outputs};
use crate::plane::{Attribute, Plane};
use crate::stages::{
    AgentVariant, Begin, Blend, BlendPass, BlendVariant, CompositeSegments, Cull, CullAgents,
    CullShadows, KeySplats, PixelEnd, PlanSegments, PostProcess, Project, ProjectAgents,
    ProjectVariant, Relight, ResolvePlane, Scan, TileSort, finishes,
};

/// Longer segments are no segments.
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

/// Kernels of the planes of geometry: attributes in the place of color, and their means and
/// medians.
pub(crate) struct GeometryStages {
    /// `None` where no plane is a mean.
    means: Option<ImageStages>,
    /// `None` where no plane is a median.
    medians: Option<ImageStages>,
    pub resolve: ResolvePlane,
    background: Vec<(ProjectVariant, Project)>,
    agents: Vec<(AgentVariant, ProjectAgents)>,
}

impl GeometryStages {
    /// Blending for `plane`.
    pub fn images(&self, plane: Plane) -> Option<&ImageStages> {
        match plane.is_median() {
            true => self.medians.as_ref(),
            false => self.means.as_ref(),
        }
    }

    /// The projection of the background that writes an attribute.
    pub fn background(&self, variant: ProjectVariant) -> Option<&Project> {
        let mut built = self.background.iter();
        built.find_map(|(built, stage)| (*built == variant).then_some(stage))
    }

    /// The projection of agents that writes an attribute.
    pub fn agents(&self, variant: AgentVariant) -> Option<&ProjectAgents> {
        let mut built = self.agents.iter();
        built.find_map(|(built, stage)| (*built == variant).then_some(stage))
    }
}

/// All kernels of a renderer.
pub(crate) struct Kernels {
    rules: Rules,
    outputs: Outputs,
    segment_pairs: u32,
    keep_keys: bool,
    /// Limit of the background's levels of detail; 0: the finest.
    pitch_px: f32,
    common: Option<CommonStages>,
    images: Vec<(ColorFormat, ImageStages)>,
    post_process: Option<PostProcess>,
    background: Vec<(ProjectVariant, BackgroundStages)>,
    agents: Vec<(AgentVariant, AgentStages)>,
    shadows: Option<CullShadows>,
    geometry: Option<GeometryStages>,
}

/// The kernels of one frame.
#[derive(Clone, Copy)]
pub(crate) struct FrameStages<'a> {
    pub variant: FrameVariant,
    pub common: &'a CommonStages,
    pub images: &'a ImageStages,
    /// `None` where images are not post-processed.
    pub post_process: Option<&'a PostProcess>,
    pub background: &'a BackgroundStages,
    pub agents: Option<&'a AgentStages>,
    pub shadows: Option<&'a CullShadows>,
    /// `None` where no plane of geometry is asked for.
    pub geometry: Option<&'a GeometryStages>,
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
    /// The variant whose projections write an attribute in the place of color. It does not depend
    /// on what colors and instances need.
    pub fn of(self, attribute: Attribute) -> Self {
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
        let RenderOptions {
            rules,
            outputs,
            segment_pairs,
            keep_keys,
            background_pitch_px,
            ..
        } = *options;
        Self {
            rules,
            outputs,
            keep_keys,
            pitch_px: background_pitch_px.unwrap_or(0.0) as f32,
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
            geometry: None,
        }
    }

    /// Builds the kernels that the planes of geometry of `variant` need.
    fn build_geometry(&mut self, gpu: &Gpu, variant: FrameVariant) -> Result<(), GpuError> {
        if self.outputs.planes.geometry().next().is_none() {
            return Ok(());
        }
        if self.geometry.is_none() {
            let outputs = Outputs {
                color: ColorFormat::F32,
                ..Outputs::default()
            };
            let images = |end, medians: bool| {
                let mut planes = self.outputs.planes.geometry();
                let is_needed = planes.any(|plane| plane.is_median() == medians);
                let stages = || {
                    let ends = (&self.rules, end);
                    ImageStages::new(gpu, ends, &outputs, true, self.segment_pairs)
                };
                is_needed.then(stages).transpose()
            };
            self.geometry = Some(GeometryStages {
                means: images(PixelEnd::of(&self.rules), false)?,
                medians: images(PixelEnd::Median, true)?,
                resolve: ResolvePlane::new(gpu)?,
                background: Vec::new(),
                agents: Vec::new(),
            });
        }
        let Some(geometry) = &mut self.geometry else {
            return Ok(());
        };
        for plane in self.outputs.planes.geometry() {
            let variant = variant.of(plane.attribute());
            let kind = variant.background;
            if geometry.background(kind).is_none() {
                let stage = Project::new(gpu, &self.rules, kind)?;
                geometry.background.push((kind, stage));
            }
            if let Some(kind) = variant
                .agents
                .filter(|kind| geometry.agents(*kind).is_none())
            {
                let stage = ProjectAgents::new(gpu, &self.rules, kind)?;
                geometry.agents.push((kind, stage));
            }
        }
        Ok(())
    }

    /// The kernels for `variant`, those that are new built now.
    pub fn of(&mut self, gpu: &Gpu, variant: FrameVariant) -> Result<FrameStages<'_>, GpuError> {
        self.build_geometry(gpu, variant)?;
        let Self {
            rules,
            outputs,
            segment_pairs,
            keep_keys,
            pitch_px,
            ..
        } = self;
        if self.common.is_none() {
            self.common = Some(CommonStages {
                begin: Begin::new(gpu)?,
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
            let end = PixelEnd::of(rules);
            let stages = ImageStages::new(gpu, (rules, end), &outputs, false, *segment_pairs)?;
            self.images.push((color, stages));
        }
        if variant.post_processed && self.post_process.is_none() {
            self.post_process = Some(PostProcess::new(gpu, outputs)?);
        }
        let kind = variant.background;
        if !self.background.iter().any(|(built, _)| *built == kind) {
            let (cull, project) = (
                Cull::new(gpu, rules, kind.cameras, kind.storage, *pitch_px)?,
                Project::new(gpu, rules, kind)?,
            );
            self.background
                .push((kind, BackgroundStages { cull, project }));
        }
        if let Some(kind) = variant.agents
            && !self.agents.iter().any(|(built, _)| *built == kind)
        {
            let stages = AgentStages {
                cull: CullAgents::new(gpu, rules, kind.cameras)?,
                project: ProjectAgents::new(gpu, rules, kind)?,
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
            variant,
            geometry: self.geometry.as_ref(),
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
