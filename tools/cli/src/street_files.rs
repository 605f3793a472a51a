//! A synthetic street as the files of a scene.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs_asset::cameras::transforms;
use decouplegs_asset::maps::lane_json;
use decouplegs_asset::tracks::{self, PoseRow};
use decouplegs_asset::{
    CodedAsset, Provenance, SceneAgent, SceneFile, SceneLight, SceneRecording, SeenFrom, inria_ply,
    write_atomically, write_coded,
};
use decouplegs_scene::light::{RelightOptions, ShadowOptions};
use decouplegs_scene::{Pose, Presence, Rules, SplatCloud, SplatScene, TimedPose, Trajectory};
use decouplegs_synth::street::Street;
use decouplegs_train::compress::compress_quickly;

/// Sampling rate of the tracks.
const TRACK_RATE_HZ: f64 = 10.0;

/// Kind of the files of cars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cars {
    /// Plain splats (.ply).
    Plain,
    /// Compressed assets (.safetensors).
    Compressed,
}

impl Cars {
    /// Extension of the files, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Plain => "ply",
            Self::Compressed => "safetensors",
        }
    }

    /// Relative to the scene file.
    fn path(self, index: usize) -> PathBuf {
        PathBuf::from(format!("assets/car_{index:02}.{}", self.extension()))
    }

    fn write(self, path: &Path, asset: &SplatCloud) -> Result<()> {
        match self {
            Self::Plain => inria_ply::write(path, asset)?,
            Self::Compressed => {
                let cloud = compress_quickly(asset);
                let cloud = cloud.with_context(|| format!("{} has no splats", path.display()))?;
                let provenance = Provenance {
                    tool_version: env!("CARGO_PKG_VERSION").into(),
                    source: "synth street".into(),
                    source_sha256: String::new(),
                    settings: BTreeMap::new(),
                };
                write_coded(path, &CodedAsset { cloud, provenance })?;
            }
        }
        Ok(())
    }
}

/// Content of the folder of a street.
#[derive(Clone, Copy)]
pub struct Content {
    /// Kind of the files of cars.
    pub cars: Cars,
    /// True: `world.ply` too.
    pub baked: bool,
    /// True: the scene file has shadows.
    pub shadows: bool,
    /// True: the scene file lights cars by the normals of their splats.
    pub by_normals: bool,
}

/// Writes `street` as the files of a folder, which is created if it does not exist.
pub fn write_street(street: &Street, out: &Path, content: Content) -> Result<()> {
    let assets = out.join("assets");
    fs::create_dir_all(&assets).with_context(|| format!("{} cannot be made", assets.display()))?;
    inria_ply::write(&out.join("background.ply"), &street.background)?;
    for (index, asset) in street.assets.iter().enumerate() {
        let path = out.join(content.cars.path(index));
        content.cars.write(&path, asset)?;
    }
    let ego = trajectory(&street.ego).context("the ego's way is no trajectory")?;
    let cameras = transforms(&street.rig.at(&ego.at(ego.start_s())))?;
    write_atomically(&out.join("transforms.json"), |file| {
        writeln!(file, "{cameras:#}")
    })?;
    lane_json::write(&out.join("lanes.json"), &street.lanes)?;
    tracks::write_poses(&out.join("tracks.csv"), &poses(street)?)?;
    if content.baked {
        inria_ply::write(&out.join("world.ply"), &baked_world(street)?)?;
    }
    // Last, because it is what makes a folder a scene: when it is there, all that it names is
    // there.
    scene_file(street, ego, content)?.write(&out.join("scene.toml"))?;
    Ok(())
}

fn scene_file(street: &Street, ego: Trajectory, content: Content) -> Result<SceneFile> {
    let agents = street
        .agents
        .iter()
        .zip(&street.agent_trajectories)
        .map(|(agent, way)| {
            Ok(SceneAgent {
                name: agent.name.clone(),
                class: Some("car".into()),
                asset: content.cars.path(agent.asset),
                sh_frame: Some(agent.sh_frame),
                trajectory: trajectory(way)
                    .with_context(|| format!("the way of {} is no trajectory", agent.name))?,
                present: Presence::ALWAYS,
            })
        });
    Ok(SceneFile {
        sky: street.sky,
        rules: Rules::DEFAULT,
        rig: street.rig.clone(),
        ego: Some(ego),
        recording: SceneRecording {
            seen_from: Some(SeenFrom::Everywhere),
            ..SceneRecording::default()
        },
        agents: agents.collect::<Result<_>>()?,
        light: (content.shadows || content.by_normals).then(|| SceneLight {
            relighting: RelightOptions {
                by_normals: content.by_normals,
                ..RelightOptions::default()
            },
            shadows: Some(ShadowOptions::default()),
            casting: street.casting.clone(),
            ..SceneLight::default()
        }),
        ..SceneFile::of_background("background.ply")
    })
}

/// Poses of each agent from its departure to its arrival.
fn poses(street: &Street) -> Result<Vec<PoseRow>> {
    let mut rows = Vec::new();
    for (agent, way) in street.agents.iter().zip(&street.agent_trajectories) {
        let way = trajectory(way)
            .with_context(|| format!("the way of {} is no trajectory", agent.name))?;
        let steps = ((way.end_s() - way.start_s()) * TRACK_RATE_HZ).round() as u32;
        rows.extend((0..=steps).map(|step| {
            let time_s = way.start_s() + f64::from(step) / TRACK_RATE_HZ;
            let Pose {
                rotation,
                translation,
            } = way.at(time_s);
            PoseRow {
                id: agent.name.clone(),
                class: "car".into(),
                time_s,
                position: translation,
                rotation,
                dims_m: Some(
                    street.asset_dims_m[agent.asset]
                        .map(|side_m| (f64::from(side_m) * 1e6).round() / 1e6),
                ),
                note: String::new(),
            }
        }));
    }
    Ok(rows)
}

fn trajectory(knots: &[(f64, Pose)]) -> Result<Trajectory> {
    // To the micrometer: heights come from sizes in 32-bit floats, whose rounding nobody wants to
    // read.
    let rounded = |pose: Pose| Pose {
        translation: (pose.translation * 1e6).round() / 1e6,
        ..pose
    };
    let poses = knots
        .iter()
        .map(|&(time_s, pose)| TimedPose {
            time_s,
            pose: rounded(pose),
        })
        .collect();
    Trajectory::new(poses).map_err(anyhow::Error::msg)
}

/// Street and cars as they stand at time zero, one cloud.
fn baked_world(street: &Street) -> Result<SplatCloud> {
    let mut splat_scene = SplatScene::from_splats(street.background.clone());
    for agent in &street.agents {
        splat_scene.bake_agent(&street.assets[agent.asset], agent)?;
    }
    Ok(splat_scene.splats)
}
