//! `decouplegs synth`: synthetic scenes of any size.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Subcommand, ValueEnum};
use decouplegs::asset::maps::lane_json;
use decouplegs::asset::memory::{self, cloud_bytes};
use decouplegs::asset::tracks::{self, PoseRow};
use decouplegs::asset::{
    CodedAsset, Provenance, SceneAgent, SceneFile, SceneLight, inria_ply, write_atomically,
    write_coded,
};
use decouplegs::scene::light::{RelightOptions, ShadowOptions};
use decouplegs::scene::{
    Camera, Pose, Presence, Rules, SplatCloud, SplatScene, TimedPose, Trajectory,
};
use decouplegs::synth::street::{AssetLight, Capture, Street, StreetOptions, Weather};
use decouplegs::train::compress::compress_quickly;
use glam::DVec3;
use serde_json::{Value, json};

use crate::arguments::{Size, print};
use crate::progress;

/// Scene that `make demo` makes, from the folder of the sources.
const DEMO: &str = "out/demo/street/scene.toml";
/// Sampling rate of the tracks.
const TRACK_RATE_HZ: f64 = 10.0;

/// Generate a scene and write it as files
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    scene: SyntheticScene,
}

#[derive(Subcommand)]
enum SyntheticScene {
    Street(StreetArguments),
}

/// The light over the street.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum WeatherName {
    /// A sunny afternoon
    Clear,
    /// Gray light from all of the sky, no cast shadows
    Overcast,
    /// A low, orange sun and long shadows
    Dusk,
    /// Street lamps and lit windows
    Night,
}

impl WeatherName {
    fn weather(self) -> Weather {
        match self {
            Self::Clear => Weather::Clear,
            Self::Overcast => Weather::Overcast,
            Self::Dusk => Weather::Dusk,
            Self::Night => Weather::Night,
        }
    }
}

/// A street with traffic and a vehicle of six cameras: scene.toml, background.ply, assets/*.ply,
/// transforms.json, lanes.json and tracks.csv (where each car truly is, ten times a second)
#[derive(clap::Args)]
struct StreetArguments {
    /// Splats of the street without its traffic
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    background: usize,
    /// Cars that drive
    #[arg(long, value_name = "N", default_value_t = 10)]
    agents: usize,
    /// Splats of each car
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    agent_splats: usize,
    /// Degree of the spherical harmonics
    #[arg(long, value_name = "DEGREE", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: u8,
    /// Seed of all randomness: the same seed gives the same bytes
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// The light over the street
    #[arg(long, value_name = "WEATHER", value_enum, default_value = "clear")]
    weather: WeatherName,
    /// Capture the cars in even white light, without sun, sheen and shadow, for relighting
    #[arg(long)]
    neutral_assets: bool,
    /// Capture the street from all of its lanes instead of the ego's path, for free driving
    #[arg(long)]
    all_lanes: bool,
    /// Size of the cameras' images
    #[arg(long, value_name = "WxH", default_value = "1600x900")]
    size: Size,
    /// Compress the cars (.safetensors), so that they move when the scene is played, at some loss.
    /// Plain cars (.ply) stand still in one frame, without loss
    #[arg(long)]
    movable: bool,
    /// Let the cars throw shadows on the road, under the sun or the street lamps of the weather:
    /// a [light] table. Best with --neutral-assets, since other cars show the dark below them
    #[arg(long)]
    shadows: bool,
    /// Light the cars by the normals of their splats, as the road shows the light of the weather,
    /// and let them throw shadows. Best with --neutral-assets and --movable
    #[arg(long)]
    by_normals: bool,
    /// Write world.ply too: street and cars as one cloud of splats, for programs without agents
    #[arg(long)]
    baked: bool,
    /// Folder for the files; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let SyntheticScene::Street(arguments) = &arguments.scene;
    check_size(arguments)?;
    let working = progress::spinner(format!("{} splats", arguments.background));
    let mut street = Street::generate(&StreetOptions {
        background: arguments.background,
        agents: arguments.agents,
        agent_splats: arguments.agent_splats,
        sh_degree: arguments.degree,
        seed: arguments.seed,
        weather: arguments.weather.weather(),
        asset_light: if arguments.neutral_assets {
            AssetLight::Neutral
        } else {
            AssetLight::Sun
        },
        capture: if arguments.all_lanes {
            Capture::Lanes
        } else {
            Capture::Ego
        },
    });
    for camera in street.rig.cameras_mut() {
        camera.intrinsics = camera
            .intrinsics
            .resized(arguments.size.width_px, arguments.size.height_px);
    }
    working.set_message(format!("writing {}", arguments.out.display()));
    let cars = match arguments.movable {
        true => Cars::Compressed,
        false => Cars::Plain,
    };
    let content = Content {
        cars,
        baked: arguments.baked,
        shadows: arguments.shadows,
        by_normals: arguments.by_normals,
    };
    write_street(&street, &arguments.out, content)?;
    working.finish_and_clear();
    let out = arguments.out.display();
    let mut text = format!(
        "{out}/scene.toml: {} splats, {} cars of {} kinds, {} cameras\n",
        street.background.len(),
        street.agents.len(),
        street.assets.len(),
        street.rig.sensors.len()
    );
    text += &format!(
        "  beside it: background.ply, assets/*.{}, transforms.json, lanes.json, tracks.csv{}\n",
        cars.extension(),
        if arguments.baked { ", world.ply" } else { "" }
    );
    text += &format!("  draw it:   decouplegs render {out}/scene.toml --out images\n");
    text += &format!("  view it:   decouplegs view {out}/scene.toml\n");
    text += &format!(
        "  drive it:  decouplegs drive --level easy --planner lane-follow --scene {out}/scene.toml --map {out}/lanes.json --out run\n"
    );
    print(&text)
}

/// The demo scene: the file that `make demo` makes, or one of the same content beside the caches
/// of this user, which is made if it is absent.
pub fn demo() -> Result<PathBuf> {
    let made = PathBuf::from(DEMO);
    if made.exists() {
        return Ok(made);
    }
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    let caches = variable("XDG_CACHE_HOME").map(PathBuf::from);
    let caches = caches.or_else(|| Some(PathBuf::from(variable("HOME")?).join(".cache")));
    let folder = caches.context("there is neither HOME nor XDG_CACHE_HOME: name a scene")?;
    let scene = folder.join("decouplegs/demo/scene.toml");
    if !scene.exists() {
        let working = progress::spinner(format!("making the demo scene {}", scene.display()));
        let mut street = Street::generate(&StreetOptions {
            background: 400_000,
            agents: 8,
            agent_splats: 8_000,
            sh_degree: 1,
            seed: 7,
            ..StreetOptions::default()
        });
        for camera in street.rig.cameras_mut() {
            camera.intrinsics = camera.intrinsics.resized(800, 450);
        }
        let out = scene.parent().unwrap_or(Path::new(""));
        let content = Content {
            cars: Cars::Compressed,
            baked: false,
            shadows: false,
            by_normals: false,
        };
        write_street(&street, out, content)?;
        working.finish_and_clear();
    }
    Ok(scene)
}

/// Refuses what the memory cannot hold, before anything is made.
fn check_size(arguments: &StreetArguments) -> Result<()> {
    ensure!(
        arguments.agents <= usize::from(u16::MAX),
        "--agents {}: a scene has at most {} agents",
        arguments.agents,
        u16::MAX
    );
    // As many different cars as agents, at most.
    let cars = (arguments.agents as u64).saturating_mul(arguments.agent_splats as u64);
    let splats = (arguments.background as u64).saturating_add(cars);
    // Twice: the street is sorted into a copy.
    memory::require(
        "this street",
        cloud_bytes(splats, arguments.degree).saturating_mul(2),
    )
    .map_err(anyhow::Error::msg)
}

/// Kind of the files of cars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cars {
    Plain,
    Compressed,
}

impl Cars {
    fn extension(self) -> &'static str {
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
struct Content {
    cars: Cars,
    /// True: `world.ply` too.
    baked: bool,
    /// True: the scene file has shadows.
    shadows: bool,
    /// True: the scene file lights cars by the normals of their splats.
    by_normals: bool,
}

fn write_street(street: &Street, out: &Path, content: Content) -> Result<()> {
    let assets = out.join("assets");
    fs::create_dir_all(&assets).with_context(|| format!("{} cannot be made", assets.display()))?;
    inria_ply::write(&out.join("background.ply"), &street.background)?;
    for (index, asset) in street.assets.iter().enumerate() {
        let path = out.join(content.cars.path(index));
        content.cars.write(&path, asset)?;
    }
    let ego = trajectory(&street.ego).context("the ego's way is no trajectory")?;
    let cameras = transforms(&street.rig.at(&ego.at(ego.start_s())));
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

/// nerfstudio's transforms.json: world from camera in OpenGL axes (x right, y up, z back),
/// intrinsics for each frame.
fn transforms(cameras: &[Camera]) -> Value {
    let frame = |camera: &Camera| {
        let Pose {
            rotation,
            translation,
        } = camera.world_from_camera;
        let (right, up, back) = (
            rotation * DVec3::X,
            rotation * DVec3::NEG_Y,
            rotation * DVec3::NEG_Z,
        );
        let row = |axis: usize| json!([right[axis], up[axis], back[axis], translation[axis]]);
        let lens = &camera.intrinsics;
        json!({
            "file_path": format!("{}.png", camera.name),
            "w": lens.width_px,
            "h": lens.height_px,
            "fl_x": lens.fx_px,
            "fl_y": lens.fy_px,
            "cx": lens.cx_px,
            "cy": lens.cy_px,
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        })
    };
    json!({ "camera_model": "OPENCV", "frames": cameras.iter().map(frame).collect::<Vec<_>>() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::asset::cameras;
    use decouplegs::scene::Intrinsics;
    use decouplegs::scene::Motion;
    use glam::DQuat;

    #[test]
    fn cameras_that_are_written_are_read_back() {
        let camera = Camera {
            name: "front_left".into(),
            intrinsics: Intrinsics {
                cx_px: 310.5,
                ..Intrinsics::from_horizontal_fov(640, 360, 1.1)
            },
            world_from_camera: Pose::new(
                DQuat::from_xyzw(0.1, -0.7, 0.3, 0.5),
                DVec3::new(1.0, -2.5, 4.5e6),
            ),
            motion: Motion::REST,
        };
        let bytes = transforms(std::slice::from_ref(&camera)).to_string();
        let read = cameras::decode(bytes.as_bytes(), None).unwrap();
        assert_eq!(
            (read.len(), &read[0].name, read[0].intrinsics),
            (1, &camera.name, camera.intrinsics)
        );
        let (read, written) = (read[0].world_from_camera, camera.world_from_camera);
        assert_eq!(read.translation, written.translation);
        assert!(read.rotation.dot(written.rotation).abs() > 1.0 - 1e-12);
    }
}
