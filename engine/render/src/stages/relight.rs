//! Codebooks in the light of their agents.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, MemoryKind, Recorder};

use super::{PURPOSE, kernel, push_constants};
use crate::asset_pool::{COLOR_WORDS, PoolBuffers};
use crate::capacity::groups_for;
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

push_constants! {
    struct Push {
        relight_count: u32,
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
    kernel: Kernel,
}

impl Relight {
    /// The stage for colors of the given degree.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sh_degree: u8) -> Result<Self, GpuError> {
        let constants = [("SH_DEGREE", Constant::U32(u32::from(sh_degree)))];
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::RELIGHT, &constants)?,
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
        let bound = [
            ("relights", work.records.binding()),
            ("coded_dc", pool.color_dc.binding()),
            ("coded_bands", pool.color_bands.binding()),
            ("relit_dc", relit.dc.binding()),
            ("relit_bands", relit.bands.binding()),
        ];
        recorder.dispatch(
            &self.kernel,
            &bound,
            bytes_of(&push),
            groups_for(work.groups),
        );
    }
}
