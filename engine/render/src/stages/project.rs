//! Footprint, depth key and color of every visible (camera, splat).

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::{DepthOrder, Rules};

use super::{CameraVariant, KeptKeys, PURPOSE, ShadowBuffers, Views, Visible, words_for};
use crate::capacity::groups_for;
use crate::interfaces::project::{Bindings, Constants, Module, Push};
use crate::layout::{fog_vector, near_m};
use crate::output::Outputs;
use crate::plane::{Plane, Planes};
use crate::resident_splats::ResidentSplats;
use crate::storage::Storage;

/// Contents of records beside footprint, color and depth key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordContents {
    /// True if they have a depth and an instance.
    pub labels: bool,
    /// Vectors of attributes.
    pub attribute_vectors: usize,
    /// True if they have depth and range for medians.
    pub depths: bool,
}

impl RecordContents {
    /// The contents that `outputs` need.
    #[must_use]
    pub fn for_outputs(outputs: &Outputs) -> Self {
        let planes = outputs.planes;
        let labels = planes.contains(Plane::Depth) || planes.contains(Plane::Instance);
        Self {
            labels: labels || outputs.contributions,
            attribute_vectors: planes.attribute_words().div_ceil(4),
            depths: planes.has_medians(),
        }
    }
}

/// One entry per visible (camera, splat): by camera, and by splat within a camera.
pub struct Projected {
    /// Two vectors per record, 32 bytes: mean (px), slope, rate_x; rate_y, log2 opacity, color in
    /// 64 bits. See `record.glsl`.
    pub footprints: Buffer<[u32; 4]>,
    /// Bits of the depth (m), and instance. Of length 0 without [`RecordContents::labels`].
    pub labels: Buffer<[u32; 2]>,
    /// Attributes, [`RecordContents::attribute_vectors`] a record: see `attributes.glsl`.
    pub attributes: Buffer<[f32; 4]>,
    /// Depth and range, meters. Of length 0 without [`RecordContents::depths`].
    pub depths: Buffer<[f32; 2]>,
    /// Depth keys. The sort of tiles overwrites them.
    pub keys: Buffer<u32>,
}

impl Projected {
    /// Buffers for `records` entries, their keys with room for `pairs`.
    ///
    /// # Errors
    /// [`GpuError`]: the device is out of memory.
    pub fn new(
        gpu: &Gpu,
        records: usize,
        pairs: usize,
        contents: RecordContents,
    ) -> Result<Self, GpuError> {
        let device = MemoryKind::Device;
        let if_asked = |asked: bool| if asked { records } else { 0 };
        let attributes = contents.attribute_vectors * records;
        let (labels, depths) = (if_asked(contents.labels), if_asked(contents.depths));
        Ok(Self {
            footprints: gpu.buffer("footprints", PURPOSE, 2 * records, device)?,
            labels: gpu.buffer("labels", PURPOSE, labels, device)?,
            attributes: gpu.buffer("attributes", PURPOSE, attributes, device)?,
            depths: gpu.buffer("depths", PURPOSE, depths, device)?,
            keys: gpu.buffer("depth_keys", PURPOSE, records.max(pairs), device)?,
        })
    }

    /// Number of entries that there is room for.
    #[must_use]
    pub fn room(&self) -> usize {
        self.footprints.len() / 2
    }
}

/// Specialization of the kernel, beside the rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProjectVariant {
    /// Degree of the colors evaluated; bands above it are neither stored nor read.
    pub sh_degree: u8,
    /// True if records have labels.
    pub labels: bool,
    /// True if the instance of a label is that of the splat; else it is 0.
    pub instances: bool,
    /// True if it is the index of the splat instead.
    pub splat_ids: bool,
    /// True if agents throw shadows on the ground.
    pub shadows: bool,
    /// True if some shadows are not visible to all cameras.
    pub shadows_by_camera: bool,
    /// Kind of cameras.
    pub cameras: CameraVariant,
    /// Planes whose attributes and depths records hold.
    pub planes: Planes,
    /// True if there is fog.
    pub fog: bool,
    /// Storage of the splats.
    pub storage: Storage,
}

/// Inputs of [`Project`] beside world and cameras.
#[derive(Clone, Copy)]
pub struct ProjectInputs<'a> {
    /// Visible splats, as culling marks them.
    pub visible: &'a Visible,
    /// First record of each list of them.
    pub offsets: &'a Buffer<u32>,
    /// Depth keys that are kept.
    pub kept: KeptKeys<'a>,
    /// Shadows on the ground.
    pub shadows: &'a ShadowBuffers,
    /// Number of shadows.
    pub shadow_count: usize,
    /// Interval of optical flow, where it is asked for, seconds.
    pub flow_interval_s: f32,
}

/// `project.comp`.
pub struct Project {
    kernel: Kernel<Module>,
}

impl Project {
    /// The stage for images of the given rules and worlds of the given kind.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: ProjectVariant) -> Result<Self, GpuError> {
        let writes = |plane| variant.planes.contains(plane);
        let constants = Constants {
            near_m: near_m(rules),
            antialias: rules.antialias,
            sh_degree: u32::from(variant.sh_degree),
            radial: rules.order == DepthOrder::Radial,
            labels: variant.labels,
            instances: variant.instances,
            splat_ids: variant.splat_ids,
            shadows: variant.shadows,
            shadows_by_camera: variant.shadows && variant.shadows_by_camera,
            lenses: variant.cameras.lenses,
            rolling: variant.cameras.rolling,
            fog: variant.fog,
            compact: variant.storage == Storage::Compact,
            depths: variant.planes.has_medians(),
            range: writes(Plane::Range),
            normal: writes(Plane::Normal),
            flow_forward: writes(Plane::FlowForward),
            flow_backward: writes(Plane::FlowBackward),
            scene_flow: writes(Plane::SceneFlow),
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Writes a record and a depth key for every visible splat to `projected`, and returns it.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        background: &ResidentSplats,
        views: Views<'_>,
        inputs: ProjectInputs<'_>,
        projected: &'a Projected,
    ) -> &'a Projected {
        let ProjectInputs {
            visible,
            offsets,
            kept,
            shadows,
            shadow_count,
            flow_interval_s,
        } = inputs;
        let push = Push {
            splat_count: background.splats as u32,
            camera_count: views.count as u32,
            cluster_count: background.cluster_count() as u32,
            records_max: projected.room() as u32,
            shadow_word_count: words_for(shadow_count) as u32,
            flow_interval_s,
            fog: fog_vector(background.fog.as_ref()),
        };
        let bindings = Bindings {
            cameras: views.cameras.bound(),
            means_m: background.means.bound(),
            shapes: background.shapes.bound(),
            rotations: background.rotations.bound(),
            visible_words: visible.words.bound(),
            offsets: offsets.bound(),
            sh_dc: background.sh_dc.bound(),
            sh_band1: background.sh_bands[0].bound(),
            sh_band2: background.sh_bands[1].bound(),
            sh_band3: background.sh_bands[2].bound(),
            instances: background.instances.bound(),
            footprints: projected.footprints.bound(),
            labels: projected.labels.bound(),
            attributes: projected.attributes.bound(),
            depths: projected.depths.bound(),
            keys: projected.keys.bound(),
            key_sets: kept.sets.bound(),
            kept_keys: kept.keys.bound(),
            shadows: shadows.shadows.bound(),
            shadow_words: shadows.words.bound(),
            lenses: views.lenses.bound(),
        };
        recorder.dispatch(
            &self.kernel,
            bindings,
            push,
            groups_for(background.cluster_count()),
        );
        projected
    }
}
