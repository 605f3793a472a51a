//! The device that tests run on, and the check that Vulkan had nothing to say.

use decouplegs::gpu::{DeviceOptions, Gpu};

/// A device with the validation layers on, synchronization validation included. What they report
/// fails the test.
pub struct Validated {
    gpu: Gpu,
}

impl Validated {
    /// The device that `DECOUPLEGS_DEVICE` names, or the first there is. A machine with none fails
    /// the test: `make test` installs lavapipe.
    pub fn open() -> Self {
        let choice = std::env::var("DECOUPLEGS_DEVICE")
            .map(|name| name.parse().expect("DECOUPLEGS_DEVICE names a device"));
        // Speed runs on machines without the layers set it to 0; everywhere else it is on.
        let validation = std::env::var("DECOUPLEGS_VALIDATION").map_or(true, |value| value != "0");
        let options = DeviceOptions {
            choice: choice.unwrap_or_default(),
            validation,
            ..DeviceOptions::default()
        };
        Self {
            gpu: Gpu::open(&options).unwrap_or_else(|error| panic!("{error}")),
        }
    }
}

impl std::ops::Deref for Validated {
    type Target = Gpu;

    fn deref(&self) -> &Gpu {
        &self.gpu
    }
}

impl Drop for Validated {
    fn drop(&mut self) {
        let messages = self.gpu.take_validation_messages();
        if !messages.is_empty() && !std::thread::panicking() {
            panic!("the validation layers reported:\n{}", messages.join("\n"));
        }
    }
}
