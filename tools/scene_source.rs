//! What is drawn: a scene and its cameras, as the command line names them.

use std::path::PathBuf;

use anyhow::{Result, bail};
use decouplegs::asset::{LoadedScene, open_scene, read_cameras};
use decouplegs::scene::{Camera, Rules, World};

use crate::arguments::{RulesName, Size};
use crate::progress;

/// The arguments of every command that draws.
#[derive(clap::Args)]
pub struct SceneArguments {
    /// Splats (.ply, .splat, .spz, .sog, .glb, .pt, .safetensors) or a scene (.toml, .usdz)
    scene: PathBuf,
    /// Cameras: INRIA cameras.json or nerfstudio transforms.json (default: the scene's own rig)
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    /// The moment at which the scene is drawn, seconds (default: when the ego's trajectory begins)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    time: Option<f64>,
    /// Render every picture at this size, with its field of view (default: the camera's own)
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// By whose definition splats become a picture (default: the scene's own rules)
    #[arg(long, value_enum)]
    rules: Option<RulesName>,
    /// Keep thin splats from growing brighter when they are widened to a pixel (Mip-Splatting)
    #[arg(long)]
    antialias: bool,
}

/// A scene and the cameras that look at it.
pub struct Scene {
    /// Its rules are those asked for.
    pub loaded: LoadedScene,
    /// The moment that the cameras stand at, seconds.
    pub time_s: f64,
    /// At least one.
    pub cameras: Vec<Camera>,
    /// Whether the cameras are the ego vehicle's, and drive with it.
    drives: bool,
}

impl Scene {
    pub fn open(arguments: &SceneArguments) -> Result<Self> {
        let reading = progress::spinner(format!("reading {}", arguments.scene.display()));
        let mut loaded = open_scene(&arguments.scene, arguments.time.unwrap_or(0.0))?;
        let start_s = loaded.ego.start_s();
        let time_s = arguments.time.unwrap_or(start_s);
        if arguments.time.is_none() && start_s != 0.0 {
            loaded = open_scene(&arguments.scene, start_s)?;
        }
        reading.finish_and_clear();

        if let Some(Size { width_px, height_px }) = arguments.size {
            for camera in &mut loaded.rig.cameras {
                camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
            }
        }
        let mut cameras = match &arguments.cameras {
            Some(file) => read_cameras(file)?,
            None => loaded.rig.at(&loaded.ego.at(time_s)),
        };
        if cameras.is_empty() {
            bail!(
                "{} has no cameras of its own: name some with --cameras FILE (INRIA cameras.json or nerfstudio transforms.json)",
                arguments.scene.display()
            );
        }
        if let (Some(Size { width_px, height_px }), Some(_)) = (arguments.size, &arguments.cameras) {
            for camera in &mut cameras {
                camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
            }
        }
        let rules = &mut loaded.world.rules;
        if let Some(name) = arguments.rules {
            *rules = Rules { antialias: rules.antialias, ..name.rules() };
        }
        rules.antialias |= arguments.antialias;
        Ok(Self { loaded, time_s, cameras, drives: arguments.cameras.is_none() })
    }

    /// By whose definition splats become a picture.
    pub fn rules(&self) -> Rules {
        self.loaded.world.rules
    }

    /// The cameras `later_s` after the moment of the scene: those of a file stay where they are.
    pub fn cameras_after(&self, later_s: f64) -> Vec<Camera> {
        if !self.drives {
            return self.cameras.clone();
        }
        let mut cameras = self.loaded.rig.at(&self.loaded.ego.at(self.time_s + later_s));
        cameras.truncate(self.cameras.len());
        cameras
    }

    /// Background and agents as one cloud, at the moment of the scene: what the f64 definition draws.
    pub fn world(&self) -> World {
        if self.loaded.agents.is_empty() { self.loaded.world.clone() } else { self.loaded.baked(self.time_s) }
    }
}
