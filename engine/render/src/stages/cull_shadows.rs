//! Culling of shadows on the ground, per cluster of the background.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::{PURPOSE, kernel, push_constants};
use crate::capacity::groups_for;
use crate::layout::{CLUSTER_SPLATS, ShadowRecord};
use crate::resident::GpuScene;

/// The shadows of a frame on the device.
pub struct ShadowBuffers {
    /// One record a shadow.
    pub shadows: Buffer<ShadowRecord>,
    /// A bit a shadow, `[cluster][word]`.
    pub words: Buffer<u32>,
}

impl ShadowBuffers {
    /// Buffers for `shadows` shadows over `clusters` clusters.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, shadows: usize, clusters: usize) -> Result<Self, GpuError> {
        Ok(Self {
            shadows: gpu.buffer("shadows", PURPOSE, shadows, MemoryKind::Device)?,
            words: gpu.buffer(
                "shadow_words",
                PURPOSE,
                clusters * words_for(shadows),
                MemoryKind::Device,
            )?,
        })
    }
}

/// Words that the bits of `shadows` shadows take.
#[must_use]
pub fn words_for(shadows: usize) -> usize {
    shadows.div_ceil(32)
}

push_constants! {
    struct Push {
        cluster_count: u32,
        shadow_count: u32,
    }
}

/// `cull_shadows.comp`.
pub struct CullShadows {
    kernel: Kernel,
}

impl CullShadows {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::CULL_SHADOWS, &[])?,
        })
    }

    /// Marks which of the first `shadow_count` shadows may lie on each cluster of `gpu_scene`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gpu_scene: &GpuScene,
        buffers: &ShadowBuffers,
        shadow_count: usize,
    ) {
        let clusters = gpu_scene.cluster_count();
        let push = Push {
            cluster_count: clusters as u32,
            shadow_count: shadow_count as u32,
        };
        let bound = [
            ("clusters", gpu_scene.clusters.binding()),
            ("shadows", buffers.shadows.binding()),
            ("shadow_words", buffers.words.binding()),
        ];
        let threads = clusters * words_for(shadow_count);
        recorder.dispatch(
            &self.kernel,
            &bound,
            bytes_of(&push),
            groups_for(threads.div_ceil(CLUSTER_SPLATS)),
        );
    }
}
