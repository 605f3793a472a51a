//! A small scene as files.

use std::path::{Path, PathBuf};

use decouplegs::asset::{
    CodedAsset, Provenance, SceneAgent, SceneFile, SceneLidar, inria_ply, write_coded,
};
use decouplegs::scene::{Pose, Presence, ShFrame, TimedPose, Trajectory};
use decouplegs::synth::street::{Street, StreetOptions};
use decouplegs::train::compress::{CompressOptions, compress};
use glam::DVec3;

/// A street of a few hundred splats with one car that drives before the ego, and two cameras that
/// look ahead and to the left.
pub fn small_street(folder: &Path, size_px: [u32; 2]) -> PathBuf {
    let options = StreetOptions {
        background: 800,
        agents: 1,
        agent_splats: 200,
        sh_degree: 1,
        ..StreetOptions::default()
    };
    let mut street = Street::generate(&options);
    inria_ply::write(&folder.join("background.ply"), &street.background).unwrap();
    let car = &street.assets[0];
    let books = CompressOptions {
        colors: 16,
        shapes: 16,
        iterations_max: 20,
        ..CompressOptions::default()
    };
    let cloud = compress(car, &vec![1.0; car.len()], &books, &|_| ())
        .unwrap()
        .cloud;
    write_coded(
        &folder.join("car.safetensors"),
        &CodedAsset {
            cloud,
            provenance: Provenance::default(),
        },
    )
    .unwrap();

    street.rig.sensors.truncate(2);
    for camera in street.rig.cameras_mut() {
        camera.intrinsics = camera.intrinsics.resized(size_px[0], size_px[1]);
    }
    let at = |time_s: f64, x_m: f64| TimedPose {
        time_s,
        pose: Pose::from_yaw(0.0, DVec3::new(x_m, 0.0, 0.8)),
    };
    let way =
        |ahead_m: f64| Trajectory::new(vec![at(0.0, ahead_m), at(4.0, ahead_m + 20.0)]).unwrap();
    let agent = SceneAgent {
        name: "car".into(),
        class: None,
        asset: "car.safetensors".into(),
        sh_frame: Some(ShFrame::Canonical),
        trajectory: way(9.0),
        present: Presence::ALWAYS,
    };
    let scene = SceneFile {
        sky: street.sky,
        rig: street.rig,
        lidars: vec![SceneLidar {
            name: "roof".into(),
            sensor: "xt32".into(),
            rig_from_lidar: Pose::from_yaw(0.25, DVec3::new(0.5, 0.0, 1.0)),
        }],
        ego: Some(way(0.0)),
        agents: vec![agent],
        ..SceneFile::of_background("background.ply")
    };
    let path = folder.join("scene.toml");
    scene.write(&path).unwrap();
    path
}
