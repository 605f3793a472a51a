//! Stable radix sort of 32-bit keys with 32-bit values, of several lists side by side, whose lengths only the device knows.
//!
//! Three kernels for each 8 bits: `sort_count`, `sort_scan`, `sort_scatter` (reduce, then scan: no workgroup waits for
//! another). Right for subgroups of 4 to 64 lanes.

use bytemuck::bytes_of;
use decouplegs_gpu::{Bound, Buffer, Constant, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{NoPush, PURPOSE, kernel, push_constants};
use crate::capacity::SortShape;
use crate::layout::{CAMERAS_MAX, SortSegment};

const RADIX_BITS: u32 = 8;
const RADIX: usize = 1 << RADIX_BITS;

/// Lists that are sorted side by side at most: background and agents of each camera.
pub const SEGMENTS_MAX: usize = 2 * CAMERAS_MAX;

/// Keys, values and counters, twice where a pass needs to read one and write the other.
pub struct SortScratch {
    /// Keys.
    pub keys: [Buffer<u32>; 2],
    /// Values.
    pub values: [Buffer<u32>; 2],
    histograms: Buffer<u32>,
    digit_totals: Buffer<u32>,
}

impl SortScratch {
    /// Buffers for `keys` keys.
    ///
    /// # Errors
    /// When the device is out of memory.
    pub fn new(gpu: &Gpu, shape: SortShape, keys: usize) -> Result<Self, GpuError> {
        let buffer = |name, len| gpu.buffer(name, PURPOSE, len, Residence::Device);
        // Every segment may end in a block that is not full.
        let blocks = keys.div_ceil(shape.block() as usize) + SEGMENTS_MAX;
        Ok(Self {
            keys: [buffer("sort_keys_0", keys)?, buffer("sort_keys_1", keys)?],
            values: [buffer("sort_values_0", keys)?, buffer("sort_values_1", keys)?],
            histograms: buffer("sort_histograms", RADIX * blocks)?,
            digit_totals: buffer("sort_digit_totals", RADIX * SEGMENTS_MAX)?,
        })
    }
}

/// What is to be sorted.
#[derive(Clone, Copy, Debug)]
pub struct SortInput<'a> {
    /// Where the device finds the lists, none of which reaches beyond the scratch.
    pub segments: &'a Buffer<SortSegment>,
    /// How many of them there are, at most [`SEGMENTS_MAX`].
    pub segment_count: usize,
    /// Where the device finds the number of workgroups: the blocks of all segments.
    pub arguments: Bound<'a>,
    /// At which byte.
    pub arguments_offset: u64,
    /// Which of the scratch's pairs of buffers holds the keys.
    pub first: usize,
}

push_constants! {
    struct Push {
        segment_count: u32,
        shift: u32,
    }
}

/// `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`.
pub struct RadixSort {
    count: Kernel,
    scan: Kernel,
    scatter: Kernel,
}

impl RadixSort {
    /// The stage, cut as `shape` says.
    ///
    /// # Errors
    /// When the driver refuses a kernel.
    pub fn new(gpu: &Gpu, shape: SortShape) -> Result<Self, GpuError> {
        let size = [("WORKGROUP_THREADS", Constant::U32(shape.threads)), ("ITEMS", Constant::U32(shape.items))];
        Ok(Self {
            count: kernel::<Push>(gpu, &decouplegs_shaders::SORT_COUNT, &size)?,
            scan: kernel::<NoPush>(gpu, &decouplegs_shaders::SORT_SCAN, &size)?,
            scatter: kernel::<Push>(gpu, &decouplegs_shaders::SORT_SCATTER, &size)?,
        })
    }

    /// Sorts each list of `input` by the low `key_bits` of its keys, values along with them. Returns which pair of buffers
    /// holds the result.
    ///
    /// # Panics
    /// When there are more than [`SEGMENTS_MAX`] lists.
    pub fn record(&self, recorder: &mut Recorder, scratch: &SortScratch, input: SortInput<'_>, key_bits: u32) -> usize {
        let SortInput { segments, segment_count, arguments, arguments_offset, first } = input;
        assert!(segment_count <= SEGMENTS_MAX, "a sort of {segment_count} lists, at most {SEGMENTS_MAX} are sorted at once");
        let passes = key_bits.div_ceil(RADIX_BITS) as usize;
        let segments = ("segments", segments.binding());
        let histograms = ("histograms", scratch.histograms.binding());
        let digit_totals = ("digit_totals", scratch.digit_totals.binding());
        for pass in 0..passes {
            let from = (first + pass) % 2;
            let to = 1 - from;
            let push = Push { segment_count: segment_count as u32, shift: pass as u32 * RADIX_BITS };
            let keys_in = ("keys_in", scratch.keys[from].binding());
            let buffers = [segments, keys_in, histograms];
            recorder.dispatch_indirect(&self.count, &buffers, bytes_of(&push), arguments, arguments_offset);
            let groups = [RADIX as u32, segment_count as u32, 1];
            recorder.dispatch(&self.scan, &[segments, histograms, digit_totals], &[], groups);
            let buffers = [
                segments,
                histograms,
                digit_totals,
                keys_in,
                ("values_in", scratch.values[from].binding()),
                ("keys_out", scratch.keys[to].binding()),
                ("values_out", scratch.values[to].binding()),
            ];
            recorder.dispatch_indirect(&self.scatter, &buffers, bytes_of(&push), arguments, arguments_offset);
        }
        (first + passes) % 2
    }
}
