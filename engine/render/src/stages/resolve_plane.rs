//! Resolving of a plane: means or medians of an attribute by pixel.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{kernel, push_constants};
use crate::capacity::groups_for;
use crate::output::OutputBuffers;
use crate::plane::Plane;

push_constants! {
    struct Push {
        pixels: u32,
        channels: u32,
        first_word: u32,
        median: u32,
    }
}

/// `resolve_plane.comp`.
pub struct ResolvePlane {
    kernel: Kernel,
}

impl ResolvePlane {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: kernel::<Push>(gpu, &decouplegs_shaders::RESOLVE_PLANE, &[])?,
        })
    }

    /// Writes `plane` of `images`, if it was asked for, from `sums`: the attribute as blended over
    /// black, and alpha.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        plane: Plane,
        sums: &Buffer<[f32; 4]>,
        images: &OutputBuffers,
    ) {
        let Some(words) = images.plane_words(plane) else {
            return;
        };
        let push = Push {
            pixels: images.pixels() as u32,
            channels: plane.channels() as u32,
            first_word: words.start as u32,
            median: plane.is_median().into(),
        };
        let bound = [
            ("sums", sums.binding()),
            ("planes", images.planes.binding()),
        ];
        let groups = groups_for(images.pixels().div_ceil(256));
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), groups);
    }
}
