//! The crate on a real Vulkan device (lavapipe will do), watched by the validation layer with
//! synchronization validation.

mod drills;
mod interfaces;
mod kernels;
mod memory;
mod opening;
mod ordering;

use std::ops::Deref;

use decouplegs_gpu::{Buffer, DeviceOptions, Gpu, Kernel, QueueUse};
use interfaces::scale;

/// On, unless a machine without the layers says `DECOUPLEGS_VALIDATION=0`: then the tests of what
/// validation sees fail.
fn validation() -> bool {
    std::env::var("DECOUPLEGS_VALIDATION").map_or(true, |value| value != "0")
}

/// A device under validation. Dropping it fails the test when the layer has complained.
struct Watched(Gpu);

impl Watched {
    fn open() -> Self {
        Self::open_with(QueueUse::All)
    }

    fn open_with(queues: QueueUse) -> Self {
        let options = DeviceOptions {
            validation: validation(),
            queues,
            ..DeviceOptions::default()
        };
        Self(Gpu::open(&options).unwrap())
    }
}

impl Deref for Watched {
    type Target = Gpu;

    fn deref(&self) -> &Gpu {
        &self.0
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        let messages = self.0.take_validation_messages();
        assert!(
            std::thread::panicking() || messages.is_empty(),
            "validation says: {messages:#?}"
        );
    }
}

/// The words of one of `tests/kernels`, which stay until the tests end.
fn spirv(name: &str) -> &'static [u32] {
    let bytes: &[u8] = match name {
        "arguments" => include_bytes!("../kernels/arguments.spv"),
        "scale" => include_bytes!("../kernels/scale.spv"),
        "spin" => include_bytes!("../kernels/spin.spv"),
        "table" => include_bytes!("../kernels/table.spv"),
        _ => panic!("no test kernel {name}"),
    };
    let (words, _) = bytes.as_chunks::<4>();
    let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    words.leak()
}

/// `target = source * factor + add`, in groups of 64.
fn scaling(gpu: &Gpu, factor: u32) -> Kernel<scale::Module> {
    gpu.kernel(&constants(factor)).unwrap()
}

/// Constants of `scale` for a factor.
fn constants(factor: u32) -> scale::Constants {
    scale::Constants {
        group_size: 64,
        factor,
        negate: false,
        unused_scale: 1.0,
    }
}

/// Buffers of `scale`.
fn from_to<'a>(from: &'a Buffer<i32>, to: &'a Buffer<i32>) -> scale::Bindings<'a> {
    scale::Bindings {
        source_values: from.bound(),
        target_values: to.bound(),
    }
}
