//! Scene and cameras, as named on the command line.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use decouplegs_asset::{CameraOptions, LoadedScene, SplatFormat, open_scene, read_cameras};
use decouplegs_scene::{Camera, Intrinsics, Rig, Rules, Sensor, SplatScene};

use crate::arguments::{RulesName, Size, finite, warn};
use crate::free_view::FreeView;
use crate::orbit::{OrbitArguments, SIZE_PX};
use crate::progress;

/// The arguments of every command that draws.
#[derive(clap::Args)]
pub struct SceneArguments {
    #[arg(help = format!("Splats ({}) or a scene (.toml, .usdz)", SplatFormat::EXTENSIONS))]
    scene: PathBuf,
    #[command(flatten)]
    options: SceneOptions,
}

impl SceneArguments {
    /// Size of every image, pixels, if given.
    #[must_use]
    pub fn size_px(&self) -> Option<[u32; 2]> {
        self.options.size_px()
    }
}

/// Choice of cameras, time and rules for a scene.
#[derive(clap::Args)]
pub struct SceneOptions {
    /// Cameras: INRIA cameras.json, nerfstudio or NeRF-synthetic transforms.json, the folder of a
    /// COLMAP model, or names of cameras of the scene's rig, with commas between them (default: the
    /// scene's own rig, or a circle of views around splats that have none)
    #[arg(long, value_name = "FILE|DIR|NAME,...")]
    cameras: Option<PathBuf>,
    /// nerfstudio's dataparser_transforms.json, with --cameras transforms.json: for splats that
    /// `ns-export` wrote
    #[arg(long, value_name = "FILE", requires = "cameras")]
    dataparser: Option<PathBuf>,
    /// One camera, a pinhole that is called view, by numbers: its position, meters, its rotation as
    /// a quaternion (x right, y down, z forward), and its vertical field of view, degrees, or its
    /// focal lengths and principal point, pixels. The viewer copies such a command
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW,FOV|FX,FY,CX,CY", allow_hyphen_values = true, conflicts_with_all = ["cameras", "orbit"])]
    view: Option<FreeView>,
    #[command(flatten)]
    orbit: OrbitArguments,
    /// Time of the scene, seconds; in 'view' the time that is shown first, of episodes too
    /// (default: the start of the ego's trajectory)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    time: Option<f64>,
    /// Render every image at this size, with its horizontal and its vertical field of view
    /// (default: the camera's own)
    #[arg(long, value_name = "WxH", allow_hyphen_values = true)]
    size: Option<Size>,
    /// Image formation rules (default: the scene's own)
    #[arg(long, value_enum)]
    rules: Option<RulesName>,
    /// Compensate the dilation of thin splats by their opacity (Mip-Splatting)
    #[arg(long)]
    antialias: bool,
}

impl SceneOptions {
    /// True if one of them was given that an episode has not: all but the size and the time.
    #[must_use]
    pub fn are_of_scenes(&self) -> bool {
        self.cameras.is_some()
            || self.dataparser.is_some()
            || self.view.is_some()
            || self.orbit.is_asked()
            || self.rules.is_some()
            || self.antialias
    }

    /// Time of the scene or the episode, seconds, if given.
    #[must_use]
    pub fn time_s(&self) -> Option<f64> {
        self.time
    }

    /// The rules as they are typed, if given.
    #[must_use]
    pub fn rules_words(&self) -> Vec<String> {
        let mut words = Vec::new();
        if let Some(value) = self.rules.and_then(|rules| rules.to_possible_value()) {
            words.extend(["--rules".into(), value.get_name().to_owned()]);
        }
        if self.antialias {
            words.push("--antialias".into());
        }
        words
    }

    /// The file of cameras as it is typed, if given.
    #[must_use]
    pub fn cameras_words(&self) -> Vec<String> {
        let option = |name: &str, path: &Option<PathBuf>| {
            let path = path.as_ref().map(|path| absolute(path));
            path.map_or_else(Vec::new, |path| vec![name.to_owned(), path])
        };
        let files = [
            ("--cameras", &self.cameras),
            ("--dataparser", &self.dataparser),
        ];
        files.map(|(name, path)| option(name, path)).concat()
    }

    /// Size of every image, pixels, if given.
    #[must_use]
    pub fn size_px(&self) -> Option<[u32; 2]> {
        self.size.map(|size| [size.width_px, size.height_px])
    }
}

/// `path` from the root, as it is typed in any folder.
#[must_use]
pub fn absolute(path: &Path) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    absolute.display().to_string()
}

/// Input of a command that draws: a scene that was read, and the cameras that look at it.
pub struct DrawInput {
    /// Loaded scene, with the requested rules.
    pub loaded: LoadedScene,
    /// The moment that the cameras stand at, seconds.
    pub time_s: f64,
    /// Cameras to render; never empty.
    pub cameras: Vec<Camera>,
    /// True if the cameras are the ego vehicle's, and drive with it.
    drives: bool,
    /// A sentence for each camera whose image is squeezed.
    squeezed: Vec<String>,
}

/// Shapes that differ by less count as one: 1600x900 and 320x180 as well as 854x480.
const SHAPE_TOLERANCE: f64 = 0.01;

/// Gives the camera called `name` the size asked for. A sentence where its image has another shape,
/// so that it is squeezed.
fn resize(name: &str, own: &mut Intrinsics, size_px: Option<[u32; 2]>) -> Option<String> {
    let [width_px, height_px] = size_px?;
    let (own_width_px, own_height_px) = (own.width_px, own.height_px);
    *own = own.resized(width_px, height_px);
    let own = f64::from(own_width_px) / f64::from(own_height_px);
    let wanted = f64::from(width_px) / f64::from(height_px);
    ((wanted / own - 1.0).abs() > SHAPE_TOLERANCE).then(|| {
        format!(
            "camera {name} is {own_width_px}x{own_height_px}, and --size {width_px}x{height_px} has another shape: its image is squeezed. \
             {width_px}x{} keeps it",
            (f64::from(width_px) / own).round()
        )
    })
}

/// Leaves the cameras of `rig` whose names are in `names`, with commas between them.
fn choose(rig: &mut Rig, names: &Path) -> Result<()> {
    let names = names.to_string_lossy();
    let names: Vec<&str> = names.split(',').collect();
    let known: Vec<String> = rig.cameras().map(|camera| camera.name.clone()).collect();
    for name in &names {
        ensure!(
            known.iter().any(|known| known == name),
            "--cameras {name}: it is no file, and no camera of the scene: those are {}",
            known.join(", ")
        );
    }
    rig.sensors.retain(|sensor| match sensor {
        Sensor::Camera(camera) => names.contains(&camera.name.as_str()),
        Sensor::Lidar(_) => true,
    });
    Ok(())
}

impl DrawInput {
    pub fn open(arguments: &SceneArguments) -> Result<Self> {
        Self::with_options(&arguments.scene, &arguments.options)
    }

    /// Opens the splats or the scene at `path`.
    ///
    /// # Errors
    /// Returns an error if a file is at fault, or there is nothing to look at.
    pub fn with_options(path: &Path, arguments: &SceneOptions) -> Result<Self> {
        let reading = progress::spinner(format!("reading {}", path.display()));
        let mut loaded = open_scene(path, arguments.time.unwrap_or(0.0))?;
        let start_s = loaded.ego.start_s();
        let time_s = arguments.time.unwrap_or(start_s);
        if arguments.time.is_none() && start_s != 0.0 {
            loaded = open_scene(path, start_s)?;
        }
        reading.finish_and_clear();

        let size_px = arguments.size_px();
        let chosen = arguments.cameras.as_deref().filter(|file| !file.exists());
        if let Some(names) = chosen.filter(|_| loaded.rig.cameras().next().is_some()) {
            choose(&mut loaded.rig, names)?;
        }
        let rig = loaded.rig.cameras_mut();
        let squeezed: Vec<String> = rig
            .filter_map(|camera| resize(&camera.name, &mut camera.intrinsics, size_px))
            .collect();
        let is_chosen = chosen.is_some() && loaded.rig.cameras().next().is_some();
        let drives = (arguments.cameras.is_none() || is_chosen)
            && !arguments.orbit.is_asked()
            && arguments.view.is_none()
            && loaded.rig.cameras().next().is_some();
        let mut squeezed = if drives { squeezed } else { Vec::new() };
        let cameras = match &arguments.cameras {
            Some(file) if !is_chosen => {
                let options = CameraOptions {
                    size_px,
                    dataparser: arguments.dataparser.as_deref(),
                };
                let mut cameras = read_cameras(file, &options)?;
                cameras.iter_mut().for_each(|camera| {
                    squeezed.extend(resize(&camera.name, &mut camera.intrinsics, size_px));
                    let own = &mut camera.intrinsics.photometry;
                    *own = own.or(loaded.photometry_of_camera(&camera.name));
                });
                cameras
            }
            _ if arguments.view.is_some() => {
                let view = arguments.view.iter();
                view.map(|view| view.camera("view", size_px.unwrap_or(SIZE_PX)))
                    .collect()
            }
            _ if drives => loaded.rig.driving(&loaded.ego, time_s),
            _ => {
                let (splats, origin) = (&loaded.splat_scene.splats, loaded.splat_scene.origin);
                let around = arguments.orbit.cameras(splats, origin, path, size_px);
                around
                    .with_context(|| format!("{} has no splats that can be seen", path.display()))?
            }
        };
        let rules = &mut loaded.splat_scene.rules;
        if let Some(name) = arguments.rules {
            *rules = Rules {
                antialias: rules.antialias,
                ..name.rules()
            };
        }
        rules.antialias |= arguments.antialias;
        Ok(Self {
            loaded,
            time_s,
            cameras,
            drives,
            squeezed,
        })
    }

    /// Warns of cameras whose images are squeezed: where they are drawn.
    pub fn warn_of_shapes(&self) {
        for sentence in &self.squeezed {
            warn(sentence);
        }
    }

    /// True if the cameras are the ego vehicle's, and drive with it.
    pub fn drives(&self) -> bool {
        self.drives
    }

    /// The same cameras and rules over `loaded`, another state of the same scene.
    pub fn changed(&self, loaded: LoadedScene) -> Self {
        let mut changed = Self {
            loaded,
            time_s: self.time_s,
            cameras: self.cameras.clone(),
            drives: self.drives,
            squeezed: Vec::new(),
        };
        changed.loaded.rig = self.loaded.rig.clone();
        changed.loaded.splat_scene.rules = self.loaded.splat_scene.rules;
        changed
    }

    /// Rules by which splats become an image.
    pub fn rules(&self) -> Rules {
        self.loaded.splat_scene.rules
    }

    /// The cameras `later_s` after the moment of the scene: those of a file stay where they are.
    pub fn cameras_after(&self, later_s: f64) -> Vec<Camera> {
        if !self.drives {
            return self.cameras.clone();
        }
        let mut cameras = self
            .loaded
            .rig
            .driving(&self.loaded.ego, self.time_s + later_s);
        cameras.truncate(self.cameras.len());
        cameras
    }

    /// Background and agents as one cloud, at the moment of the scene: what the f64 definition
    /// draws.
    pub fn splat_scene(&self) -> SplatScene {
        if self.loaded.agents.is_empty() {
            self.loaded.splat_scene.clone()
        } else {
            self.loaded.baked(self.time_s)
        }
    }
}
