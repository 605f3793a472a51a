//! Scenes that tests are served.

use std::fs;
use std::path::{Path, PathBuf};

use decouplegs::asset::{
    CodedAsset, Provenance, SceneAgent, SceneFile, SceneLidar, inria_ply, write_coded,
};
use decouplegs::scene::{
    Intrinsics, Pose, Presence, Rig, RigCamera, ShFrame, SplatCloud, TimedPose, Trajectory,
};
use decouplegs::synth::street::{Street, StreetOptions};
use decouplegs::train::compress::{CompressOptions, Prune, compress};
use glam::DVec3;

/// A street of a few thousand splats with three cars in the folder `street` of `folder`: one of a
/// compressed asset, others plain.
pub fn street(folder: &Path) -> PathBuf {
    street_of(folder, 4000)
}

/// [`street`] with a background of `background` splats.
pub fn street_of(folder: &Path, background: usize) -> PathBuf {
    let options = StreetOptions {
        background,
        agents: 3,
        agent_splats: 300,
        sh_degree: 1,
        seed: 5,
        ..StreetOptions::default()
    };
    let street = Street::generate(&options);
    let place = folder.join("street");
    fs::create_dir_all(&place).unwrap();
    inria_ply::write(&place.join("background.ply"), &street.background).unwrap();
    let way = |knots: &[(f64, Pose)]| {
        Trajectory::new(
            knots
                .iter()
                .map(|&(time_s, pose)| TimedPose { time_s, pose })
                .collect(),
        )
        .unwrap()
    };
    let mut agents = Vec::new();
    for (agent, knots) in street.agents.iter().zip(&street.agent_trajectories) {
        let asset = &street.assets[agent.asset];
        let name = if agents.is_empty() {
            "first.safetensors"
        } else {
            "other.ply"
        };
        if agents.is_empty() {
            write_coded(&place.join(name), &coded(asset)).unwrap();
        } else {
            inria_ply::write(&place.join(name), asset).unwrap();
        }
        let trajectory = way(knots);
        agents.push(SceneAgent {
            name: agent.name.clone(),
            class: None,
            asset: name.into(),
            sh_frame: Some(agent.sh_frame),
            trajectory,
            present: Presence::ALWAYS,
        });
    }
    let mut rig = street.rig;
    for camera in rig.cameras_mut() {
        camera.intrinsics = camera.intrinsics.resized(160, 90);
    }
    let ego = Some(way(&street.ego));
    let roof = SceneLidar {
        name: "roof".into(),
        sensor: "xt32".into(),
        rig_from_lidar: Pose::from_yaw(0.5, DVec3::new(0.2, 0.0, 1.1)),
    };
    let file = SceneFile {
        sky: street.sky,
        rig,
        lidars: vec![roof],
        ego,
        agents,
        ..SceneFile::of_background("background.ply")
    };
    let path = place.join("scene.toml");
    file.write(&path).unwrap();
    path
}

fn coded(cloud: &SplatCloud) -> CodedAsset {
    let options = CompressOptions {
        prune: Prune::KeepRatio(1.0),
        iterations_max: 4,
        colors: 64,
        shapes: 64,
        ..CompressOptions::default()
    };
    let cloud = compress(cloud, &vec![1.0; cloud.len()], &options, &|_| {})
        .unwrap()
        .cloud;
    CodedAsset {
        cloud,
        provenance: Provenance::default(),
    }
}

/// Balls of light of one color at `places`, which are relative to an origin.
pub fn balls(places: &[DVec3], rgb: [f32; 3]) -> SplatCloud {
    // The DC coefficient is multiplied by 1 / (2 sqrt(pi)), and 0.5 is added.
    let dc = rgb.map(|channel| (channel - 0.5) / 0.282_094_8);
    SplatCloud {
        means: places
            .iter()
            .map(|place| place.as_vec3().to_array())
            .collect(),
        scales: vec![[0.05; 3]; places.len()],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; places.len()],
        opacities: vec![0.98; places.len()],
        sh_degree: 0,
        sh_dc: vec![dc; places.len()],
        sh_rest: vec![],
    }
}

/// World coordinates of the origin of [`marked`].
pub const MARKED_ORIGIN: DVec3 = DVec3::new(458_000.0, 5_428_000.0, 112.0);
/// Position of the red ball of light, from the origin.
pub const RED: DVec3 = DVec3::new(12.0, 1.5, 2.0);
/// Position of the green ball of the agent `lamp`, from the center of the agent's box.
pub const GREEN: DVec3 = DVec3::new(1.2, 0.7, 0.4);

/// Darkness with a red ball of light in it, far from the zero of its coordinates, and an agent
/// `lamp` that is a green ball of light off its center; two cameras that are turned and shifted.
pub fn marked(folder: &Path) -> PathBuf {
    let place = folder.join("marked");
    fs::create_dir_all(&place).unwrap();
    inria_ply::write(
        &place.join("background.ply"),
        &balls(&[RED], [1.0, 0.0, 0.0]),
    )
    .unwrap();
    // Dark balls at the corners hold the box in which positions are coded.
    let mut lamp = balls(&[GREEN], [0.0, 1.0, 0.0]);
    lamp.append(&balls(
        &[DVec3::new(-2.0, -1.0, -0.8), DVec3::new(2.0, 1.0, 0.8)],
        [0.0; 3],
    ));
    inria_ply::write(&place.join("lamp.ply"), &lamp).unwrap();
    let camera = |name: &str, position: DVec3, look: DVec3| RigCamera {
        name: name.into(),
        intrinsics: Intrinsics {
            cx_px: 83.0,
            cy_px: 47.5,
            fy_px: 95.0,
            ..Intrinsics::from_horizontal_fov(160, 100, 1.4)
        },
        rig_from_camera: Pose {
            translation: position,
            ..Pose::look_at(DVec3::ZERO, look, DVec3::Z).unwrap()
        },
    };
    let cameras = vec![
        camera("front", DVec3::new(1.7, 0.1, 0.6), DVec3::X),
        camera("left", DVec3::new(1.0, 0.6, 0.7), DVec3::new(1.0, 0.6, 0.1)),
    ];
    let agent = SceneAgent {
        name: "lamp".into(),
        class: None,
        asset: "lamp.ply".into(),
        sh_frame: Some(ShFrame::Canonical),
        trajectory: Trajectory::standing(Pose::from_yaw(0.0, MARKED_ORIGIN)),
        present: Presence::ALWAYS,
    };
    let ego = Trajectory::standing(Pose::from_yaw(
        0.1,
        MARKED_ORIGIN + DVec3::new(0.5, -0.4, 0.9),
    ));
    let file = SceneFile {
        origin: MARKED_ORIGIN,
        rig: Rig::from_iter(cameras),
        ego: Some(ego),
        agents: vec![agent],
        ..SceneFile::of_background("background.ply")
    };
    let path = place.join("scene.toml");
    file.write(&path).unwrap();
    path
}
