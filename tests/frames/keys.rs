//! The persistent key buffer: keys that are kept while a camera does not turn give the same bytes
//! as keys computed in every frame.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, KeySource, RenderOptions, Renderer,
};
use decouplegs::scene::{Camera, Pose};
use glam::{DQuat, DVec3};

use super::agents::{background, camera_towards, coded_car};
use crate::device::Validated;

/// Frames of the recorded drive.
const FRAMES: usize = 200;

/// Pose of the ego per frame: straight on, a stop, slow and fast turns, teleports, camera cuts,
/// turns on the spot, and the jitter of a hand.
fn drive(frame: usize) -> (DVec3, f64) {
    let t = frame as f64;
    match frame {
        0..50 => (DVec3::new(0.05 * t, 0.01 * t, 0.5), 0.0),
        50..60 => (DVec3::new(2.5, 0.5, 0.5), 0.0),
        60..90 => (DVec3::new(0.05 * t, 0.0, 0.5), 0.000_004 * (t - 59.0)),
        90..110 => (DVec3::new(0.05 * t, 0.0, 0.5), 0.035 * (t - 89.0)),
        110..120 => (DVec3::new(6.0, 1.0, 0.5), 0.71),
        120..125 => (DVec3::new(30.0, 3.0, 1.0), 3.0),
        125..140 => (
            DVec3::new(0.0, 0.1 * (t - 125.0), 0.5),
            if frame.is_multiple_of(2) { 0.0 } else { PI },
        ),
        140..170 => (
            DVec3::new(0.05 * (t - 140.0), 0.0, 0.5),
            0.000_03 * (t * 7.3).sin(),
        ),
        _ => (
            DVec3::new(3.0 - 0.1 * (t - 170.0), 0.0, 0.8),
            0.002 * (t - 169.0),
        ),
    }
}

fn rig(frame: usize) -> [Camera; 2] {
    let (eye, yaw) = drive(frame);
    let towards = |turn: f64| eye + DQuat::from_rotation_z(yaw + turn) * DVec3::X;
    [
        camera_towards("front", eye, towards(0.0), (96, 64)),
        camera_towards("side", eye, towards(1.0), (64, 64)),
    ]
}

#[test]
fn a_drive_gives_the_same_bytes_with_and_without_kept_keys() {
    let gpu = Validated::open();
    let world = background(6000, 4);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(300, 5)).unwrap();
    let mut renderers = [false, true].map(|keep_keys| {
        Renderer::new(
            &gpu,
            RenderOptions {
                keep_keys,
                ..RenderOptions::default()
            },
        )
    });
    let resident = renderers[0].upload(&world).unwrap();
    let mut sources = BTreeMap::<String, usize>::new();
    let mut straight = Vec::new();
    for frame in 0..FRAMES {
        let t = frame as f64;
        let agent = |world_from_agent, instance| Agent::new(asset, world_from_agent, instance);
        let agents = [
            agent(Pose::from_yaw(0.1, DVec3::new(6.0 + 0.1 * t, 0.5, 0.0)), 1),
            agent(
                Pose::from_yaw(3.0 - 0.01 * t, DVec3::new(15.0 - 0.05 * t, -2.0, 0.0)),
                2,
            ),
        ];
        let images = renderers.each_mut().map(|renderer| {
            let statistics = renderer
                .render(
                    FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
                    &rig(frame),
                )
                .unwrap();
            if renderer.options().keep_keys {
                for source in &statistics.keys {
                    *sources.entry(format!("{source:?}")).or_default() += 1;
                }
                straight.push(
                    statistics
                        .keys
                        .iter()
                        .all(|&source| source == KeySource::Kept),
                );
            } else {
                assert!(
                    statistics
                        .keys
                        .iter()
                        .all(|&source| source == KeySource::Computed)
                );
            }
            renderer.read_images().unwrap()
        });
        assert!(images[0] == images[1], "frame {frame} differs");
    }
    println!("{sources:?}");
    // The keys of both views are found in the second frame; from then on none is computed as long
    // as it drives straight on, or stands.
    assert!(
        straight[2..60].iter().all(|&kept| kept),
        "driving straight on computed keys: {straight:?}"
    );
    for source in ["Computed", "Found", "Kept"] {
        assert!(
            sources.contains_key(source),
            "no view's keys were {source}: the drive proves too little"
        );
    }
}

#[test]
fn a_frame_that_is_refused_leaves_no_keys_behind_that_were_never_found() {
    let gpu = Validated::open();
    let world = background(2000, 8);
    let mut keeping = Renderer::new(&gpu, RenderOptions::default());
    let resident = keeping.upload(&world).unwrap();
    keeping.render(&resident, &rig(0)).unwrap();
    // The second frame would find keys; it has no room for its images.
    let mut huge = rig(1);
    for camera in &mut huge {
        camera.intrinsics = camera.intrinsics.resized(65_536, 65_536);
    }
    assert!(keeping.render(&resident, &huge).is_err());
    let mut computing = Renderer::new(
        &gpu,
        RenderOptions {
            keep_keys: false,
            ..RenderOptions::default()
        },
    );
    computing.render(&resident, &rig(1)).unwrap();
    for _ in 0..4 {
        keeping.render(&resident, &rig(1)).unwrap();
        assert!(keeping.read_images().unwrap() == computing.read_images().unwrap());
    }
}
