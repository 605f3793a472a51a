//! A rig whose cameras and LiDARs are divided between devices: the first device, opened twice.

use decouplegs::render::{ColorFormat, Outputs};
use decouplegs::scene::Motion;
use decouplegs::scene::lidar::ReturnMode;
use decouplegs::session::{HostImages, RigRenderer, RigSweep, SessionError, WorldView};
use glam::DVec3;

use super::lidar::{lidar_at, models};
use super::worlds::{assert_silent, cameras, loaded, session, world};

fn outputs() -> Outputs {
    Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    }
}

#[test]
fn a_rig_on_two_devices_is_that_on_one() {
    let sessions = [session(outputs()), session(outputs())];
    let scenes = sessions
        .each_ref()
        .map(|session| session.add_scene(&loaded(1)).unwrap());
    let mut rig = RigRenderer::new(&sessions, scenes.to_vec());
    let sweeps: Vec<RigSweep> = models()
        .into_iter()
        .take(3)
        .map(|(_, model)| RigSweep {
            world_s: model.sweep_s,
            mode: ReturnMode::Median,
            lidar: lidar_at(model, DVec3::ZERO, Motion::REST),
        })
        .collect();
    let (mut alone, mut images) = (sessions[0].batch_renderer(), HostImages::default());
    for step in 0..4_usize {
        let shift = 0.1 * step as f64;
        let mut all = [cameras(shift), cameras(shift + 2.0)].concat();
        // An odd number of cameras, and a step without any.
        all.truncate([4, 3, 0, 1][step]);
        let world = world(&scenes[0], step);
        rig.draw(&world, &all, &sweeps[..step.min(3)]).unwrap();
        if !all.is_empty() {
            let view = WorldView {
                world: &world,
                cameras: &all,
            };
            alone.draw(&[view], &mut images).unwrap();
        }
        for camera in 0..all.len() {
            assert_eq!(rig.size_px(camera), images.size_px(0, camera));
            let same = rig.rgba(camera) == images.rgba(0, camera);
            assert!(same, "step {step}, camera {camera}");
        }
        for (index, sweep) in sweeps[..step.min(3)].iter().enumerate() {
            let (lidar, world_s) = (&sweep.lidar, sweep.world_s);
            let traced = alone.trace(&world, lidar, world_s, sweep.mode).unwrap();
            assert!(rig.sweep(index).states == traced.states, "sweep {index}");
        }
        if step == 0 {
            let devices: Vec<usize> = rig.devices_of_cameras().collect();
            assert_eq!(devices.iter().sum::<usize>(), 2, "{devices:?}");
        }
    }
    sessions.iter().for_each(assert_silent);
}

#[test]
fn a_world_of_assets_that_a_device_lacks_is_refused() {
    let sessions = [session(outputs()), session(outputs())];
    let poor = decouplegs::asset::LoadedScene {
        assets: Vec::new(),
        agents: Vec::new(),
        ..loaded(1)
    };
    let scenes = vec![
        sessions[0].add_scene(&loaded(1)).unwrap(),
        sessions[1].add_scene(&poor).unwrap(),
    ];
    let mut rig = RigRenderer::new(&sessions, scenes);
    let world = world(rig.scene(), 0);
    let refused = rig.draw(&world, &cameras(0.0), &[]).unwrap_err();
    assert!(
        matches!(refused, SessionError::NoAsset { count: 0, .. }),
        "{refused}"
    );
}
