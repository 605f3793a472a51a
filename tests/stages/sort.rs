//! `sort_count.comp`, `sort_scan.comp` and `sort_scatter.comp`: a stable sort.

use decouplegs::render::layout::Needs;
use decouplegs::render::stages::{Arguments, RadixSort, SortCount, SortInput, SortScratch};
use decouplegs::render::twins;

use super::{Random, UNTOUCHED, control, identical, open, run, sort_shape};
use crate::device::Validated;

/// A sort that is built once and runs on many inputs.
struct Sorter {
    gpu: Validated,
    sort: RadixSort,
}

/// What to sort: the first `count` of `keys`, by their low `bits`, with these values or their places.
struct Input {
    keys: Vec<u32>,
    values: Option<Vec<u32>>,
    count: usize,
    bits: u32,
}

impl Input {
    /// All of `keys` by all 32 bits, with their places as values.
    fn of(keys: Vec<u32>) -> Self {
        Self { count: keys.len(), keys, values: None, bits: 32 }
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

    /// The keys and values that the kernels leave.
    fn sort(&self, input: &Input, which: SortCount) -> (Vec<u32>, Vec<u32>) {
        let gpu = &self.gpu;
        let shape = sort_shape(gpu);
        let count = input.count as u32;
        let needs = match which {
            SortCount::Records => Needs { records: count, pairs: UNTOUCHED, ..Needs::default() },
            SortCount::Pairs => Needs { records: UNTOUCHED, pairs: count, ..Needs::default() },
        };
        let arguments = match which {
            SortCount::Records => Arguments::SortRecords,
            SortCount::Pairs => Arguments::SortPairs,
        };
        let held = input.count.min(input.keys.len());
        let control = control(gpu, needs, &[(arguments, held.div_ceil(self.block()))]);
        let scratch = SortScratch::new(gpu, shape, input.keys.len()).unwrap();
        gpu.write(&scratch.keys[0], 0, &input.keys).unwrap();
        if let Some(values) = &input.values {
            gpu.write(&scratch.values[0], 0, values).unwrap();
        }
        let mut sorted = 0;
        let sort_input = SortInput { count: which, max: input.keys.len(), first: 0, index_values: input.values.is_none() };
        run(gpu, |r| sorted = self.sort.record(r, &scratch, &control, sort_input, input.bits));
        let first = |buffer| gpu.read(buffer).unwrap()[..held].to_vec();
        (first(&scratch.keys[sorted]), first(&scratch.values[sorted]))
    }

    fn compare(&self, what: &str, input: &Input) {
        self.compare_as(what, input, SortCount::Records);
    }

    fn compare_as(&self, what: &str, input: &Input, which: SortCount) {
        let kernel = self.sort(input, which);
        let held = input.count.min(input.keys.len());
        let twin = twins::sort(held, &input.keys, input.values.as_deref(), input.bits);
        check(&kernel, &twin).unwrap_or_else(|error| panic!("{what}: {error}"));
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
    let (sorted, values) = sorter.sort(&input, SortCount::Records);
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
fn the_count_is_the_one_asked_for_and_no_more_than_there_is_room() {
    let sorter = Sorter::new();
    for count in [0, 5, 2000, 2999, 3000, 3001, 1_000_000] {
        let input = Input { count, values: Some(keys(3000, 5)), ..Input::of(keys(3000, 4)) };
        for which in [SortCount::Records, SortCount::Pairs] {
            sorter.compare_as(&format!("{count} keys, room for 3000"), &input, which);
        }
    }
}

#[test]
fn one_swapped_value_is_seen() {
    let sorter = Sorter::new();
    let input = Input::of(vec![7; 600]);
    let kernel = sorter.sort(&input, SortCount::Records);
    let mut swapped = twins::sort(600, &input.keys, None, 32);
    check(&kernel, &swapped).unwrap();
    swapped.1.swap(254, 255);
    assert!(check(&kernel, &swapped).unwrap_err().contains("value 254 is 254"));
}
