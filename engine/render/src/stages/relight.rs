//! Codebooks in the light of their agents.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::PURPOSE;
use crate::asset_pool::{COLOR_WORDS, PoolBuffers};
use crate::capacity::groups_for;
use crate::interfaces::relight::{Bindings, Constants, Module, Push};
use crate::layout::RelightRecord;

/// Colors that one workgroup relights.
pub const RELIGHT_BLOCK: usize = 256;

/// Colors that were made for agents, as the pool holds those of assets.
pub struct RelitColors {
    /// DC coefficients.
    pub dc: Buffer<[f32; 3]>,
    /// Bands 1 to 3.
    pub bands: Buffer<[u32; COLOR_WORDS]>,
}

impl RelitColors {
    /// Room for `colors`.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, colors: usize) -> Result<Self, GpuError> {
        Ok(Self {
            dc: gpu.buffer("relit_dc", PURPOSE, colors, MemoryKind::Device)?,
            bands: gpu.buffer("relit_bands", PURPOSE, colors, MemoryKind::Device)?,
        })
    }
}

/// Codebooks that are made.
#[derive(Clone, Copy)]
pub struct RelightWork<'a> {
    /// The assets and their light.
    pub records: &'a Buffer<RelightRecord>,
    /// Number of records.
    pub count: usize,
    /// Workgroups that all of them take.
    pub groups: usize,
}

/// `relight.comp`.
pub struct Relight {
    kernel: Kernel<Module>,
}

impl Relight {
    /// The stage for colors of the given degree.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sh_degree: u8) -> Result<Self, GpuError> {
        let sh_degree = u32::from(sh_degree);
        Ok(Self {
            kernel: gpu.kernel(&Constants { sh_degree })?,
        })
    }

    /// Makes the colors that `work` asks for.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pool: &PoolBuffers,
        work: RelightWork<'_>,
        relit: &RelitColors,
    ) {
        let push = Push {
            relight_count: work.count as u32,
        };
        let bindings = Bindings {
            relights: work.records.bound(),
            coded_dc: pool.color_dc.bound(),
            coded_bands: pool.color_bands.bound().cast(),
            relit_dc: relit.dc.bound(),
            relit_bands: relit.bands.bound().cast(),
        };
        recorder.dispatch(&self.kernel, bindings, push, groups_for(work.groups));
    }
}
