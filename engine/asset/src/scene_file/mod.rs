//! Scene file: a background, its cameras, the way of the ego vehicle and the agents, as TOML.
//!
//! The format is documented, with an example, in `engine/asset/scene-file.md`.

mod camera_text;
mod check;
mod check_light;
pub mod editing;
mod files;
mod form;
mod layer;
mod lens;
mod lidar;
mod load;
mod paths;
mod photometry;
mod recording;
mod shutter;

use std::io::Write;
use std::path::{Path, PathBuf};

use decouplegs_scene::light::{AmbientOptions, CastingLights, RelightOptions, ShadowOptions};
use decouplegs_scene::{Fog, Invalid, Photometry, Presence, Rig, Rules, ShFrame, Trajectory};
use glam::{DMat3, DVec3};

use crate::error::read_bytes;
use crate::packed_scene::is_package;
use crate::toml_text::text_of;
use crate::{AssetError, PlacedSplats, SceneError, SkyKind, read_ground, write_atomically};

pub use camera_text::{camera_json, cameras_from_text};
pub use editing::EditError;
pub(crate) use files::SceneFiles;
pub use layer::Layer;
pub use lidar::SceneLidar;
pub use load::{AgentLabel, LoadedAgent, LoadedLight, LoadedScene, PlainAgent, open_scene};
pub use paths::path_from;
pub use recording::{LoadedRecording, SceneRecording, SeenFrom};

/// The version that is written, and the only one there is.
pub const VERSION: u32 = 1;

/// True if `path` is named like a scene file, and not like a package or a splat file.
#[must_use]
pub fn is_scene_file(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// A scene as its file describes it, checked: names are unique, poses rigid, times rise, intrinsics
/// make images.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// World coordinates of the point that the background's means are relative to, meters.
    pub origin: DVec3,
    /// Splats of the background, a path relative to the scene file.
    pub background: PathBuf,
    /// Color where no splat is, display-referred RGB. Not used where there is a
    /// [`SceneFile::sky_map`].
    pub sky: [f32; 3],
    /// Colors where no splat is, by direction. `None`: [`SceneFile::sky`] everywhere.
    pub sky_map: Option<SceneSky>,
    /// Photometric calibration of cameras that have none of their own.
    pub photometry: Photometry,
    /// Fog between the cameras and everything else. `None`: clear air.
    pub fog: Option<Fog>,
    /// Image formation rules.
    pub rules: Rules,
    /// The ego vehicle's cameras.
    pub rig: Rig,
    /// The ego vehicle's LiDARs.
    pub lidars: Vec<SceneLidar>,
    /// Trajectory of the ego vehicle, world coordinates. None: it stands at [`SceneFile::origin`].
    pub ego: Option<Trajectory>,
    /// Height of the ego's poses above the road, meters. `None`: estimated where it is needed.
    pub ego_height_m: Option<f64>,
    /// Drive on which the scene was recorded.
    pub recording: SceneRecording,
    /// Agents in front of the background.
    pub agents: Vec<SceneAgent>,
    /// Light of the background on the agents. None: they keep the light that their assets were
    /// captured in.
    pub light: Option<SceneLight>,
}

/// The sky of a scene file: an image around the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSky {
    /// Image, a path relative to the scene file.
    pub file: PathBuf,
    /// Layout of the image.
    pub kind: SkyKind,
    /// Rotation or reflection from the sky's frame to the world's.
    pub world_from_sky: DMat3,
    /// True if its colors are clamped to 0 to 1.
    pub clamps: bool,
    /// True if the blended color of splats is clamped to at most 1 before the sky is added.
    pub clamps_splats: bool,
}

impl SceneSky {
    /// The sky in `file`, in the frame of the world, nothing clamped.
    #[must_use]
    pub fn new(file: impl Into<PathBuf>, kind: SkyKind) -> Self {
        Self {
            file: file.into(),
            kind,
            world_from_sky: DMat3::IDENTITY,
            clamps: false,
            clamps_splats: false,
        }
    }
}

/// The light of a scene file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneLight {
    /// Effect of light on colors: a path relative to the scene file, written by `calibrate-light`.
    /// None: colors stay.
    pub transfer: Option<PathBuf>,
    /// Options of that effect.
    pub relighting: RelightOptions,
    /// Distance from which that light is gathered, and its grid.
    pub ambient: AmbientOptions,
    /// Contact shadows. None: agents throw none.
    pub shadows: Option<ShadowOptions>,
    /// Lights that cast shadows of agents; only with contact shadows.
    pub casting: CastingLights,
}

/// An agent of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneAgent {
    /// Names the agent; unique in the scene.
    pub name: String,
    /// Class of what it shows, as perception names it: car, truck, pedestrian. `None`: unknown.
    pub class: Option<String>,
    /// Splat file, a path relative to the scene file. Agents may share one.
    pub asset: PathBuf,
    /// Frame of the asset's colors. None: as the asset says, canonical for a plain splat file.
    pub sh_frame: Option<ShFrame>,
    /// Trajectory, world coordinates.
    pub trajectory: Trajectory,
    /// Times at which it is in the scene.
    pub present: Presence,
}

impl SceneFile {
    /// A scene of a background alone, at the origin, by the default rules.
    #[must_use]
    pub fn of_background(background: impl Into<PathBuf>) -> Self {
        Self {
            origin: DVec3::ZERO,
            background: background.into(),
            sky: [0.0; 3],
            sky_map: None,
            photometry: Photometry::IDENTITY,
            fog: None,
            rules: Rules::DEFAULT,
            rig: Rig::default(),
            lidars: Vec::new(),
            ego: None,
            ego_height_m: None,
            recording: SceneRecording::default(),
            agents: Vec::new(),
            light: None,
        }
    }

    /// Reads the scene file at `path`.
    ///
    /// # Errors
    /// [`AssetError::Read`], or [`AssetError::Scene`] with line, key and reason. A package is
    /// refused: its scene file names files that are in it.
    pub fn read(path: &Path) -> Result<Self, AssetError> {
        let bytes = read_bytes(path)?;
        if is_package(path) {
            let path = path.display();
            return Err(AssetError::Placement(format!(
                "{path}: expected a scene file (.toml), found a package; `decouplegs convert {path} FOLDER` makes a folder with its scene file"
            )));
        }
        let scene_error = |source| AssetError::Scene {
            path: path.to_owned(),
            source,
        };
        text_of(&bytes).and_then(Self::parse).map_err(scene_error)
    }

    /// Reads a scene from the text of a file.
    ///
    /// # Errors
    /// A [`SceneError`] with line, key and reason.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        check::parse(text)
    }

    /// The text of a file that describes this scene. Reading it gives the same scene.
    ///
    /// # Errors
    /// A sentence, when a path is not Unicode.
    pub fn to_toml(&self) -> Result<String, Invalid> {
        Ok(form::to_toml(self)?)
    }

    /// Points of the ground of this scene file in `directory`, world coordinates, meters: those of
    /// its survey, else of splats of its `background` that are labeled road.
    ///
    /// # Errors
    /// [`AssetError`] of the file of the survey.
    pub fn read_ground(
        &self,
        directory: &Path,
        background: &PlacedSplats,
    ) -> Result<Vec<DVec3>, AssetError> {
        let points = match &self.recording.ground {
            Some(file) => read_ground(&directory.join(file))?,
            None => recording::road_about_scene(background),
        };
        Ok(points
            .into_iter()
            .map(|point| point + self.origin)
            .collect())
    }

    /// Writes the scene file to `path`, atomically.
    ///
    /// # Errors
    /// [`AssetError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), AssetError> {
        let text = self.to_toml().map_err(|reason| AssetError::Write {
            path: path.to_owned(),
            source: std::io::Error::other(reason),
        })?;
        write_atomically(path, |file| file.write_all(text.as_bytes()))
    }
}
