//! Each stage's kernels against its twin: both are given the same bytes.
//!
//! Integers must be identical. Floats lie within a bound that the test derives from the operations
//! that were rounded, and an integer that was decided by floats may differ only where the twin's
//! own decision does not survive that rounding.

pub mod agents;
mod attributes;
mod begin;
mod blend;
mod composite;
mod cull;
mod cull_shadows;
mod hash_images;
mod key_splats;
mod layout;
mod lidar;
mod merge_lists;
mod plan_segments;
mod post_process;
mod project;
mod properties;
mod relight;
mod rolling_shutter;
mod scan;
pub mod scenes;
mod subgroups;
mod tile_sort;

use std::cmp::Ordering;
use std::fmt::Debug;

use decouplegs::gpu::{Buffer, QueueRole, Recorder};
use decouplegs::render::Planes;
use decouplegs::render::capacity::{Capacity, groups_for};
use decouplegs::render::layout::{
    ARGUMENT_SETS, COARSE_PIXELS, FINE_TILES, PartialTiles, RequiredCounts,
};
use decouplegs::render::stages::{FrameCounters, IndirectArguments, PartialResults};
use decouplegs::render::twins::color_code::{pack_color, unpack_color};
use decouplegs::render::twins::output::{PIXEL_EMPTY, Pixel, pixels_of_tile};

use crate::device::Validated;
use attributes::attribute_of_depth;
use decouplegs::render::twins::planes::{plane_sums, plane_words};
use glam::Vec3;

/// Unit roundoff of f32: what one operation may be off by, relative to its result.
const ROUNDOFF: f64 = 1.0 / 16_777_216.0;

/// Value of output buffers before a kernel runs: untouched elements still have it.
const UNTOUCHED: u32 = 0xdead_beef;

/// The device; in a child process of `subgroups`, one whose subgroups have the size that was asked
/// for.
fn open() -> Validated {
    let gpu = Validated::open();
    if let Ok(lanes) = std::env::var(subgroups::EXPECTED_LANES) {
        assert_eq!(
            gpu.limits().subgroup_size.to_string(),
            lanes,
            "{} gives subgroups of another size",
            gpu.info()
        );
    }
    gpu
}

/// Runs what `record` records, to its end.
fn run<T>(gpu: &Validated, record: impl FnOnce(&mut Recorder) -> T) {
    let mut recorder = gpu.record(QueueRole::Main);
    record(&mut recorder);
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
}

fn upload<T: bytemuck::Pod>(gpu: &Validated, data: &[T]) -> Buffer<T> {
    gpu.upload("test input", "test", data).unwrap()
}

/// A buffer of `len` words that no kernel has written yet.
fn untouched(gpu: &Validated, len: usize) -> Buffer<u32> {
    upload(gpu, &vec![UNTOUCHED; len])
}

/// Counters from earlier stages, and the workgroups of the dispatches that they sized; the others
/// hold [`UNTOUCHED`].
fn counters(
    gpu: &Validated,
    required: RequiredCounts,
    groups: &[(IndirectArguments, usize)],
) -> FrameCounters {
    let counters = FrameCounters::new(gpu).unwrap();
    gpu.write(&counters.required, 0, &[required]).unwrap();
    let mut arguments = [[UNTOUCHED; 3]; ARGUMENT_SETS];
    for &(set, count) in groups {
        arguments[set as usize] = groups_for(count);
    }
    gpu.write(&counters.arguments, 0, &arguments).unwrap();
    counters
}

/// Pixels of a fine tile.
const TILE_PIXELS: usize = COARSE_PIXELS / FINE_TILES;

/// Room for the partial results of `slots` segments in all their fine tiles.
fn room_for_partials(slots: usize) -> Capacity {
    Capacity {
        records: 1,
        pairs: 1,
        partials: slots,
        tiles: slots * FINE_TILES,
    }
}

/// The color that the code of `color` stands for.
fn coded(color: Vec3) -> Vec3 {
    unpack_color(pack_color(color))
}

/// Writes `pixels` as partial results; fine tiles in which nothing is drawn have none.
fn write_partials(
    gpu: &Validated,
    partials: &PartialResults,
    pixels: &[Pixel],
    planes_asked: Planes,
) {
    let (mut tiles, mut drawn) = (Vec::new(), Vec::new());
    for slot in 0..pixels.len() / COARSE_PIXELS {
        let pixels = &pixels[slot * COARSE_PIXELS..][..COARSE_PIXELS];
        let is_drawn =
            |tile: &usize| pixels_of_tile(*tile).any(|index| pixels[index] != PIXEL_EMPTY);
        let first = (drawn.len() / TILE_PIXELS) as u32;
        let mut bits = 0u32;
        for tile in (0..FINE_TILES).filter(is_drawn) {
            bits |= 1 << tile;
            drawn.extend(pixels_of_tile(tile).map(|index| pixels[index]));
        }
        tiles.push(PartialTiles { first, tiles: bits });
    }
    let colors: Vec<u32> = drawn
        .iter()
        .flat_map(|pixel| {
            let [low, high] = pack_color(pixel.color);
            [low, high, pixel.transmittance.to_bits()]
        })
        .collect();
    let planes: Vec<u32> = drawn
        .iter()
        .flat_map(|pixel| {
            let words = 0..planes_asked.attribute_words();
            let depth_m = pixel.planes.weighted_depth;
            let attributes = words.map(move |word| attribute_of_depth(word, depth_m).to_bits());
            plane_words(&pixel.planes).into_iter().chain(attributes)
        })
        .collect();
    gpu.write(&partials.tiles, 0, &tiles).unwrap();
    gpu.write(&partials.colors, 0, &colors).unwrap();
    gpu.write(&partials.planes, 0, &planes).unwrap();
    if planes_asked.has_medians() {
        let medians: Vec<u32> = drawn.iter().map(|pixel| pixel.median).collect();
        gpu.write(&partials.medians, 0, &medians).unwrap();
    }
}

/// The pixels of all partial results, depth and instance among them.
fn read_partials(gpu: &Validated, partials: &PartialResults) -> Vec<Pixel> {
    let tiles = gpu.read(&partials.tiles).unwrap();
    let colors = gpu.read(&partials.colors).unwrap();
    let words = gpu.read(&partials.planes).unwrap();
    let medians = gpu.read(&partials.medians).unwrap();
    let mut pixels = vec![PIXEL_EMPTY; tiles.len() * COARSE_PIXELS];
    for (slot, held) in tiles.iter().enumerate() {
        let first = held.first;
        let held = (0..FINE_TILES).filter(|tile| held.tiles >> tile & 1 == 1);
        for (next, tile) in held.enumerate() {
            let indices = (first as usize + next) * TILE_PIXELS..;
            for (index, pixel) in indices.zip(pixels_of_tile(tile)) {
                let words = words[3 * index..][..3].try_into();
                let color = &colors[3 * index..][..3];
                pixels[slot * COARSE_PIXELS + pixel] = Pixel {
                    color: unpack_color([color[0], color[1]]),
                    transmittance: f32::from_bits(color[2]),
                    planes: plane_sums(words.expect("all planes were asked for")),
                    median: medians.get(index).copied().unwrap_or(0),
                };
            }
        }
    }
    pixels
}

/// Depth and range of record `record`, which no other record has.
fn depth_and_range_of(record: u32) -> [f32; 2] {
    [record as f32 + 0.5, 2.0 * record as f32 + 1.0]
}

/// Counts from the kernel, and the sizes of the dispatches after it.
fn found(gpu: &Validated, counters: &FrameCounters) -> (RequiredCounts, Vec<[u32; 3]>) {
    (
        gpu.read(&counters.required).unwrap()[0],
        gpu.read(&counters.arguments).unwrap(),
    )
}

/// Says where `kernel` and `twin` differ first.
fn identical<T: PartialEq + Debug>(what: &str, kernel: &[T], twin: &[T]) -> Result<(), String> {
    if kernel.len() != twin.len() {
        return Err(format!(
            "{what}: the kernel has {} values, the twin {}",
            kernel.len(),
            twin.len()
        ));
    }
    let different = kernel.iter().zip(twin).filter(|(a, b)| a != b).count();
    match kernel.iter().zip(twin).position(|(a, b)| a != b) {
        None => Ok(()),
        Some(i) => Err(format!(
            "{what}: {different} differ; value {i} is {:?}, the twin has {:?}",
            kernel[i], twin[i]
        )),
    }
}

/// Says where `kernel` is farther from `twin` than the bound given for each value; else returns the
/// largest share of its bound that a value used.
fn within(what: &str, kernel: &[f32], twin: &[f32], bounds: &[f64]) -> Result<f64, String> {
    assert!(
        kernel.len() == twin.len() && twin.len() == bounds.len(),
        "{what}: lists of different lengths are compared"
    );
    let mut worst = 0.0f64;
    for (i, ((&a, &b), &bound)) in kernel.iter().zip(twin).zip(bounds).enumerate() {
        let error = (f64::from(a) - f64::from(b)).abs();
        // A NaN on either side compares as none and fails.
        if error.partial_cmp(&bound).is_none_or(Ordering::is_gt) {
            return Err(format!(
                "{what}: value {i} is {a}, the twin has {b}: {error:e} apart, at most {bound:e} is rounding"
            ));
        }
        worst = worst.max(if bound > 0.0 { error / bound } else { 0.0 });
    }
    Ok(worst)
}

/// Numbers that are the same in every run (Steele et al., Fast Splittable Pseudorandom Number
/// Generators, 2014).
pub struct Random(pub u64);

impl Random {
    pub fn word(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (x ^ x >> 31) as u32
    }

    /// Random integer from 0 to `end - 1`.
    pub fn below(&mut self, end: u32) -> u32 {
        ((u64::from(self.word()) * u64::from(end)) >> 32) as u32
    }

    /// Random number from `low` to `high`.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * ((self.word() >> 8) as f32 / 16_777_216.0)
    }

    /// Random number from `low` to `high`, each power of ten as often as the next.
    pub fn across_scales(&mut self, low: f32, high: f32) -> f32 {
        self.between(low.ln(), high.ln()).exp()
    }
}

#[test]
fn comparators_see_one_changed_value() {
    let words = [1u32, 2, 3];
    identical("same", &words, &words).unwrap();
    assert!(
        identical("changed", &[1, 2, 4], &words)
            .unwrap_err()
            .contains("value 2 is 4")
    );
    assert!(identical("shorter", &words[..2], &words).is_err());
    let floats = [1.0f32, -2.0];
    assert_eq!(within("same", &floats, &floats, &[0.0; 2]), Ok(0.0));
    assert!(within("inside", &[1.0, -2.001], &floats, &[0.0, 0.002]).unwrap() < 0.51);
    assert!(within("outside", &[1.0, -2.001], &floats, &[0.0, 0.0005]).is_err());
    assert!(within("not a number", &[f32::NAN, -2.0], &floats, &[1e9; 2]).is_err());
    assert!(within("no bound", &floats, &floats, &[f64::NAN; 2]).is_err());
}
