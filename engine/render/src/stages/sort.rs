//! Stable radix sort of 32-bit keys with 32-bit values, for a count that only the device knows.
//!
//! Three kernels for each 8 bits: `sort_count`, `sort_scan`, `sort_scatter` (reduce, then scan: no workgroup waits for
//! another). Right for subgroups of 4 to 64 lanes.

use bytemuck::{Pod, Zeroable, bytes_of};
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{Arguments, Control, PURPOSE, kernel};
use crate::capacity::SortShape;

const RADIX_BITS: u32 = 8;
const RADIX: usize = 1 << RADIX_BITS;

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
        Ok(Self {
            keys: [buffer("sort_keys_0", keys)?, buffer("sort_keys_1", keys)?],
            values: [buffer("sort_values_0", keys)?, buffer("sort_values_1", keys)?],
            histograms: buffer("sort_histograms", RADIX * keys.div_ceil(shape.block() as usize))?,
            digit_totals: buffer("sort_digit_totals", RADIX)?,
        })
    }
}

/// Which count of [`crate::layout::Needs`] says how many keys there are.
#[derive(Clone, Copy, Debug)]
pub enum SortCount {
    /// Visible (camera, splat).
    Records = 0,
    /// (Macro tile, record).
    Pairs = 1,
}

/// What is to be sorted.
#[derive(Clone, Copy, Debug)]
pub struct SortInput {
    /// Where the device finds the number of keys.
    pub count: SortCount,
    /// No more than this many, whatever that number is.
    pub max: usize,
    /// Which of the scratch's pairs of buffers holds them.
    pub first: usize,
    /// The values are the keys' own places, whatever the values buffer holds.
    pub index_values: bool,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    count_index: u32,
    count_max: u32,
    shift: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ScanPush {
    count_index: u32,
    count_max: u32,
}

/// `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`.
pub struct RadixSort {
    count: Kernel,
    scan: Kernel,
    scatter: Kernel,
    scatter_indices: Kernel,
}

impl RadixSort {
    /// The stage, cut as `shape` says.
    ///
    /// # Errors
    /// When the driver refuses a kernel.
    pub fn new(gpu: &Gpu, shape: SortShape) -> Result<Self, GpuError> {
        let size = [("WORKGROUP_THREADS", Constant::U32(shape.threads)), ("ITEMS", Constant::U32(shape.items))];
        let scatter = |indices| {
            kernel(gpu, &decouplegs_shaders::SORT_SCATTER, &[size[0], size[1], ("INDEX_VALUES", Constant::Bool(indices))])
        };
        Ok(Self {
            count: kernel(gpu, &decouplegs_shaders::SORT_COUNT, &size)?,
            scan: kernel(gpu, &decouplegs_shaders::SORT_SCAN, &size)?,
            scatter: scatter(false)?,
            scatter_indices: scatter(true)?,
        })
    }

    /// Sorts `input` by the low `key_bits` of its keys, values along with them. Returns which pair of buffers holds the result.
    ///
    /// # Panics
    /// When `input.max` is more than the scratch has room for.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        scratch: &SortScratch,
        control: &Control,
        input: SortInput,
        key_bits: u32,
    ) -> usize {
        assert!(input.max <= scratch.keys[0].len(), "a sort of {} keys, the scratch holds {}", input.max, scratch.keys[0].len());
        let arguments = match input.count {
            SortCount::Records => Arguments::SortRecords,
            SortCount::Pairs => Arguments::SortPairs,
        };
        let (count_index, count_max) = (input.count as u32, input.max as u32);
        let passes = key_bits.div_ceil(RADIX_BITS) as usize;
        for pass in 0..passes {
            let from = (input.first + pass) % 2;
            let to = 1 - from;
            let push = Push { count_index, count_max, shift: pass as u32 * RADIX_BITS };
            let scan_push = ScanPush { count_index, count_max };
            let needs = ("needs", control.needs.binding());
            let histograms = ("histograms", scratch.histograms.binding());
            let digit_totals = ("digit_totals", scratch.digit_totals.binding());
            let keys_in = ("keys_in", scratch.keys[from].binding());
            let offset = arguments.byte_offset();
            recorder.dispatch_indirect(
                &self.count,
                &[needs, keys_in, histograms],
                bytes_of(&push),
                control.arguments.binding(),
                offset,
            );
            recorder.dispatch(&self.scan, &[needs, histograms, digit_totals], bytes_of(&scan_push), [RADIX as u32, 1, 1]);
            let scatter = if input.index_values && pass == 0 { &self.scatter_indices } else { &self.scatter };
            let buffers = [
                needs,
                histograms,
                digit_totals,
                keys_in,
                ("values_in", scratch.values[from].binding()),
                ("keys_out", scratch.keys[to].binding()),
                ("values_out", scratch.values[to].binding()),
            ];
            recorder.dispatch_indirect(scatter, &buffers, bytes_of(&push), control.arguments.binding(), offset);
        }
        (input.first + passes) % 2
    }
}
