//! Resolving of a plane of medians.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{kernel, push_constants};
use crate::capacity::groups_for;
use crate::output::OutputBuffers;
use crate::plane::Plane;

push_constants! {
    struct Push {
        pixels: u32,
        channel: u32,
        first_word: u32,
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

    /// Writes `plane` of `images`, if it was asked for, from `medians`: depth and range as blended
    /// over black, nothing, and alpha.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        plane: Plane,
        medians: &Buffer<[f32; 4]>,
        images: &OutputBuffers,
    ) {
        let Some(words) = images.plane_words(plane) else {
            return;
        };
        let push = Push {
            pixels: images.pixels() as u32,
            channel: u32::from(plane == Plane::RangeMedian),
            first_word: words.start as u32,
        };
        let bound = [
            ("medians", medians.binding()),
            ("planes", images.planes.binding()),
        ];
        let groups = groups_for(images.pixels().div_ceil(256));
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), groups);
    }
}
