//! Kernels of an open device, built once for all renderers that use them.

use std::sync::{Arc, Mutex, PoisonError};

use decouplegs_spirv::reflect;
use xxhash_rust::xxh3::xxh3_128;

use super::{Constant, Kernel, KernelCore};
use crate::{GpuError, KernelReport, Shader, context::Context};

/// Kernels kept at most. A renderer uses about 30, and settings of a scene change some of them.
const KEPT_MAX: usize = 256;

/// Kernels that were built, the last used ones last.
#[derive(Default)]
pub(crate) struct Kernels(Mutex<Vec<(Key, Arc<KernelCore>)>>);

/// Everything that a kernel is built from.
#[derive(PartialEq, Eq)]
struct Key {
    name: &'static str,
    /// Hash of the SPIR-V.
    spirv: u128,
    /// Bits of the constants, by id.
    constants: Vec<u32>,
}

impl Kernels {
    /// Figures of the driver for all kernels, in the order of their last use.
    pub(crate) fn reports(&self) -> Vec<KernelReport> {
        let kernels = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let reports = kernels.iter().filter_map(|(_, core)| core.report.as_ref());
        reports.cloned().collect()
    }

    /// The kernel of the shader `S` with equal constants; a new one if there is none.
    ///
    /// # Errors
    /// Returns the errors of [`crate::Gpu::kernel`].
    pub(crate) fn find_or_build<S: Shader>(
        &self,
        context: &Arc<Context>,
        constants: &S::Constants,
    ) -> Result<Kernel<S>, GpuError> {
        let values = S::values(constants);
        let key = Key {
            name: S::NAME,
            spirv: xxh3_128(bytemuck::cast_slice(S::spirv())),
            constants: values.as_ref().iter().map(|value| value.bits()).collect(),
        };
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut kernels = lock();
        if let Some(index) = kernels.iter().position(|(found, _)| *found == key) {
            kernels[index..].rotate_left(1);
            return Ok(Kernel::from_core(kernels[kernels.len() - 1].1.clone()));
        }
        // Others may build meanwhile: drivers take up to seconds. A kernel that two build at once
        // is there twice.
        drop(kernels);
        let core = Arc::new(build::<S>(context, values.as_ref())?);
        let mut kernels = lock();
        if kernels.len() >= KEPT_MAX {
            kernels.remove(0);
        }
        kernels.push((key, core.clone()));
        Ok(Kernel::from_core(core))
    }
}

/// Builds the kernel of the shader `S`, or the one that replaces it on trial.
fn build<S: Shader>(context: &Arc<Context>, values: &[Constant]) -> Result<KernelCore, GpuError> {
    let (name, interface) = (S::NAME, S::INTERFACE);
    let names = interface.constants.iter().map(|declared| &*declared.name);
    let constants: Vec<(&str, Constant)> = names.zip(values.iter().copied()).collect();
    let mut constants = context.trial.constants(name, &constants)?;
    let Some(spirv) = context.trial.spirv(name) else {
        return KernelCore::new(context, name, S::spirv(), interface.clone(), &constants);
    };
    let refuse = |reason| GpuError::Trial {
        path: format!("{name}.spv").into(),
        reason,
    };
    let replacing = reflect(spirv).map_err(refuse)?;
    if let Some(fault) = interface.fault(&replacing) {
        return Err(refuse(format!(
            "{fault}; give a kernel that takes the same"
        )));
    }
    // A kernel on trial may do without a constant of the program's.
    let has = |name: &str| (replacing.constants.iter()).any(|declared| declared.name == name);
    constants.retain(|(name, _)| has(name));
    KernelCore::new(context, name, spirv, replacing, &constants)
}
