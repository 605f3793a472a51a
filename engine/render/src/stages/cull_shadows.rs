//! Culling of shadows on the ground, per cluster of the background.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::PURPOSE;
use crate::capacity::groups_for;
use crate::interfaces::cull_shadows::{Bindings, Constants, Module, Push};
use crate::layout::{CLUSTER_SPLATS, ShadowRecord};
use crate::resident_splats::ResidentSplats;

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

/// `cull_shadows.comp`.
pub struct CullShadows {
    kernel: Kernel<Module>,
}

impl CullShadows {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Marks which of the first `shadow_count` shadows may lie on each cluster of `background`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        background: &ResidentSplats,
        buffers: &ShadowBuffers,
        shadow_count: usize,
    ) {
        let clusters = background.cluster_count();
        let push = Push {
            cluster_count: clusters as u32,
            shadow_count: shadow_count as u32,
        };
        let bindings = Bindings {
            clusters: background.clusters.bound(),
            shadows: buffers.shadows.bound(),
            shadow_words: buffers.words.bound(),
        };
        let threads = clusters * words_for(shadow_count);
        recorder.dispatch(
            &self.kernel,
            bindings,
            push,
            groups_for(threads.div_ceil(CLUSTER_SPLATS)),
        );
    }
}
