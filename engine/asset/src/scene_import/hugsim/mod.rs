//! Scenes of HUGSIM (Zhou et al., "HUGSIM: A Real-Time, Photo-Realistic and Closed-Loop Simulator
//! for Autonomous Driving", 2024): a folder with a checkpoint of the static scene, one per actor,
//! and the metadata of the recording.
//!
//! | file | becomes |
//! |---|---|
//! | `scene.pth` | background and ground, in one cloud |
//! | `dynamic_<id>.pth` | an actor |
//! | `meta_data.json` | cameras, trajectory of the ego, trajectories of actors, a lane along the recording |
//!
//! The source's world has x right, y down and z forward of the first camera. Here it is turned to
//! x forward, y left and z up: (x, y, z) becomes (z, -x, -y). Colors turn with the world. HUGSIM
//! evaluates them in directions of the world for actors too, so `sh_frame` is `world`.

mod appearance;
mod model;
mod recording;

use std::path::{Path, PathBuf};

use decouplegs_scene::{Pose, Presence, Rules, SplatCloud, Trajectory};
use glam::{DMat3, DQuat, DVec3};

use super::{ImportOptions, ImportedActor, ImportedScene};
use crate::checkpoint::{self, Checkpoint};
use crate::error::read_bytes;
use crate::{AssetError, DecodeError};
use recording::Recording;

/// Checkpoint of the static scene. A folder that has it is a scene of HUGSIM.
const SCENE: &str = "scene.pth";
/// Data set's metadata, as HUGSIM's preprocessing writes it.
const METADATA: &str = "meta_data.json";
const ACTOR: &str = "dynamic_";
const CHECKPOINT: &str = ".pth";
/// Files whose data is not read, with the reason.
const LEFT_OUT: [(&str, &str); 2] = [
    (
        "unicycle_",
        "smoothed trajectories of actors; those of meta_data.json are taken",
    ),
    (
        "ground_param",
        "camera heights; the ground's own splats give the height",
    ),
];

/// Turn from the source's world to ours: columns are the images of its axes.
const TURN: DMat3 = DMat3::from_cols(
    DVec3::new(0.0, -1.0, 0.0),
    DVec3::new(0.0, 0.0, -1.0),
    DVec3::new(1.0, 0.0, 0.0),
);

/// Bytes of the files of a scene of HUGSIM.
#[derive(Clone, Copy, Debug)]
pub struct HugsimFiles<'a> {
    /// Checkpoint of the static scene.
    pub scene: &'a [u8],
    /// Metadata, JSON. None: no cameras, and actors are not placed.
    pub metadata: Option<&'a [u8]>,
    /// Checkpoints of actors, by the ids of their file names.
    pub actors: &'a [(String, Vec<u8>)],
}

/// True if `folder` holds a scene of HUGSIM, or something under its name: what that is instead of a
/// file is said where it is read.
pub(super) fn is_scene(folder: &Path) -> bool {
    is_there(&folder.join(SCENE))
}

/// True if anything has the name, also a link that leads nowhere.
fn is_there(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

/// True if a checkpoint is one of HUGSIM: a tuple, where others save dictionaries.
pub(super) fn is_checkpoint(checkpoint: &Checkpoint<'_>) -> bool {
    model::parts(checkpoint).is_some()
}

/// Reads the scene in `folder`.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub(super) fn read(folder: &Path, options: &ImportOptions) -> Result<ImportedScene, AssetError> {
    let scene_path = folder.join(SCENE);
    let scene = read_bytes(&scene_path)?;
    let metadata_path = folder.join(METADATA);
    let metadata = is_there(&metadata_path)
        .then(|| read_bytes(&metadata_path))
        .transpose()?;
    let (actor_files, left_out) = list(folder)?;
    let mut actors = Vec::new();
    for (id, path) in actor_files {
        actors.push((id, read_bytes(&path)?));
    }
    let files = HugsimFiles {
        scene: &scene,
        metadata: metadata.as_deref(),
        actors: &actors,
    };
    let mut scene = decode(&files, options).map_err(|fault| AssetError::Decode {
        format: match fault.file.as_str() {
            METADATA => "HUGSIM's metadata",
            _ => checkpoint::NAME,
        },
        path: folder.join(fault.file),
        source: fault.error,
    })?;
    scene.notes.extend(left_out);
    Ok(scene)
}

/// Files of actors by their ids, in the order of their names, and notes on files that are not read.
#[expect(clippy::type_complexity, reason = "one caller takes it apart at once")]
fn list(folder: &Path) -> Result<(Vec<(String, PathBuf)>, Vec<String>), AssetError> {
    let unreadable = |source| AssetError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let name = entry.map_err(unreadable)?.file_name();
        names.extend(name.into_string());
    }
    names.sort();
    let actors = names.iter().filter_map(|name| {
        let id = name.strip_prefix(ACTOR)?.strip_suffix(CHECKPOINT)?;
        is_plain(id).then(|| (id.to_owned(), folder.join(name)))
    });
    let notes = LEFT_OUT.iter().filter_map(|(prefix, why)| {
        let count = names.iter().filter(|name| name.starts_with(prefix)).count();
        (count > 0).then(|| format!("{prefix}* is left out ({count} files): {why}"))
    });
    Ok((actors.collect(), notes.collect()))
}

/// True for names that are fit for files: letters, digits, '-' and '_'.
fn is_plain(name: &str) -> bool {
    let is_fit = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
    !name.is_empty() && name.len() <= 100 && name.bytes().all(is_fit)
}

/// A fault, and the file that has it.
#[derive(Debug)]
pub struct HugsimFault {
    /// File name in the scene's folder.
    pub file: String,
    /// Fault of the file.
    pub error: DecodeError,
}

impl std::fmt::Display for HugsimFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file, self.error)
    }
}

impl std::error::Error for HugsimFault {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.error)
    }
}

/// Reads a scene from the bytes of its files.
///
/// # Errors
/// The first fault, with its file.
pub fn decode(
    files: &HugsimFiles<'_>,
    options: &ImportOptions,
) -> Result<ImportedScene, HugsimFault> {
    let in_scene = |error| fault(SCENE, error);
    let checkpoint = Checkpoint::parse(files.scene).map_err(in_scene)?;
    let (mut scene, ground) = of_checkpoint(&checkpoint, files)?;
    let Some(metadata) = files.metadata else {
        let count = files.actors.len();
        scene.notes.push(format!(
            "there is no {METADATA}: the scene has no cameras, and {count} actors are written and not placed"
        ));
        return Ok(scene);
    };
    let in_metadata = |error| fault(METADATA, error);
    let recording = Recording::decode(metadata, options.frame_rate_hz).map_err(in_metadata)?;
    place_actors(&mut scene, &recording);
    recording
        .place_ego(ground.as_ref(), &mut scene)
        .map_err(in_metadata)?;
    let views = (recording.views(), options.image);
    appearance::apply(&checkpoint, views, &mut scene).map_err(in_scene)?;
    Ok(scene)
}

fn fault(file: &str, error: DecodeError) -> HugsimFault {
    HugsimFault {
        file: file.to_owned(),
        error,
    }
}

/// Background and actors, in our axes, nothing placed yet; and the ground, which is part of the
/// background.
fn of_checkpoint(
    checkpoint: &Checkpoint<'_>,
    files: &HugsimFiles<'_>,
) -> Result<(ImportedScene, Option<SplatCloud>), HugsimFault> {
    let (mut background, ground) =
        model::background_and_ground(checkpoint).map_err(|error| fault(SCENE, error))?;
    let mut notes = vec![
        "the world is turned to x forward, y left, z up of the first camera".to_owned(),
        "classes of splats (feats3D) are left out".to_owned(),
    ];
    if let Some(ground) = &ground {
        notes.push(format!(
            "{} splats of the ground are part of the background",
            ground.len()
        ));
        background.append(ground);
    }
    let mut actors = Vec::new();
    for (id, bytes) in files.actors {
        let file = format!("{ACTOR}{id}{CHECKPOINT}");
        let splats = Checkpoint::parse(bytes)
            .and_then(|checkpoint| model::actor(&checkpoint))
            .map_err(|error| fault(&file, error))?;
        actors.push(ImportedActor {
            name: format!("{ACTOR}{id}"),
            class: None,
            splats,
            trajectory: None,
            present: Presence::ALWAYS,
        });
    }
    notes.push(
        "the far plane of HUGSIM, 500 m, does not exist here: splats beyond it are drawn".into(),
    );
    let scene = ImportedScene {
        background,
        actors,
        rules: Rules::GSPLAT16,
        notes,
        ..ImportedScene::empty("HUGSIM")
    };
    Ok((scene, ground))
}

/// The scene of `scene.pth` alone.
pub(super) fn scene(checkpoint: &Checkpoint<'_>) -> Result<ImportedScene, DecodeError> {
    let alone = HugsimFiles {
        scene: &[],
        metadata: None,
        actors: &[],
    };
    let (mut scene, _) =
        of_checkpoint(checkpoint, &alone).map_err(|HugsimFault { error, .. }| error)?;
    let note = "this is one file of a HUGSIM scene: convert its folder for cameras and actors";
    scene.notes.push(note.into());
    Ok(scene)
}

/// Gives actors their trajectories, and turns their splats to the axes of their boxes.
fn place_actors(scene: &mut ImportedScene, recording: &Recording) {
    let mut lost = 0;
    for actor in &mut scene.actors {
        let id = actor.name.trim_start_matches(ACTOR);
        let Some(track) = recording.track(id) else {
            lost += 1;
            continue;
        };
        let axes = box_axes(&track.trajectory, &actor.splats);
        let local = Pose::new(axes, DVec3::ZERO);
        actor.splats = std::mem::take(&mut actor.splats).placed(&local, false);
        let back = local.inverse();
        let poses = track.trajectory.poses().iter().map(|timed| {
            let mut timed = *timed;
            timed.pose = timed.pose.then(&back);
            timed
        });
        actor.trajectory = Trajectory::new(poses.collect()).ok();
        actor.present = track.present.clone();
    }
    if lost > 0 {
        scene.notes.push(format!(
            "{lost} of {} actors are in no frame of {METADATA}: written, and not placed",
            scene.actors.len()
        ));
    }
}

/// Turn from the axes of an actor's file to x forward, y left, z up: the one of the 24 turns by
/// quarters that brings its z closest to the vertical, and its x closest to the direction of
/// travel, or along the longer side of a car that stands.
fn box_axes(trajectory: &Trajectory, splats: &SplatCloud) -> DQuat {
    const MOVED_M: f64 = 1.0;
    let poses = trajectory.poses();
    let (first, last) = (poses[0].pose, poses[poses.len() - 1].pose);
    let moved = first.translation.distance(last.translation) > MOVED_M;
    let half_extent = DVec3::from_array(splats.bounds().half_extent().map(f64::from));
    let quality = |axes: DQuat| {
        let [forward, up] = [DVec3::X, DVec3::Z].map(|axis| axes.inverse() * axis);
        let upright: f64 = poses.iter().map(|timed| (timed.pose.rotation * up).z).sum();
        let ahead = if moved {
            let steps = poses.windows(2).map(|pair| [pair[0].pose, pair[1].pose]);
            let travels = steps.map(|[from, to]| (from, to.translation - from.translation));
            let (along, length) = travels.fold((0.0, 1e-9), |(along, length), (pose, travel)| {
                (
                    along + (pose.rotation * forward).dot(travel),
                    length + travel.length(),
                )
            });
            along / length
        } else {
            0.5 * forward.abs().dot(half_extent) / half_extent.max_element().max(1e-9)
        };
        // Upright first: a car may drive backwards, and never lies on its side.
        10.0 * upright / poses.len() as f64 + ahead
    };
    let turns = quarter_turns();
    let best = turns.into_iter().map(|axes| (quality(axes), axes));
    best.max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map_or(DQuat::IDENTITY, |(_, axes)| axes)
}

/// The 24 turns that map axes to axes, and the identity once more at the end: the last of equals
/// is chosen.
fn quarter_turns() -> Vec<DQuat> {
    let axes = [
        DVec3::X,
        DVec3::NEG_X,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::Z,
        DVec3::NEG_Z,
    ];
    let mut turns = Vec::new();
    for x in axes {
        for y in axes {
            if x.dot(y) == 0.0 {
                let turn = DMat3::from_cols(x, y, x.cross(y));
                turns.push(DQuat::from_mat3(&turn));
            }
        }
    }
    turns.push(DQuat::IDENTITY);
    turns
}
