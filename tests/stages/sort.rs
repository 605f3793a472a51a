//! `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`: a stable sort.

use decouplegs::render::layout::SortSegment;
use decouplegs::render::stages::{RadixSort, SEGMENTS_MAX, SortInput, SortScratch};
use decouplegs::render::twins;

use super::{Random, identical, open, run, sort_shape, upload};
use crate::device::Validated;

/// A sort that is built once and runs on many inputs.
struct Sorter {
    gpu: Validated,
    sort: RadixSort,
}

/// What to sort: lists of so many keys one behind the other in `keys`, by their low `bits`, with these values or their places.
struct Input {
    keys: Vec<u32>,
    values: Option<Vec<u32>>,
    lists: Vec<usize>,
    bits: u32,
}

impl Input {
    /// All of `keys` as one list by all 32 bits, with their places as values.
    fn of(keys: Vec<u32>) -> Self {
        Self { lists: vec![keys.len()], keys, values: None, bits: 32 }
    }

    fn values(&self) -> Vec<u32> {
        self.values.clone().unwrap_or_else(|| (0..self.keys.len() as u32).collect())
    }
}

impl Sorter {
    fn new() -> Self {
        let gpu = open();
        let sort = RadixSort::new(&gpu, sort_shape(&gpu)).unwrap();
        Self { gpu, sort }
    }

    fn block(&self) -> usize {
        sort_shape(&self.gpu).block() as usize
    }

    /// The lists as the device is told of them, and how many blocks they have.
    fn segments(&self, lists: &[usize]) -> (Vec<SortSegment>, u32) {
        let (mut first, mut first_block) = (0, 0);
        let segment = |&count: &usize| {
            let segment = SortSegment { first, count: count as u32, first_block };
            first += count as u32;
            first_block += count.div_ceil(self.block()) as u32;
            segment
        };
        let segments = lists.iter().map(segment).collect();
        (segments, first_block)
    }

    /// The keys and values that the kernels leave.
    fn sort(&self, input: &Input) -> (Vec<u32>, Vec<u32>) {
        let gpu = &self.gpu;
        let scratch = SortScratch::new(gpu, sort_shape(gpu), input.keys.len()).unwrap();
        gpu.write(&scratch.keys[0], 0, &input.keys).unwrap();
        gpu.write(&scratch.values[0], 0, &input.values()).unwrap();
        let (segments, blocks) = self.segments(&input.lists);
        let (segment_buffer, groups) = (upload(gpu, &segments), upload(gpu, &[0u32, blocks, 1, 1]));
        let sort_input = SortInput {
            segments: &segment_buffer,
            segment_count: segments.len(),
            arguments: groups.binding(),
            arguments_offset: 4,
            first: 0,
        };
        let mut sorted = 0;
        run(gpu, |r| sorted = self.sort.record(r, &scratch, sort_input, input.bits));
        (gpu.read(&scratch.keys[sorted]).unwrap(), gpu.read(&scratch.values[sorted]).unwrap())
    }

    fn twin(&self, input: &Input) -> (Vec<u32>, Vec<u32>) {
        let (mut keys, mut values) = (input.keys.clone(), input.values());
        twins::sort(&self.segments(&input.lists).0, &mut keys, &mut values, input.bits);
        (keys, values)
    }

    fn compare(&self, what: &str, input: &Input) {
        check(&self.sort(input), &self.twin(input)).unwrap_or_else(|error| panic!("{what}: {error}"));
    }
}

fn check(kernel: &(Vec<u32>, Vec<u32>), twin: &(Vec<u32>, Vec<u32>)) -> Result<(), String> {
    identical("keys", &kernel.0, &twin.0)?;
    identical("values", &kernel.1, &twin.1)
}

fn keys(count: usize, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..count).map(|_| random.word()).collect()
}

#[test]
fn every_length_around_a_block() {
    let sorter = Sorter::new();
    let block = sorter.block();
    for count in [0, 1, 2, 255, 256, 257, block - 1, block, block + 1, 2 * block - 1, 2 * block, 2 * block + 1, 5 * block + 77] {
        sorter.compare(&format!("{count} keys"), &Input::of(keys(count, count as u64)));
    }
}

#[test]
fn three_hundred_thousand_keys() {
    let sorter = Sorter::new();
    sorter.compare("random", &Input::of(keys(300_000, 1)));
    let few = keys(300_000, 2).into_iter().map(|key| key % 3 * 0x0100_0001).collect();
    sorter.compare("three different ones", &Input::of(few));
}

#[test]
fn orders_that_are_special() {
    let sorter = Sorter::new();
    let count = 3 * sorter.block() + 100;
    let ascending: Vec<u32> = (0..count as u32).map(|i| i * 1001).collect();
    sorter.compare("sorted", &Input::of(ascending.clone()));
    sorter.compare("reversed", &Input::of(ascending.iter().rev().copied().collect()));
    for key in [0, 1, 0x8000_0000, u32::MAX] {
        sorter.compare("all equal", &Input::of(vec![key; count]));
    }
    let mut ends = vec![u32::MAX; count];
    ends[count - 1] = 0;
    sorter.compare("the lowest last, the others what the kernel fills up with", &Input::of(ends));
}

#[test]
fn equal_keys_keep_their_order() {
    let sorter = Sorter::new();
    let count = 4 * sorter.block() + 9;
    let mut random = Random(3);
    let input = Input::of((0..count).map(|_| random.below(5) << 20).collect());
    let (sorted, values) = sorter.sort(&input);
    assert!(sorted.is_sorted());
    for i in 1..count {
        assert!(sorted[i - 1] < sorted[i] || values[i - 1] < values[i], "places {} and {} are swapped", values[i - 1], values[i]);
    }
}

#[test]
fn any_number_of_bits_with_values_or_places() {
    let sorter = Sorter::new();
    let count = sorter.block() + 501;
    for bits in 1..=32 {
        let random: Vec<u32> = keys(count, u64::from(bits)).into_iter().map(|key| key >> (32 - bits)).collect();
        for values in [None, Some(keys(count, 99))] {
            let input = Input { values, bits, ..Input::of(random.clone()) };
            sorter.compare(&format!("{bits} bits"), &input);
        }
    }
}

#[test]
fn lists_side_by_side_stay_apart() {
    let sorter = Sorter::new();
    let block = sorter.block();
    for lists in [
        vec![0, 0, 5],
        vec![7, 0, 0],
        vec![0, 3 * block + 1, 0, block, 0, 0, 2, block - 1, 0],
        (0..SEGMENTS_MAX).map(|i| i * 37 % 700).collect(),
    ] {
        let count = lists.iter().sum();
        sorter.compare(&format!("{lists:?}"), &Input { lists, ..Input::of(keys(count, count as u64)) });
    }
}

#[test]
fn one_swapped_value_is_seen() {
    let sorter = Sorter::new();
    let input = Input::of(vec![7; 600]);
    let kernel = sorter.sort(&input);
    let mut swapped = sorter.twin(&input);
    check(&kernel, &swapped).unwrap();
    swapped.1.swap(254, 255);
    assert!(check(&kernel, &swapped).unwrap_err().contains("value 254 is 254"));
}
