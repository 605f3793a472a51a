//! Start of a frame: what the host wrote reaches the device's buffers, and what is counted is
//! emptied.

use bytemuck::{Pod, Zeroable, bytes_of};
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{FrameCounters, PartialResults, Views};
use crate::interfaces::begin::{Bindings, Constants, Module, Push};
use crate::layout::{CameraRecord, LensRecord, SLABS};

/// Words that a thread writes, at most, where there are fewer workgroups than [`GROUPS_MAX`].
const WORDS_PER_THREAD: u64 = 8;

/// Workgroups at most: enough to fill any device.
const GROUPS_MAX: u64 = 1024;

/// Buffers that the host writes for a frame, or those of the device with the same content.
#[derive(Clone, Copy)]
pub struct FrameData<'a> {
    /// The cameras.
    pub cameras: &'a Buffer<CameraRecord>,
    /// One per camera, where some camera is no pinhole.
    pub lenses: &'a Buffer<LensRecord>,
    /// The set of each camera in the persistent key buffer.
    pub key_sets: &'a Buffer<u32>,
}

/// Copies at the start of a frame.
#[derive(Clone, Copy)]
pub struct HostWritten<'a> {
    /// Buffers that the host writes.
    pub from: FrameData<'a>,
    /// Buffers of the device.
    pub to: FrameData<'a>,
    /// Number of cameras.
    pub cameras: usize,
    /// Number of lenses.
    pub lenses: usize,
}

/// Buffers that a frame counts in.
#[derive(Clone, Copy)]
pub struct Counted<'a> {
    /// Required counts and arguments of indirect dispatches.
    pub counters: &'a FrameCounters,
    /// Pairs of each coarse tile and depth slab.
    pub slab_counts: &'a Buffer<u32>,
    /// Coarse tiles of the frame.
    pub bins: u32,
    /// Largest weights of splats; of length 0 where nothing is asked for.
    pub contributions: &'a Buffer<u32>,
    /// Visible splats before each list of the agents; their total, which is its first word, is set
    /// to zero where there are none.
    pub agent_offsets: &'a Buffer<u32>,
    /// True if there are agents.
    pub agents: bool,
    /// Partial results of segments.
    pub partials: &'a PartialResults,
}

/// `begin.comp`.
pub struct Begin {
    kernel: Kernel<Module>,
}

impl Begin {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            kernel: gpu.kernel(&Constants {})?,
        })
    }

    /// Copies what the host has `written`, and empties what is `counted`. Returns the cameras.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        written: HostWritten<'a>,
        counted: Counted<'_>,
    ) -> Views<'a> {
        let Counted {
            counters, partials, ..
        } = counted;
        let push = Push {
            camera_words: words(written.from.cameras, written.cameras),
            lens_words: words(written.from.lenses, written.lenses),
            key_set_words: written.cameras as u32,
            required_words: words(&counters.required, 1),
            argument_words: words(&counters.arguments, counters.arguments.len()),
            slab_words: counted.bins * SLABS as u32,
            contribution_words: counted.contributions.len() as u32,
            agent_offset_words: u32::from(!counted.agents),
            transmittance_words: words(&partials.transmittances, partials.transmittances.len()),
            unfinished_words: partials.unfinished.len() as u32,
            medians_unfinished_words: partials.medians_unfinished.len() as u32,
        };
        self.dispatch(recorder, written, counted, push);
        Views {
            cameras: written.to.cameras,
            lenses: written.to.lenses,
            count: written.cameras,
        }
    }

    /// Empties what a sort counts, for another sort of the same frame.
    pub fn record_lists(
        &self,
        recorder: &mut Recorder,
        written: HostWritten<'_>,
        counted: Counted<'_>,
    ) {
        let push = Push {
            required_words: words(&counted.counters.required, 1),
            slab_words: counted.bins * SLABS as u32,
            ..Push::zeroed()
        };
        self.dispatch(recorder, written, counted, push);
    }

    fn dispatch(
        &self,
        recorder: &mut Recorder,
        written: HostWritten<'_>,
        counted: Counted<'_>,
        push: Push,
    ) {
        let HostWritten { from, to, .. } = written;
        let bindings = Bindings {
            staged_cameras: from.cameras.bound().cast(),
            staged_lenses: from.lenses.bound().cast(),
            staged_key_sets: from.key_sets.bound(),
            cameras: to.cameras.bound().cast(),
            lenses: to.lenses.bound().cast(),
            key_sets: to.key_sets.bound(),
            required: counted.counters.required.bound().cast(),
            arguments: counted.counters.arguments.bound().cast(),
            slab_counts: counted.slab_counts.bound().cast(),
            contributions: counted.contributions.bound(),
            agent_offsets: counted.agent_offsets.bound(),
            transmittances: counted.partials.transmittances.bound().cast(),
            unfinished: counted.partials.unfinished.bound(),
            medians_unfinished: counted.partials.medians_unfinished.bound(),
        };
        let all_words: u64 = bytemuck::cast_slice::<u8, u32>(bytes_of(&push))
            .iter()
            .map(|&words| u64::from(words))
            .sum();
        let threads = 256 * WORDS_PER_THREAD;
        let groups = all_words.div_ceil(threads).clamp(1, GROUPS_MAX) as u32;
        recorder.dispatch(&self.kernel, bindings, push, [groups, 1, 1]);
    }
}

/// Words of `count` elements.
fn words<T: Pod>(_: &Buffer<T>, count: usize) -> u32 {
    (count * size_of::<T>() / 4) as u32
}
