//! Kernels of an open device, built once for all renderers that use them.

use std::sync::{Arc, Mutex, PoisonError};

use decouplegs_spirv::Kind;
use xxhash_rust::xxh3::xxh3_128;

use super::{Constant, Kernel};
use crate::{GpuError, KernelReport, context::Context};

/// Kernels kept at most. A renderer uses about 30, and settings of a scene change some of them.
const KEPT_MAX: usize = 256;

/// Kernels that were built, the last used ones last.
#[derive(Default)]
pub(crate) struct Kernels(Mutex<Vec<(Key, Kernel)>>);

/// Everything that a kernel is built from.
#[derive(PartialEq, Eq)]
struct Key {
    name: &'static str,
    /// Hash of the SPIR-V.
    spirv: u128,
    /// Names of constants, their types and bits.
    constants: Vec<(String, Kind, u32)>,
}

impl Kernels {
    /// Figures of the driver for all kernels, in the order of their last use.
    pub(crate) fn reports(&self) -> Vec<KernelReport> {
        let kernels = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let reports = kernels.iter().filter_map(|(_, kernel)| kernel.report());
        reports.cloned().collect()
    }

    /// The kernel of equal name, module and constants; a new one if there is none.
    ///
    /// # Errors
    /// Returns the errors of [`crate::Gpu::kernel`].
    pub(crate) fn find_or_build(
        &self,
        context: &Arc<Context>,
        name: &'static str,
        spirv: &[u32],
        constants: &[(&str, Constant)],
    ) -> Result<Kernel, GpuError> {
        let key = Key {
            name,
            spirv: xxh3_128(bytemuck::cast_slice(spirv)),
            constants: constants
                .iter()
                .map(|&(name, constant)| (name.to_owned(), constant.kind(), constant.bits()))
                .collect(),
        };
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut kernels = lock();
        if let Some(index) = kernels.iter().position(|(found, _)| *found == key) {
            kernels[index..].rotate_left(1);
            return Ok(kernels[kernels.len() - 1].1.clone());
        }
        // Others may build meanwhile: drivers take up to seconds. A kernel that two build at once
        // is there twice.
        drop(kernels);
        let kernel = Kernel::new(context, name, spirv, constants)?;
        let mut kernels = lock();
        if kernels.len() >= KEPT_MAX {
            kernels.remove(0);
        }
        kernels.push((key, kernel.clone()));
        Ok(kernel)
    }
}
