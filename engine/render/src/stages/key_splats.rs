//! Depth keys of the whole background along one camera's direction, for the persistent key buffer.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use crate::capacity::groups_for;
use crate::interfaces::key_splats::{Bindings, Constants, Module, Push};
use crate::layout::CameraRecord;
use crate::resident_splats::ResidentSplats;

/// Depth keys that projection reads instead of computing them.
#[derive(Clone, Copy)]
pub struct KeptKeys<'a> {
    /// The set of each camera, or [`crate::layout::NO_KEY_SET`].
    pub sets: &'a Buffer<u32>,
    /// `[set][splat]`.
    pub keys: &'a Buffer<u32>,
}

/// Keys that are computed and kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WantedKeys {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the set.
    pub set: usize,
}

/// `key_splats.comp`.
pub struct KeySplats {
    kernel: Kernel<Module>,
}

impl KeySplats {
    /// The stage.
    ///
    /// # Errors
    /// [`GpuError`]: the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Writes the depth keys of all splats of `background` along the direction of a camera to a set
    /// of `keys`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        background: &ResidentSplats,
        cameras: &Buffer<CameraRecord>,
        wanted: WantedKeys,
        keys: &Buffer<u32>,
    ) {
        let push = Push {
            splat_count: background.splats as u32,
            camera: wanted.camera as u32,
            key_set: wanted.set as u32,
        };
        let bindings = Bindings {
            cameras: cameras.bound(),
            means_m: background.means.bound(),
            kept_keys: keys.bound(),
        };
        recorder.dispatch(
            &self.kernel,
            bindings,
            push,
            groups_for(background.splats.div_ceil(256)),
        );
    }
}
