//! Scenes of other trainers, taken apart into a background and actors, as a scene file and its
//! assets.
//!
//! | source | tracks |
//! |---|---|
//! | drivestudio, OmniRe (`checkpoint_*.pth`): `Background` and `RigidNodes` | in the checkpoint, one pose a frame; frames have no times, so a rate is asked for |
//! | HUGSIM (a folder with `scene.pth`) | in its `meta_data.json`, with cameras and the path of the ego |
//! | NuRec (a `.usdz` with `volume.nurec` or `checkpoint.ckpt`): `nurec` says what is read | in the package, with cameras and the path of the ego |
//! | Street Gaussians (`.pth`, or the `.ply` with an element for each model): `background` and `obj_*` | in the data set alone: the checkpoint holds corrections; given beside it, or actors are written and not placed |
//!
//! Actors are in the frame of their boxes, x forward, y left, z up, origin in the middle. All
//! trainers but NuRec evaluate spherical harmonics in the directions of the world and do not turn
//! them, so every actor's `sh_frame` is `world`.
//!
//! Left out, with a line in [`ImportedScene::notes`] each: what deforms or walks
//! (`DeformableNodes`, `SMPLNodes`), corrections of camera poses. An actor is present
//! in the frames that have it, from half a frame before to half a frame after. Skies are kept as
//! cube maps; Street Gaussians adds its own only where more than 0.001 of the light comes through,
//! here it is added everywhere. Color corrections become the photometry of the scene: the one of
//! views that were not trained on, or that of [`ImportOptions::image`].

mod colors;
mod drivestudio;
mod hugsim;
pub(crate) mod nurec;
mod sky;
mod street_gaussians;

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use decouplegs_scene::{
    LaneMap, Photometry, Pose, Presence, Rig, Rules, ShFrame, SkyMap, SplatCloud, Trajectory,
};
use glam::DVec3;

use crate::checkpoint::{self, Checkpoint};
use crate::error::read_bytes;
use crate::maps::lane_json;
use crate::ply::Ply;
use crate::sky_file::write_cube;
use crate::zip::Archive;
use crate::{
    AssetError, DecodeError, SceneAgent, SceneFile, SceneLidar, SceneRecording, SceneSky, SkyKind,
    inria_ply, write_atomically, write_ground,
};

pub use hugsim::{HugsimFault, HugsimFiles, decode as decode_hugsim};

/// Background of a written scene.
pub(crate) const BACKGROUND: &str = "background.ply";
/// Sky of a written scene.
const SKY: &str = "sky.exr";
/// Ground of a written scene.
const GROUND: &str = "ground.ply";

/// Interpretation of data that the files do not define.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Frames a second of a checkpoint whose frames have no times.
    pub frame_rate_hz: f64,
    /// Trajectories of actors, for sources without tracks: by the name of the model (`obj_007`) or
    /// its number (`7`).
    pub tracks: Vec<decouplegs_scene::Track>,
    /// Training image, or camera, whose color correction is taken. `None`: the mean of all.
    pub image: Option<usize>,
}

impl Default for ImportOptions {
    /// Ten frames per second, as nearly all driving data sets have, and no tracks.
    fn default() -> Self {
        Self {
            frame_rate_hz: 10.0,
            tracks: Vec::new(),
            image: None,
        }
    }
}

/// A background and what moves in front of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedScene {
    /// Trainer that wrote the scene.
    pub source: &'static str,
    /// World coordinates of the point that the background's means are relative to, meters.
    pub origin: DVec3,
    /// Static splats, z up.
    pub background: SplatCloud,
    /// Frame of the actors' colors.
    pub actor_frame: ShFrame,
    /// Moving actors.
    pub actors: Vec<ImportedActor>,
    /// Sky behind the splats.
    pub sky: Option<SkyMap>,
    /// Photometric calibration of images whose cameras have none of their own.
    pub photometry: Photometry,
    /// Image formation rules of the source.
    pub rules: Rules,
    /// Cameras of the ego vehicle; none where the source does not tell.
    pub rig: Rig,
    /// LiDARs of the recording.
    pub lidars: Vec<ImportedLidar>,
    /// Trajectory of the ego vehicle during the recording.
    pub ego: Option<Trajectory>,
    /// Height of the ego's poses above the road, meters, where the source tells.
    pub ego_height_m: Option<f64>,
    /// A lane along the recording, or the lanes of the map of a package.
    pub lanes: Option<LaneMap>,
    /// Points of the surveyed ground about the origin, meters; none where there is no survey.
    pub ground: Vec<DVec3>,
    /// Omissions and interpretations, one sentence each.
    pub notes: Vec<String>,
}

/// A LiDAR whose model is in the source.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedLidar {
    /// Names it; unique in its scene.
    pub name: String,
    /// Pose on the vehicle.
    pub rig_from_lidar: Pose,
    /// Parameters of its model, JSON that [`crate::read_lidar`] reads.
    pub parameters: String,
}

/// Something that moves as a whole.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedActor {
    /// Names it; unique in its scene.
    pub name: String,
    /// Class of what it shows; `None` where the source does not tell.
    pub class: Option<String>,
    /// Splats in the frame of the actor's box.
    pub splats: SplatCloud,
    /// Trajectory of the actor; `None` where the file has none.
    pub trajectory: Option<Trajectory>,
    /// Times at which it is in the scene.
    pub present: Presence,
}

/// Reads the scene at `path`. None where the file is of another kind: splats alone.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub fn read_scene(
    path: &Path,
    options: &ImportOptions,
) -> Result<Option<ImportedScene>, AssetError> {
    if path.is_dir() {
        return hugsim::is_scene(path)
            .then(|| hugsim::read(path, options))
            .transpose();
    }
    if !may_be_scene(path) {
        return Ok(None);
    }
    let bytes = read_bytes(path)?;
    let (format, decoded) = match bytes.as_slice() {
        [b'P', b'K', 3, 4, ..] => match Archive::parse(&bytes) {
            Ok(archive) if nurec::is_package(&archive) => {
                (nurec::NAME, nurec::scene(&archive).map(Some))
            }
            Ok(archive) if checkpoint::is_checkpoint(&archive) => {
                (checkpoint::NAME, decode_checkpoint(&bytes, options))
            }
            _ => return Ok(None),
        },
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => {
            ("PLY of several models", decode_ply(&bytes, options))
        }
        _ => return Ok(None),
    };
    decoded.map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format,
        source,
    })
}

/// False if the start of the file at `path` tells that it holds splats alone, so that it need not
/// be read whole. What cannot be read is for those who read it to explain.
fn may_be_scene(path: &Path) -> bool {
    // A FIFO is not opened: that waits for its writer.
    if !path.is_file() {
        return true;
    }
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| {
        let mut file = file.take(Ply::HEADER_BYTES_MAX as u64);
        file.read_to_end(&mut start)
    });
    match start.as_slice() {
        _ if read.is_err() => true,
        [b'P', b'K', 3, 4, ..] => true,
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => {
            Ply::header_has(&start, street_gaussians::BACKGROUND_ELEMENT)
        }
        _ => false,
    }
}

/// Reads the scene of a NuRec package, a USDZ with its `volume.nurec` or `checkpoint.ckpt`. `None`
/// for other archives.
///
/// # Errors
/// A [`DecodeError`] that names the entry and the array or key at fault.
pub fn decode_nurec(bytes: &[u8]) -> Result<Option<ImportedScene>, DecodeError> {
    // A broken zip is the package reader's to explain.
    let archive = Archive::parse(bytes).ok().filter(nurec::is_package);
    archive.map(|archive| nurec::scene(&archive)).transpose()
}

/// Reads the scene of a checkpoint. None where it is one of splats alone.
///
/// # Errors
/// A [`DecodeError`] that names the tensor at fault.
pub fn decode_checkpoint(
    bytes: &[u8],
    options: &ImportOptions,
) -> Result<Option<ImportedScene>, DecodeError> {
    let checkpoint = Checkpoint::parse(bytes)?;
    let root = checkpoint.tree.root();
    if let Some(models) = checkpoint.tree.get(root, "models") {
        return drivestudio::scene(&checkpoint, models, options).map(Some);
    }
    if checkpoint.tree.get(root, "background").is_some() {
        return street_gaussians::scene(&checkpoint, root, options).map(Some);
    }
    if hugsim::is_checkpoint(&checkpoint) {
        return hugsim::scene(&checkpoint).map(Some);
    }
    Ok(None)
}

/// Reads the scene of a PLY with an element for each model. None where it has a single one.
///
/// # Errors
/// A [`DecodeError`] that names the element at fault.
pub fn decode_ply(
    bytes: &[u8],
    options: &ImportOptions,
) -> Result<Option<ImportedScene>, DecodeError> {
    // A broken header is the splat reader's to explain.
    let Ok(ply) = Ply::parse(bytes) else {
        return Ok(None);
    };
    if !ply.has_element(street_gaussians::BACKGROUND_ELEMENT) {
        return Ok(None);
    }
    street_gaussians::scene_of_ply(&ply, options).map(Some)
}

impl ImportedScene {
    /// A scene of `source` without splats, by the default rules.
    fn empty(source: &'static str) -> Self {
        Self {
            source,
            origin: DVec3::ZERO,
            background: SplatCloud::with_degree(0),
            actor_frame: ShFrame::World,
            actors: Vec::new(),
            sky: None,
            photometry: Photometry::IDENTITY,
            rules: Rules::DEFAULT,
            rig: Rig::default(),
            lidars: Vec::new(),
            ego: None,
            ego_height_m: None,
            lanes: None,
            ground: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The scene file of this scene, whose files have the names that [`ImportedScene::write`] gives
    /// them. Actors without a trajectory are not named in it.
    pub(crate) fn scene_file(&self) -> SceneFile {
        let agent = |(index, actor): (usize, &ImportedActor)| {
            actor.trajectory.as_ref().map(|trajectory| SceneAgent {
                name: actor.name.clone(),
                class: actor.class.clone(),
                asset: asset_path(index, &actor.name),
                sh_frame: Some(self.actor_frame),
                trajectory: trajectory.clone(),
                present: actor.present.clone(),
            })
        };
        SceneFile {
            origin: self.origin,
            photometry: self.photometry,
            rules: self.rules,
            rig: self.rig.clone(),
            lidars: (self.lidars.iter().enumerate())
                .map(|(index, lidar)| SceneLidar {
                    name: lidar.name.clone(),
                    sensor: lidar_path(index),
                    rig_from_lidar: lidar.rig_from_lidar,
                })
                .collect(),
            ego: self.ego.clone(),
            ego_height_m: self.ego_height_m,
            recording: SceneRecording {
                ground: (!self.ground.is_empty()).then(|| GROUND.into()),
                ..SceneRecording::default()
            },
            agents: self.actors.iter().enumerate().filter_map(agent).collect(),
            sky_map: self.sky.as_ref().map(|sky| SceneSky {
                world_from_sky: sky.sky_from_world().transpose(),
                clamps: sky.clamps,
                clamps_splats: sky.clamps_splats,
                ..SceneSky::new(SKY, SkyKind::Cube)
            }),
            ..SceneFile::of_background(BACKGROUND)
        }
    }

    /// The splats in `file`, a path of [`ImportedScene::scene_file`].
    pub(crate) fn splats(&self, file: &Path) -> Option<&SplatCloud> {
        if file == Path::new(BACKGROUND) {
            return Some(&self.background);
        }
        let mut actors = self.actors.iter().enumerate();
        let found = actors.find(|(index, actor)| asset_path(*index, &actor.name) == file);
        found.map(|(_, actor)| &actor.splats)
    }

    /// Parameters of the LiDAR whose model is `file`, a path of [`ImportedScene::scene_file`].
    pub(crate) fn lidar_parameters(&self, file: &Path) -> Option<&str> {
        let mut lidars = self.lidars.iter().enumerate();
        let found = lidars.find(|(index, _)| lidar_path(*index) == file);
        found.map(|(_, lidar)| lidar.parameters.as_str())
    }

    /// Path of the splats of an actor, by its index, in the folder that [`ImportedScene::write`]
    /// writes.
    ///
    /// # Panics
    /// Panics if there is no such actor.
    #[must_use]
    pub fn asset_path(&self, index: usize) -> PathBuf {
        asset_path(index, &self.actors[index].name)
    }

    /// Writes `scene.toml`, `background.ply`, `assets/*.ply` and, where there are such, `sky.exr`,
    /// `ground.ply`, `lanes.json` and `lidar_*.json` into `folder`, which exists.
    ///
    /// Actors without a trajectory are written, and not named in the scene.
    ///
    /// # Errors
    /// [`AssetError::Write`].
    pub fn write(&self, folder: &Path) -> Result<SceneFile, AssetError> {
        let assets = folder.join("assets");
        std::fs::create_dir_all(&assets).map_err(|source| AssetError::Write {
            path: assets.clone(),
            source,
        })?;
        inria_ply::write(&folder.join(BACKGROUND), &self.background)?;
        for (index, actor) in self.actors.iter().enumerate() {
            inria_ply::write(&folder.join(self.asset_path(index)), &actor.splats)?;
        }
        if let Some(sky) = &self.sky {
            write_cube(&folder.join(SKY), sky.face_texels(), &sky.texels())?;
        }
        if !self.ground.is_empty() {
            write_ground(&folder.join(GROUND), &self.ground)?;
        }
        for (index, lidar) in self.lidars.iter().enumerate() {
            write_atomically(&folder.join(lidar_path(index)), |file| {
                file.write_all(lidar.parameters.as_bytes())
            })?;
        }
        if let Some(lanes) = &self.lanes {
            lane_json::write(&folder.join("lanes.json"), lanes)?;
        }
        // Last: a scene that is found is complete.
        let scene = self.scene_file();
        scene.write(&folder.join("scene.toml"))?;
        Ok(scene)
    }
}

/// Path of the model of the LiDAR `index`.
fn lidar_path(index: usize) -> PathBuf {
    format!("lidar_{index}.json").into()
}

/// Path of the splats of the actor `name`: by its name where a file may be called so, else by its
/// `index`.
fn asset_path(index: usize, name: &str) -> PathBuf {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    let is_fit = !name.is_empty() && name.len() <= 100 && name.chars().all(fits);
    let stem = match is_fit {
        true => name.to_owned(),
        // A dot, which no name that fits has: the two never meet.
        false => format!("{index:04}.agent"),
    };
    Path::new("assets").join(format!("{stem}.ply"))
}
