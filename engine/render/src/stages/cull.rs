//! Frustum culling: visible splats per camera.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::Rules;

use super::{CameraVariant, PURPOSE, Views, kernel, least_response, push_constants};
use crate::capacity::groups_for;
use crate::layout::{CLUSTER_SPLATS, near_m, response_squares_max};
use crate::resident::GpuScene;
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

push_constants! {
    struct Push {
        splat_count: u32,
        camera_count: u32,
        cluster_count: u32,
        pitch_px: f32,
    }
}

/// `cull.comp`.
pub struct Cull {
    kernel: Kernel,
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
        let [lenses, rolling] = cameras.constants();
        let [least, squares] = least_response(response_squares_max(rules));
        let constants = [
            ("NEAR_M", Constant::F32(near_m(rules))),
            ("ANTIALIAS", Constant::Bool(rules.antialias)),
            lenses,
            rolling,
            storage.constant(),
            least,
            squares,
        ];
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::CULL, &constants)?,
            pitch_px,
        })
    }

    /// Marks what `views` see of `gpu_scene`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gpu_scene: &GpuScene,
        views: Views<'_>,
        visible: &Visible,
    ) {
        let push = Push {
            splat_count: gpu_scene.splats as u32,
            camera_count: views.count as u32,
            cluster_count: gpu_scene.cluster_count() as u32,
            pitch_px: match gpu_scene.nodes.len() {
                0 => -1.0,
                _ => self.pitch_px,
            },
        };
        let buffers = [
            ("cameras", views.cameras.binding()),
            ("clusters", gpu_scene.clusters.binding()),
            ("nodes", gpu_scene.nodes.binding()),
            ("means_m", gpu_scene.means.binding()),
            ("shapes", gpu_scene.shapes.binding()),
            ("rotations", gpu_scene.rotations.binding()),
            ("visible_words", visible.words.binding()),
            ("visible_counts", visible.counts.binding()),
            ("lenses", views.lenses.binding()),
        ];
        recorder.dispatch(
            &self.kernel,
            &buffers,
            bytes_of(&push),
            groups_for(gpu_scene.cluster_count()),
        );
    }
}
