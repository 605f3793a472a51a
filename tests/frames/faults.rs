//! Calls of Vulkan that fail, one at a time: a session says so, gives back what it holds, and draws
//! the same afterwards.

use std::collections::BTreeMap;

use decouplegs::gpu::{DeviceOptions, Drill, Gpu, GpuError};
use decouplegs::render::layout::BeamState;
use decouplegs::scene::Motion;
use decouplegs::scene::lidar::{ReturnMode, Spin};
use decouplegs::session::{HostImages, RigSweep, Session, SessionError, SessionOptions, WorldView};
use glam::DVec3;
use rayon::prelude::*;

use super::lidar::{lidar_at, spinning, uniform};
use super::worlds::{cameras, loaded, world};

/// Images of two steps, and states of beams.
type Drawn = (Vec<Vec<u8>>, Vec<BeamState>);

fn device(drill: Option<Drill>) -> Result<Gpu, GpuError> {
    Gpu::open(&DeviceOptions {
        drill,
        ..DeviceOptions::default()
    })
}

/// Opens a scene on `gpu`, and draws two steps of it.
fn draw(gpu: &Gpu) -> Result<Drawn, SessionError> {
    let session = Session::on(gpu, &SessionOptions::default());
    let scene = session.add_scene(&loaded(1))?;
    let model = spinning(&uniform(4, 12.0, -20.0), 90, 360.0, Spin::Clockwise);
    let sweep = RigSweep {
        world_s: model.sweep_s,
        mode: ReturnMode::Median,
        lidar: lidar_at(model, DVec3::ZERO, Motion::REST),
    };
    let (mut renderer, mut images) = (session.batch_renderer(), HostImages::default());
    let (mut drawn, mut traced) = (Drawn::default(), Vec::new());
    for step in 0..2 {
        let (world, cameras) = (world(&scene, step), cameras(0.1 * step as f64));
        let view = WorldView {
            world: &world,
            cameras: &cameras,
        };
        renderer.draw(&[view], &mut images)?;
        drawn
            .0
            .extend((0..cameras.len()).map(|camera| images.rgba(0, camera).to_vec()));
        renderer.trace_all(&world, std::slice::from_ref(&sweep), &mut traced)?;
        drawn.1.extend(traced[0].states.iter().copied());
    }
    Ok(drawn)
}

/// The first, the middle and the last call of each function, by number: the first with both codes.
fn chosen(calls: &[&'static str]) -> Vec<(Drill, &'static str)> {
    let mut numbers: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for (name, number) in calls.iter().zip(0..) {
        numbers.entry(name).or_default().push(number);
    }
    let drills = |(name, numbers): (&'static str, Vec<u64>)| {
        let (first, last) = (numbers[0], numbers[numbers.len() - 1]);
        let middle = numbers[numbers.len() / 2];
        let drills = [
            Drill::CallLost(first),
            Drill::CallFull(first),
            Drill::CallFull(middle),
            Drill::CallLost(last),
        ];
        let count = if numbers.len() == 1 { 2 } else { 4 };
        drills
            .into_iter()
            .take(count)
            .map(move |drill| (drill, name))
    };
    numbers.into_iter().flat_map(drills).collect()
}

/// Draws with a call that fails, and again. The failure must be told as what it is.
fn survive(drill: Drill, name: &str, truth: &Drawn) {
    let at = format!("{drill:?}, {name}");
    let gpu = match device(Some(drill)) {
        Ok(gpu) => gpu,
        // The calls of opening a device.
        Err(error) => return assert!(told(&drill, &error), "{at}: {error}"),
    };
    let mut failures = 0;
    // The number of calls that wait is not the same each time: the call that fails may be one of
    // the second drawing.
    for _ in 0..3 {
        match draw(&gpu) {
            Ok(drawn) => assert!(drawn == *truth, "{at}: other images"),
            Err(error) => {
                let fault = error.gpu();
                let is_told = fault.is_some_and(|fault| told(&drill, fault));
                assert!(is_told, "{at}: {error}");
                failures += 1;
                continue;
            }
        }
        if failures > 0 {
            break;
        }
    }
    assert!(failures <= 1, "{at}: {failures} drawings failed");
    // What was in flight when the call failed is given back by then.
    assert_eq!(gpu.memory().total_bytes, 0, "{at}: memory is still held");
}

/// True if `error` names the fault of `drill`.
fn told(drill: &Drill, error: &GpuError) -> bool {
    match drill {
        Drill::CallLost(_) => error.is_lost(),
        // Where no memory for a buffer is meant, the code stands in the sentence.
        _ => error.is_full() || error.to_string().contains("OUT_OF_DEVICE_MEMORY"),
    }
}

#[test]
fn a_call_that_fails_is_told_and_nothing_is_lost() {
    // A drill whose call is never reached counts the calls.
    let counted = device(Some(Drill::CallFull(u64::MAX))).unwrap();
    let truth = draw(&counted).unwrap();
    let calls = counted.drilled_calls();
    assert!(
        truth
            .0
            .iter()
            .any(|image| image.iter().any(|&byte| byte > 0))
    );
    assert!(calls.len() > 100, "{} calls", calls.len());
    // `DECOUPLEGS_FAULTS=all` has each of them fail: that takes an hour on two cores.
    let all = std::env::var("DECOUPLEGS_FAULTS").is_ok_and(|value| value == "all");
    let numbered = (0..).zip(calls.iter().copied());
    let drills: Vec<(Drill, &str)> = match all {
        true => numbered
            .flat_map(|(number, name)| {
                [Drill::CallLost(number), Drill::CallFull(number)].map(|drill| (drill, name))
            })
            .collect(),
        false => chosen(&calls),
    };
    println!(
        "{} calls, of which one fails, {} times",
        calls.len(),
        drills.len()
    );
    let drills = drills.into_par_iter();
    drills.for_each(|(drill, name)| survive(drill, name, &truth));
    // The case that must fail: a device that stays lost does not draw afterwards.
    let lost = device(Some(Drill::Lost(3))).unwrap();
    assert!(draw(&lost).is_err() && draw(&lost).is_err());
}

#[test]
fn a_scene_larger_than_the_memory_of_the_device_is_refused() {
    let small = device(Some(Drill::Heap(64 << 10))).unwrap();
    let error = draw(&small).unwrap_err();
    assert!(error.gpu().is_some_and(GpuError::is_full), "{error}");
    assert!(
        error.to_string().contains("64.0 KiB") || error.to_string().contains("65"),
        "{error}"
    );
    assert_eq!(small.memory().total_bytes, 0);
    let large = device(Some(Drill::Heap(u64::MAX))).unwrap();
    assert!(draw(&large).is_ok());
}
