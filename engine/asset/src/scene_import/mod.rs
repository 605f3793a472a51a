//! Scenes of other trainers, taken apart into a background and actors, as a scene file and its
//! assets.
//!
//! | source | tracks |
//! |---|---|
//! | drivestudio, OmniRe (`checkpoint_*.pth`): `Background` and `RigidNodes` | in the checkpoint, one pose a frame; frames have no times, so a rate is asked for |
//! | HUGSIM (a folder with `scene.pth`) | in its `meta_data.json`, with cameras and the path of the ego |
//! | Street Gaussians (`.pth`, or the `.ply` with an element for each model): `background` and `obj_*` | in the data set alone: the checkpoint holds corrections; given beside it, or actors are written and not placed |
//!
//! Actors are in the frame of their boxes, x forward, y left, z up, origin in the middle. All
//! trainers evaluate spherical harmonics in the directions of the world and do not turn them, so
//! every actor's `sh_frame` is `world`.
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
mod sky;
mod street_gaussians;

use std::path::Path;

use decouplegs_scene::{
    LaneMap, Photometry, Presence, Rig, Rules, ShFrame, SkyMap, SplatCloud, Trajectory,
};

use crate::checkpoint::{self, Checkpoint};
use crate::error::read_bytes;
use crate::maps::lane_json;
use crate::ply::Ply;
use crate::sky_file::write_cube;
use crate::{AssetError, DecodeError, SceneAgent, SceneFile, SceneSky, SkyKind, inria_ply};

pub use hugsim::{HugsimFault, HugsimFiles, decode as decode_hugsim};

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
    /// Static splats, z up.
    pub background: SplatCloud,
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
    /// Trajectory of the ego vehicle during the recording.
    pub ego: Option<Trajectory>,
    /// A lane along the recording.
    pub lanes: Option<LaneMap>,
    /// Omissions and interpretations, one sentence each.
    pub notes: Vec<String>,
}

/// Something that moves as a whole.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedActor {
    /// Names it; unique in its scene, and fit for a file name.
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
    let bytes = read_bytes(path)?;
    let (format, decoded) = match bytes.as_slice() {
        [b'P', b'K', 3, 4, ..] if is_checkpoint(&bytes) => {
            (checkpoint::NAME, decode_checkpoint(&bytes, options))
        }
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

fn is_checkpoint(bytes: &[u8]) -> bool {
    crate::zip::Archive::parse(bytes).is_ok_and(|archive| checkpoint::is_checkpoint(&archive))
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
    if !ply.has_element("vertex_background") {
        return Ok(None);
    }
    street_gaussians::scene_of_ply(&ply, options).map(Some)
}

impl ImportedScene {
    /// A scene of `source` without splats, by the default rules.
    fn empty(source: &'static str) -> Self {
        Self {
            source,
            background: SplatCloud::with_degree(0),
            actors: Vec::new(),
            sky: None,
            photometry: Photometry::IDENTITY,
            rules: Rules::DEFAULT,
            rig: Rig::default(),
            ego: None,
            lanes: None,
            notes: Vec::new(),
        }
    }

    /// Writes `scene.toml`, `background.ply`, `assets/*.ply` and, where there are such, `sky.exr`
    /// and `lanes.json` into `folder`, which exists.
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
        inria_ply::write(&folder.join("background.ply"), &self.background)?;
        let mut scene = SceneFile {
            photometry: self.photometry,
            rules: self.rules,
            rig: self.rig.clone(),
            ego: self.ego.clone(),
            ..SceneFile::of_background("background.ply")
        };
        for actor in &self.actors {
            let asset = Path::new("assets").join(format!("{}.ply", actor.name));
            inria_ply::write(&folder.join(&asset), &actor.splats)?;
            if let Some(trajectory) = &actor.trajectory {
                scene.agents.push(SceneAgent {
                    name: actor.name.clone(),
                    class: actor.class.clone(),
                    asset,
                    sh_frame: Some(ShFrame::World),
                    trajectory: trajectory.clone(),
                    present: actor.present.clone(),
                });
            }
        }
        if let Some(sky) = &self.sky {
            let file = "sky.exr";
            write_cube(&folder.join(file), sky.face_texels(), &sky.texels())?;
            scene.sky_map = Some(SceneSky {
                world_from_sky: sky.sky_from_world().transpose(),
                clamps: sky.clamps,
                clamps_splats: sky.clamps_splats,
                ..SceneSky::new(file, SkyKind::Cube)
            });
        }
        if let Some(lanes) = &self.lanes {
            lane_json::write(&folder.join("lanes.json"), lanes)?;
        }
        // Last: a scene that is found is complete.
        scene.write(&folder.join("scene.toml"))?;
        Ok(scene)
    }
}
