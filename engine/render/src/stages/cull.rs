//! Frustum culling: visible splats per camera.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::Rules;

use super::{CameraVariant, PURPOSE, Views, least_response};
use crate::capacity::groups_for;
use crate::interfaces::cull::{Bindings, Constants, Module, Push};
use crate::layout::{CLUSTER_SPLATS, near_m, response_squares_max};
use crate::resident_splats::ResidentSplats;
use crate::storage::Storage;

/// Per-(camera, cluster) visibility bit mask and count.
pub struct Visible {
    /// One bit per splat, `[camera][cluster][8 words]`.
    pub words: Buffer<u32>,
    /// Visible splats a `[camera][cluster]`.
    pub counts: Buffer<u32>,
}

impl Visible {
    /// Buffers for a world of `clusters` seen by `cameras`.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, cameras: usize, clusters: usize) -> Result<Self, GpuError> {
        let lists = cameras * clusters;
        Ok(Self {
            words: gpu.buffer(
                "visible_words",
                PURPOSE,
                lists * CLUSTER_SPLATS / 32,
                MemoryKind::Device,
            )?,
            counts: gpu.buffer("visible_counts", PURPOSE, lists, MemoryKind::Device)?,
        })
    }
}

/// `cull.comp`.
pub struct Cull {
    kernel: Kernel<Module>,
    pitch_px: f32,
}

impl Cull {
    /// The stage for images of the given rules and `cameras`, and for worlds of the given storage.
    /// Of worlds with levels of detail it marks those that `pitch_px` allows; 0: the finest.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(
        gpu: &Gpu,
        rules: &Rules,
        cameras: CameraVariant,
        storage: Storage,
        pitch_px: f32,
    ) -> Result<Self, GpuError> {
        let (least_response, least_response_squares) = least_response(response_squares_max(rules));
        let constants = Constants {
            near_m: near_m(rules),
            antialias: rules.antialias,
            lenses: cameras.lenses,
            rolling: cameras.rolling,
            compact: storage == Storage::Compact,
            least_response,
            least_response_squares,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
            pitch_px,
        })
    }

    /// Marks what `views` see of `background` in `visible`, and returns it.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        background: &ResidentSplats,
        views: Views<'_>,
        visible: &'a Visible,
    ) -> &'a Visible {
        let push = Push {
            splat_count: background.splats as u32,
            camera_count: views.count as u32,
            cluster_count: background.cluster_count() as u32,
            pitch_px: match background.nodes.len() {
                0 => -1.0,
                _ => self.pitch_px,
            },
        };
        let bindings = Bindings {
            cameras: views.cameras.bound(),
            clusters: background.clusters.bound(),
            nodes: background.nodes.bound(),
            means_m: background.means.bound(),
            shapes: background.shapes.bound(),
            rotations: background.rotations.bound(),
            visible_words: visible.words.bound(),
            visible_counts: visible.counts.bound(),
            lenses: views.lenses.bound(),
        };
        recorder.dispatch(
            &self.kernel,
            bindings,
            push,
            groups_for(background.cluster_count()),
        );
        visible
    }
}
