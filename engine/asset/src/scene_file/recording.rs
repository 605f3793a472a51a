//! The drive on which a scene was recorded, as a scene file tells of it.

use std::path::{Path, PathBuf};

use decouplegs_scene::{CapturedViews, Obstacle, VehicleSize};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::files::SceneFiles;
use crate::toml_text::Checker;
use crate::{AssetError, PlacedSplats, SceneError, cameras, obstacle_file};

/// The drive on which a scene was recorded. All of it may be unknown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneRecording {
    /// Views that the scene was captured from. `None`: those of the ego's way, if it has one.
    pub seen_from: Option<SeenFrom>,
    /// Box of the vehicle that recorded; the ego's poses are those of its middle.
    pub vehicle_size: Option<VehicleSize>,
    /// Surveyed ground, a mesh or points (PLY) about [`crate::SceneFile::origin`]. A path relative
    /// to the scene file.
    pub ground: Option<PathBuf>,
    /// File of the obstacles beside the way, world coordinates ([`crate::read_obstacles`]). A path
    /// relative to the scene file.
    pub obstacles: Option<PathBuf>,
}

/// Views that a scene was captured from, as its file names them.
#[derive(Clone, Debug, PartialEq)]
pub enum SeenFrom {
    /// The scene looks right from everywhere.
    Everywhere,
    /// File of the cameras of the images that the scene was trained on: INRIA's or nerfstudio's
    /// JSON. A path relative to the scene file.
    Cameras(PathBuf),
}

impl SeenFrom {
    /// The word for [`SeenFrom::Everywhere`] in a file.
    const EVERYWHERE: &'static str = "everywhere";

    /// The file of cameras, if there is one.
    pub(crate) fn file_mut(&mut self) -> Option<&mut PathBuf> {
        match self {
            Self::Everywhere => None,
            Self::Cameras(file) => Some(file),
        }
    }
}

/// A recording, its files read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadedRecording {
    /// Views that the scene was captured from; `None` where the file tells none.
    pub views: Option<CapturedViews>,
    /// Box of the vehicle that recorded; the ego's poses are those of its middle.
    pub vehicle_size: Option<VehicleSize>,
    /// Points of the ground, world coordinates, meters: those of a survey, else of splats that are
    /// labeled road; none where there are neither.
    pub ground_m: Vec<DVec3>,
    /// Obstacles beside the way, world coordinates; `None` where the file tells nothing of them.
    pub obstacles: Option<Vec<Obstacle>>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecordingForm {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    seen_from: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    vehicle_size_m: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ground: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    obstacles: Option<String>,
}

/// Lengths of the sides of a vehicle, meters.
const SIDE_M: std::ops::RangeInclusive<f64> = 0.1..=30.0;

/// Size of images of which a camera file tells none: only where they were taken is asked.
const ANY_SIZE_PX: [u32; 2] = [1600, 900];

impl RecordingForm {
    pub(super) fn from_recording(
        recording: &SceneRecording,
        path: impl Fn(&Path) -> Result<String, String>,
    ) -> Result<Option<Self>, String> {
        let seen_from = match &recording.seen_from {
            None => None,
            Some(SeenFrom::Everywhere) => Some(SeenFrom::EVERYWHERE.to_owned()),
            // A file may have the name of the word.
            Some(SeenFrom::Cameras(file)) if file.as_os_str() == SeenFrom::EVERYWHERE => {
                Some(path(&Path::new(".").join(file))?)
            }
            Some(SeenFrom::Cameras(file)) => Some(path(file)?),
        };
        let vehicle_size_m = recording.vehicle_size.map(|size| size.to_array());
        let ground = recording.ground.as_deref().map(&path).transpose()?;
        let obstacles = recording.obstacles.as_deref().map(path).transpose()?;
        let is_empty = seen_from.is_none()
            && vehicle_size_m.is_none()
            && ground.is_none()
            && obstacles.is_none();
        Ok((!is_empty).then_some(Self {
            seen_from,
            vehicle_size_m,
            ground,
            obstacles,
        }))
    }

    pub(super) fn checked(
        form: &Spanned<Self>,
        checker: &Checker<'_>,
    ) -> Result<SceneRecording, SceneError> {
        let own = form.get_ref();
        let error = |key, reason: String| checker.error(&form.span(), "recording", key, reason);
        let seen_from = match own.seen_from.as_deref() {
            None => None,
            Some("") => {
                let reason = "must be a file of cameras, or \"everywhere\"";
                return Err(error("seen_from", reason.into()));
            }
            Some(SeenFrom::EVERYWHERE) => Some(SeenFrom::Everywhere),
            Some(file) => Some(SeenFrom::Cameras(file.into())),
        };
        let sides_m = own.vehicle_size_m.unwrap_or([1.0; 3]);
        if !sides_m.iter().all(|side_m| SIDE_M.contains(side_m)) {
            let (least_m, most_m) = (SIDE_M.start(), SIDE_M.end());
            let reason = format!(
                "must be length, width and height of a vehicle, each {least_m} to {most_m} meters"
            );
            return Err(error("vehicle_size_m", reason));
        }
        if own.ground.as_deref() == Some("") {
            let reason = "must be a file of points or a mesh (.ply)";
            return Err(error("ground", reason.into()));
        }
        if own.obstacles.as_deref() == Some("") {
            let reason = "must be a file of obstacles (.json)";
            return Err(error("obstacles", reason.into()));
        }
        Ok(SceneRecording {
            obstacles: own.obstacles.as_ref().map(PathBuf::from),
            ground: own.ground.as_ref().map(PathBuf::from),
            seen_from,
            vehicle_size: own.vehicle_size_m.map(VehicleSize::from_array),
        })
    }
}

/// Road of `background`, meters from the origin of its scene.
pub(super) fn road_about_scene(background: &PlacedSplats) -> Vec<DVec3> {
    let points = background.road_points_m().into_iter();
    points.map(|point| point + background.origin).collect()
}

impl SceneRecording {
    /// Reads the cameras, the ground and the obstacles from `files`; `background` is that of the
    /// scene at `origin`.
    pub(super) fn load(
        &self,
        files: &dyn SceneFiles,
        background: &PlacedSplats,
        origin: DVec3,
    ) -> Result<LoadedRecording, AssetError> {
        let views = match &self.seen_from {
            None => None,
            Some(SeenFrom::Everywhere) => Some(CapturedViews::Everywhere),
            Some(SeenFrom::Cameras(file)) => {
                let cameras = cameras::decode(&files.bytes(file)?, Some(ANY_SIZE_PX));
                let cameras = cameras.map_err(|source| AssetError::Cameras {
                    path: files.path(file),
                    source,
                })?;
                Some(CapturedViews::from_cameras(&cameras))
            }
        };
        let obstacles = self.obstacles.as_ref().map(|file| {
            obstacle_file::decode(&files.bytes(file)?).map_err(|source| AssetError::Decode {
                path: files.path(file),
                format: "obstacle",
                source,
            })
        });
        let ground = match &self.ground {
            Some(file) => files.ground(file)?,
            None => road_about_scene(background),
        };
        Ok(LoadedRecording {
            obstacles: obstacles.transpose()?,
            views,
            vehicle_size: self.vehicle_size,
            ground_m: ground.into_iter().map(|point| point + origin).collect(),
        })
    }
}
