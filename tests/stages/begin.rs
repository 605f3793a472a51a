//! `begin.comp`: what the host wrote is copied, what is counted is zero, and nothing else is
//! touched.

use bytemuck::{Pod, cast_slice};
use decouplegs::gpu::{Buffer, MemoryKind};
use decouplegs::render::layout::{CameraRecord, LensRecord, SLABS};
use decouplegs::render::stages::{
    Begin, Counted, FrameCounters, FrameData, HostWritten, PartialResults,
};
use decouplegs::render::twins;
use decouplegs::render::{Outputs, Plane};
use decouplegs::scene::Rules;

use super::{Random, UNTOUCHED, identical, open, room_for_partials, run, untouched, upload};
use crate::device::Validated;

/// Elements that no kernel has written yet.
fn unwritten<T: Pod>(gpu: &Validated, len: usize) -> Buffer<T> {
    let buffer = gpu
        .buffer("unwritten", "test", len, MemoryKind::Device)
        .unwrap();
    fill(gpu, &buffer);
    buffer
}

/// Writes [`UNTOUCHED`] into every word.
fn fill<T: Pod>(gpu: &Validated, buffer: &Buffer<T>) {
    let words = vec![UNTOUCHED; buffer.len() * size_of::<T>() / 4];
    gpu.write(buffer, 0, cast_slice(&words)).unwrap();
}

fn words_of<T: Pod>(gpu: &Validated, buffer: &Buffer<T>) -> Vec<u32> {
    cast_slice(&gpu.read(buffer).unwrap()).to_vec()
}

/// Compares a buffer with what the host wrote for it: words behind that are untouched.
fn copied(what: &str, found: &[u32], staged: &[u32]) -> Result<(), String> {
    let mut expected = vec![UNTOUCHED; found.len()];
    twins::begin(&[staged], &mut [&mut expected[..staged.len()]], &mut []);
    identical(what, found, &expected)
}

/// Compares a buffer whose first `count` words are emptied: words behind them are untouched.
fn emptied(what: &str, found: &[u32], count: usize) -> Result<(), String> {
    let mut expected = vec![UNTOUCHED; found.len()];
    twins::begin(&[], &mut [], &mut [&mut expected[..count]]);
    identical(what, found, &expected)
}

struct Case {
    cameras: usize,
    lenses: usize,
    bins: u32,
    splats: usize,
    segments: usize,
    agents: bool,
}

/// Runs the kernel and compares every word that it may write; `expected_cameras` are the cameras
/// that the test expects to find.
fn compare(gpu: &Validated, case: &Case, changed: bool) -> Result<(), String> {
    let mut random = Random(7);
    let mut random_words =
        |count: usize| -> Vec<u32> { (0..count).map(|_| random.below(u32::MAX)).collect() };
    let camera_words = size_of::<CameraRecord>() / 4;
    let lens_words = size_of::<LensRecord>() / 4;
    let cameras = random_words(32 * camera_words);
    let lenses = random_words(32 * lens_words);
    let key_sets = random_words(32);
    let (staged_cameras, staged_lenses): (Vec<CameraRecord>, Vec<LensRecord>) =
        (cast_slice(&cameras).to_vec(), cast_slice(&lenses).to_vec());
    let (staged_cameras, staged_lenses, staged_key_sets) = (
        upload(gpu, &staged_cameras),
        upload(gpu, &staged_lenses),
        upload(gpu, &key_sets),
    );
    let (to_cameras, to_lenses, to_key_sets) =
        (unwritten(gpu, 32), unwritten(gpu, 32), unwritten(gpu, 32));
    let counters = FrameCounters::new(gpu).unwrap();
    fill(gpu, &counters.required);
    fill(gpu, &counters.arguments);
    let slab_counts = untouched(gpu, case.bins as usize * SLABS + 5);
    let contributions = untouched(gpu, case.splats);
    let agent_offsets = untouched(gpu, 9);
    let partials = PartialResults::new(
        gpu,
        &room_for_partials(case.segments),
        &Rules::GSPLAT15,
        &Outputs {
            planes: [Plane::DepthMedian].into(),
            ..Outputs::default()
        },
    )
    .unwrap();
    fill(gpu, &partials.transmittances);
    fill(gpu, &partials.unfinished);
    fill(gpu, &partials.medians_unfinished);
    let begin = Begin::new(gpu).unwrap();
    let written = HostWritten {
        from: FrameData {
            cameras: &staged_cameras,
            lenses: &staged_lenses,
            key_sets: &staged_key_sets,
        },
        to: FrameData {
            cameras: &to_cameras,
            lenses: &to_lenses,
            key_sets: &to_key_sets,
        },
        cameras: case.cameras,
        lenses: case.lenses,
    };
    let counted = Counted {
        counters: &counters,
        slab_counts: &slab_counts,
        bins: case.bins,
        contributions: &contributions,
        agent_offsets: &agent_offsets,
        agents: case.agents,
        partials: &partials,
    };
    run(gpu, |r| begin.record(r, written, counted));
    let mut expected = cameras[..case.cameras * camera_words].to_vec();
    expected[0] ^= u32::from(changed);
    copied("cameras", &words_of(gpu, &to_cameras), &expected)?;
    copied(
        "lenses",
        &words_of(gpu, &to_lenses),
        &lenses[..case.lenses * lens_words],
    )?;
    copied(
        "key sets",
        &words_of(gpu, &to_key_sets),
        &key_sets[..case.cameras],
    )?;
    let all = |what: &str, found: Vec<u32>| emptied(what, &found, found.len());
    all("required", words_of(gpu, &counters.required))?;
    all("arguments", words_of(gpu, &counters.arguments))?;
    emptied(
        "slab counts",
        &words_of(gpu, &slab_counts),
        case.bins as usize * SLABS,
    )?;
    all("contributions", words_of(gpu, &contributions))?;
    emptied(
        "agents' offsets",
        &words_of(gpu, &agent_offsets),
        usize::from(!case.agents),
    )?;
    all("transmittances", words_of(gpu, &partials.transmittances))?;
    all("unfinished", words_of(gpu, &partials.unfinished))?;
    let medians_unfinished = words_of(gpu, &partials.medians_unfinished);
    assert!(!medians_unfinished.is_empty());
    all("unfinished medians", medians_unfinished)
}

const CASES: [Case; 4] = [
    Case {
        cameras: 1,
        lenses: 0,
        bins: 1,
        splats: 0,
        segments: 1,
        agents: false,
    },
    Case {
        cameras: 6,
        lenses: 6,
        bins: 77,
        splats: 0,
        segments: 300,
        agents: true,
    },
    Case {
        cameras: 32,
        lenses: 32,
        bins: 3,
        splats: 5003,
        segments: 7,
        agents: false,
    },
    // More words than all threads write at once.
    Case {
        cameras: 2,
        lenses: 1,
        bins: 1500,
        splats: 900_001,
        segments: 3000,
        agents: true,
    },
];

#[test]
fn a_frame_begins_with_what_the_host_wrote_and_counts_of_nothing() {
    let gpu = open();
    for (index, case) in CASES.iter().enumerate() {
        compare(&gpu, case, false).unwrap_or_else(|error| panic!("case {index}: {error}"));
    }
}

#[test]
fn one_changed_word_is_seen() {
    assert!(compare(&open(), &CASES[0], true).is_err());
}
