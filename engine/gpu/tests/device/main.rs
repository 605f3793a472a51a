//! The crate on a real Vulkan device (lavapipe will do), watched by the validation layer with
//! synchronization validation.

mod drills;
mod kernels;
mod memory;
mod opening;
mod ordering;

use std::ops::Deref;

use decouplegs_gpu::{Constant, DeviceOptions, Gpu, Kernel, QueueUse};

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

/// The words of one of `tests/kernels`.
fn words(bytes: &[u8]) -> Vec<u32> {
    bytes
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
        .collect()
}

fn spirv(name: &str) -> Vec<u32> {
    words(match name {
        "arguments" => include_bytes!("../kernels/arguments.spv"),
        "layout" => include_bytes!("../kernels/layout.spv"),
        "scale" => include_bytes!("../kernels/scale.spv"),
        "spin" => include_bytes!("../kernels/spin.spv"),
        "table" => include_bytes!("../kernels/table.spv"),
        "texture" => include_bytes!("../kernels/texture.spv"),
        _ => panic!("no test kernel {name}"),
    })
}

/// `target = source * factor + add`, in groups of 64.
fn scale(gpu: &Gpu, factor: u32) -> Kernel {
    gpu.kernel(
        "scale",
        &spirv("scale"),
        &[
            ("GROUP_SIZE", Constant::U32(64)),
            ("FACTOR", Constant::U32(factor)),
        ],
    )
    .unwrap()
}

/// Push constants of `scale`.
fn scale_push(count: u32, add: i32) -> Vec<u8> {
    bytes(&[count, add as u32])
}

fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_ne_bytes()).collect()
}
