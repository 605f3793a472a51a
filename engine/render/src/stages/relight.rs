//! Codebooks in the light of their agents.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{PURPOSE, kernel, push_constants};
use crate::asset_pool::{COLOUR_WORDS, PoolBuffers};
use crate::capacity::groups_for;
use crate::layout::RelightRecord;

/// Colours that one workgroup relights.
pub const RELIGHT_BLOCK: usize = 256;

/// Colours that were made for agents, as the pool holds those of assets.
pub struct RelitColours {
    /// DC coefficients.
    pub dc: Buffer<[f32; 3]>,
    /// Bands 1 to 3.
    pub bands: Buffer<[u32; COLOUR_WORDS]>,
}

impl RelitColours {
    /// Room for `colours`.
    ///
    /// # Errors
    /// When the device is out of memory.
    pub fn new(gpu: &Gpu, colours: usize) -> Result<Self, GpuError> {
        Ok(Self {
            dc: gpu.buffer("relit_dc", PURPOSE, colours, Residence::Device)?,
            bands: gpu.buffer("relit_bands", PURPOSE, colours, Residence::Device)?,
        })
    }
}

push_constants! {
    struct Push {
        relight_count: u32,
    }
}

/// `relight.comp`.
pub struct Relight {
    kernel: Kernel,
}

impl Relight {
    /// The stage for colours of the given degree.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sh_degree: u8) -> Result<Self, GpuError> {
        let constants = [("SH_DEGREE", Constant::U32(u32::from(sh_degree)))];
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::RELIGHT, &constants)? })
    }

    /// Makes the colours of the first `count` of `relights`, which take `groups` workgroups in all.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pool: &PoolBuffers,
        relights: &Buffer<RelightRecord>,
        count: usize,
        groups: usize,
        relit: &RelitColours,
    ) {
        let push = Push { relight_count: count as u32 };
        let bound = [
            ("relights", relights.binding()),
            ("coded_dc", pool.colour_dc.binding()),
            ("coded_bands", pool.colour_bands.binding()),
            ("relit_dc", relit.dc.binding()),
            ("relit_bands", relit.bands.binding()),
        ];
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), groups_for(groups));
    }
}
