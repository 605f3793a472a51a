//! The device that a command draws on.

use std::io::Write;

use anyhow::{Result, bail};
use decouplegs_gpu::{DeviceChoice, DeviceOptions, Gpu};

/// The argument of every command that draws on a device.
#[derive(clap::Args)]
pub struct DeviceArguments {
    /// Device to render on: an index, a part of its name or its UUID, as `devices` lists them
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

impl DeviceArguments {
    /// The device, said on standard error: which one made an image matters to its readers
    /// later.
    pub fn open(&self) -> Result<Gpu> {
        self.open_with(DeviceOptions::default())
    }

    /// The device, opened by `options` but for the choice; said on standard error.
    pub fn open_with(&self, options: DeviceOptions) -> Result<Gpu> {
        let gpu = Gpu::open(&DeviceOptions {
            choice: self.device.clone(),
            ..options
        })?;
        // Only for information.
        let _ = writeln!(std::io::stderr(), "on {}", gpu.info());
        Ok(gpu)
    }
}

/// Fails with what the validation layers reported, if they were on (`DECOUPLEGS_VALIDATION=1`) and
/// had something to say.
pub fn check_validation(gpu: &Gpu) -> Result<()> {
    let messages = gpu.take_validation_messages();
    if messages.is_empty() {
        return Ok(());
    }
    bail!(
        "the Vulkan validation layers reported {} faults, the first: {}",
        messages.len(),
        messages[0]
    )
}
