//! NuRec's packages: USDZ with the splats of a drive, its rig and tracks.
//!
//! Entries that are read, after public readers and writers of the form (3dgrut's
//! `threedgrut/export` at a37ef72, AlpaSim's `src/utils/alpasim_utils` at 3032e0cf, ppisp):
//!
//! | entry | what is read |
//! |---|---|
//! | `volume.nurec`, else `checkpoint.ckpt`, else every `*.nurec` | layers of splats: those with `gaussian_cuboid_ids` are agents, in the frames of their boxes; the others are the background |
//! | the same, `background.textures` | the sky, six faces in OpenGL's order |
//! | the same, `post_processings.0.ppisp` | photometry of the cameras, in the order of `camera_ids` of `metadata.yaml` |
//! | the `.usda` of the volume, where there is no rig | the frame of the splats: its transform |
//! | `rig_trajectories.json` | cameras, LiDARs (`lidar_model`, NCore's parameters), way of the ego, `world_to_nre`: the frame of the splats |
//! | `mesh_ground.ply`, else the layer `road` | the ground that vehicles stand on |
//! | `sequence_tracks.json` | classes and ways of the agents |
//! | `datasource_summary.json` | both of the above, in older packages |
//!
//! **World** is the one of rig and tracks: splats and their colors are turned into it. Where it is
//! farther than 20 km from the frame of the splats, that frame's origin becomes the scene's.
//! **Times** are seconds from the first pose of the rig. **Poses** of the
//! ego are those of the middle of its box, where the package has one.
//!
//! Rendering there is 3DGUT: unscented transform and evaluation along rays. Here splats are drawn
//! as all others, by EWA.

mod layers;
mod ppisp;
mod rig;
mod stage;
mod state;
mod tracks;
mod value;

use std::collections::{HashMap, HashSet};

use decouplegs_scene::{Pose, ShFrame, SkyMap, SplatCloud};
use glam::{DMat3, DVec3};

use super::{ImportedActor, ImportedScene};
use crate::DecodeError;
use crate::ground_file::{self, points_of_road};
use crate::zip::Archive;
use layers::Layer;
use rig::{PackageRig, RIG};
use state::State;
use tracks::{BoxTrack, TRACKS};

/// Name of the format in messages.
pub(crate) const NAME: &str = "NuRec package";
/// Entries that hold splats, in the order in which they are tried.
const VOLUMES: [&str; 2] = ["volume.nurec", "checkpoint.ckpt"];
/// The ground as a mesh, in the world of rig and tracks.
const GROUND: &str = "mesh_ground.ply";
/// Layer of the splats of the road.
const ROAD: &str = "road";
/// Id and sensors.
const METADATA: &str = "metadata.yaml";
/// Rig and tracks in one file, in older packages.
const SUMMARY: &str = "datasource_summary.json";
/// Most bytes of a text entry.
const TEXT_BYTES_MAX: u64 = 256 << 20;
/// Farthest origin of the splats' frame, meters, up to which their means are numbers of 32 bits in
/// the world: the clients of servers have such numbers too.
const FAR_M: f64 = 20_000.0;

/// True if an archive is a package of this kind.
pub(crate) fn is_package(archive: &Archive<'_>) -> bool {
    !volumes(archive).is_empty()
}

/// Names of the entries that hold splats: one of [`VOLUMES`], else all that end with `.nurec`:
/// 3dgrut calls one like its output, and writes one for each part of a scene.
fn volumes<'a>(archive: &'a Archive<'_>) -> Vec<&'a str> {
    if let Some(name) = VOLUMES.into_iter().find(|name| archive.has(name)) {
        return vec![name];
    }
    let mut names: Vec<&str> = archive.names().collect();
    names.retain(|name| name.ends_with(".nurec"));
    names.sort_unstable();
    names
}

/// Reads the scene of a package, with all of its splats.
///
/// # Errors
/// A sentence that names the entry and the array or key at fault.
pub(crate) fn scene(archive: &Archive<'_>) -> Result<ImportedScene, DecodeError> {
    let mut scene = ImportedScene {
        actor_frame: ShFrame::Canonical,
        ..ImportedScene::empty("NuRec")
    };
    let mut rig = read_rig(archive)?;
    if rig.is_none() {
        let note = format!("there is no {RIG}: the scene has no cameras and no way of an ego");
        scene.notes.push(note);
    }
    let nre_from_world = match &rig {
        Some(rig) => rig.nre_from_world,
        None => stage::world_from_volume(archive, &mut scene.notes)?.inverse(),
    };
    let world_from_nre = nre_from_world.inverse();
    let mut tracks = read_tracks(archive, rig.as_ref())?;
    let names = volumes(archive);
    let volumes = names.iter().map(|name| read_volume(archive, name));
    let volumes: Vec<Volume<'_>> = volumes.collect::<Result<_, _>>()?;
    let states = volumes.iter().map(Volume::state);
    let states: Vec<State<'_>> = states.collect::<Result<_, _>>()?;
    let state = &states[0];
    if states.iter().all(|state| state.layers().is_empty()) {
        return Err(DecodeError::Malformed(
            "the volume has no layer with positions of splats".into(),
        ));
    }
    note_unread(state, &mut scene.notes);
    if let Some(rig) = &mut rig {
        let order = camera_order(archive, rig)?;
        let of = |name: &String| rig.rig.cameras().position(|camera| camera.name == *name);
        let images: Vec<usize> = order
            .iter()
            .map_while(|name| Some(rig.images[of(name)?]))
            .collect();
        let notes = ppisp::calibrate(&mut rig.rig, state, &order, &images)?;
        scene.notes.extend(notes);
    }
    scene.sky = sky(state, nre_from_world)?;
    let mut background: Option<SplatCloud> = None;
    let mut road = Vec::new();
    let mut drawn = HashSet::new();
    let layers = states.iter().flat_map(|state| {
        let names = state.layers().into_iter();
        names.map(move |name| (state, name))
    });
    for (state, name) in layers {
        let layer = layers::layer(state, &name)?;
        note_layer(&layer, &mut scene.notes);
        if layer.tracks.is_empty() {
            if name == ROAD {
                road = points_of_road(&layer.cloud);
            }
            match &mut background {
                Some(background) => background.append(&layer.cloud),
                None => background = Some(layer.cloud),
            }
            continue;
        }
        let ids = state.tracks_of(&name);
        let unplaced = add_actors(&mut scene, &layer, ids, &mut tracks, &mut drawn)?;
        if unplaced > 0 {
            scene.notes.push(format!(
                "layer {name}: {unplaced} splats belong to tracks that {TRACKS} does not have, and stand nowhere"
            ));
        }
    }
    let background = background.unwrap_or_else(|| SplatCloud::with_degree(0));
    (scene.background, scene.origin) = in_world(background, &world_from_nre);
    let road = road
        .into_iter()
        .map(|point| world_from_nre.transform(point) - scene.origin);
    scene.ground = ground(archive, scene.origin, road, &mut scene.notes)?;
    if let Some(rig) = rig {
        scene.notes.extend(rig.notes);
        (scene.rig, scene.ego) = (rig.rig, Some(rig.ego));
        scene.lidars = rig.lidars;
        scene.ego_height_m = rig.ego_height_m;
    }
    if tracks.is_empty() {
        return Ok(scene);
    }
    let count = tracks.len();
    scene.notes.push(format!(
        "{count} tracks have no splats of their own: they are not drawn"
    ));
    Ok(scene)
}

/// `background` in the world, and the origin that its means are from: that of the frame of the
/// splats, where it is far away.
fn in_world(background: SplatCloud, world_from_nre: &Pose) -> (SplatCloud, DVec3) {
    if *world_from_nre == Pose::IDENTITY {
        return (background, DVec3::ZERO);
    }
    if world_from_nre.translation.length() <= FAR_M {
        return (background.placed(world_from_nre, true), DVec3::ZERO);
    }
    let turn = Pose::new(world_from_nre.rotation, DVec3::ZERO);
    (background.placed(&turn, true), world_from_nre.translation)
}

/// Bytes that hold splats.
enum Volume<'a> {
    Unpacked(Vec<u8>),
    Checkpoint(&'a [u8]),
}

fn read_volume<'a>(archive: &Archive<'a>, name: &str) -> Result<Volume<'a>, DecodeError> {
    let bytes = archive.stored(name)?;
    if name.ends_with(".nurec") {
        Ok(Volume::Unpacked(state::unpack(bytes)?))
    } else {
        Ok(Volume::Checkpoint(bytes))
    }
}

impl Volume<'_> {
    fn state(&self) -> Result<State<'_>, DecodeError> {
        match self {
            Self::Unpacked(bytes) => State::from_volume(bytes),
            Self::Checkpoint(bytes) => State::from_checkpoint(bytes),
        }
    }
}

/// The entry `name`, else that part of the older summary which is called like it.
fn text(archive: &Archive<'_>, name: &str) -> Result<Option<Vec<u8>>, DecodeError> {
    if archive.has(name) {
        return Ok(Some(archive.checked(name, TEXT_BYTES_MAX)?.into_owned()));
    }
    if !archive.has(SUMMARY) {
        return Ok(None);
    }
    let summary = archive.checked(SUMMARY, TEXT_BYTES_MAX)?;
    let summary: serde_json::Value = serde_json::from_slice(&summary)
        .map_err(|error| DecodeError::Malformed(format!("{SUMMARY}: {error}")))?;
    let stem = name.trim_end_matches(".json");
    let part = summary.get(stem).or_else(|| {
        // The two objects may also stand in one another's place, by their keys.
        let has_rig = summary
            .get("rig_trajectories")
            .is_some_and(serde_json::Value::is_array);
        (name == RIG && has_rig).then_some(&summary)
    });
    Ok(part.map(|part| part.to_string().into_bytes()))
}

/// Names of the cameras in the order of the volume's arrays: those of `metadata.yaml`, else those
/// of the rig.
fn camera_order(archive: &Archive<'_>, rig: &PackageRig) -> Result<Vec<String>, DecodeError> {
    if archive.has(METADATA) {
        let text = archive.checked(METADATA, TEXT_BYTES_MAX)?;
        let names = list_of(&String::from_utf8_lossy(&text), "camera_ids");
        if !names.is_empty() {
            return Ok(names);
        }
    }
    Ok(rig
        .rig
        .cameras()
        .map(|camera| camera.name.clone())
        .collect())
}

/// Items of the list `key` of a YAML file, in brackets or in lines of their own.
fn list_of(yaml: &str, key: &str) -> Vec<String> {
    let bare = |item: &str| item.trim().trim_matches(['"', '\'']).to_owned();
    let mut lines = yaml.lines().map(str::trim);
    let start = format!("{key}:");
    let Some(first) = lines.find_map(|line| line.strip_prefix(&start)) else {
        return Vec::new();
    };
    let first = first.trim();
    if let Some(items) = first.strip_prefix('[') {
        let items = items.trim_end_matches(']').split(',').map(bare);
        return items.filter(|item| !item.is_empty()).collect();
    }
    lines
        .map_while(|line| line.strip_prefix('-'))
        .map(bare)
        .collect()
}

fn read_rig(archive: &Archive<'_>) -> Result<Option<PackageRig>, DecodeError> {
    let text = text(archive, RIG)?;
    text.map(|text| rig::read(&text)).transpose()
}

fn read_tracks(
    archive: &Archive<'_>,
    rig: Option<&PackageRig>,
) -> Result<HashMap<String, BoxTrack>, DecodeError> {
    let Some(text) = text(archive, TRACKS)? else {
        return Ok(HashMap::new());
    };
    let start_us = rig.map_or(0, |rig| rig.start_us);
    let end_s = rig.map_or(0.0, |rig| rig.ego.end_s());
    tracks::read(&text, start_us, end_s)
}

/// Adds an actor for each track that splats of `layer` belong to; returns the splats whose track is
/// not known. A track of several layers is one actor of all its splats.
fn add_actors(
    scene: &mut ImportedScene,
    layer: &Layer,
    ids: &[String],
    tracks: &mut HashMap<String, BoxTrack>,
    drawn: &mut HashSet<String>,
) -> Result<usize, DecodeError> {
    let mut unplaced = 0;
    for (index, cloud) in layer.parts() {
        let id = &ids[index];
        if drawn.contains(id) {
            let actor = scene.actors.iter_mut().find(|actor| actor.name == *id);
            if let Some(actor) = actor {
                actor.splats.append(&cloud);
            }
            continue;
        }
        let Some(track) = tracks.remove(id) else {
            unplaced += cloud.len();
            continue;
        };
        drawn.insert(id.clone());
        scene.actors.push(ImportedActor {
            name: id.clone(),
            class: track.class,
            splats: cloud,
            trajectory: Some(track.trajectory),
            present: track.present,
        });
    }
    Ok(unplaced)
}

/// Sky of the volume: the six faces of OpenGL, looked up at (-y, z, -x) of a direction in the frame
/// of the splats.
fn sky(state: &State<'_>, nre_from_world: Pose) -> Result<Option<SkyMap>, DecodeError> {
    let name = "background.textures";
    let Some(textures) = state.get(name) else {
        return Ok(None);
    };
    let shape = textures.shape();
    let is_cube = matches!(*shape, [1, 6, rows, columns, 3] if rows == columns);
    if !is_cube {
        return Err(DecodeError::Malformed(format!(
            "'{name}' has the shape {shape:?}, expected [1, 6, S, S, 3]"
        )));
    }
    let side = shape[2];
    let texels: Vec<[f32; 3]> = textures.columns(6 * side * side, 3, 0);
    let clamp = |rgb: [f32; 3]| rgb.map(|value| value.clamp(0.0, 1.0));
    let texels: Vec<[f32; 3]> = texels.into_iter().map(clamp).collect();
    let gl_from_nre = DMat3::from_cols(-DVec3::Z, -DVec3::X, DVec3::Y);
    let sky_from_world = gl_from_nre * DMat3::from_quat(nre_from_world.rotation);
    let sky = SkyMap::new(side, &texels, sky_from_world.transpose());
    sky.map(Some)
        .map_err(|reason| DecodeError::Malformed(format!("'{name}': {reason}")))
}

/// Points of the ground about `origin`: those of the package's mesh, else those of its road.
fn ground(
    archive: &Archive<'_>,
    origin: DVec3,
    road: impl Iterator<Item = DVec3>,
    notes: &mut Vec<String>,
) -> Result<Vec<DVec3>, DecodeError> {
    if archive.has(GROUND) {
        match ground_file::decode(&archive.checked(GROUND, TEXT_BYTES_MAX)?) {
            Ok(points) => return Ok(points.into_iter().map(|point| point - origin).collect()),
            Err(reason) => notes.push(format!("{GROUND} is left out: {reason}")),
        }
    }
    Ok(road.collect())
}

fn note_layer(layer: &Layer, notes: &mut Vec<String>) {
    let Layer {
        name,
        cloud,
        color_times,
        ..
    } = layer;
    let count = cloud.len();
    if *color_times > 1 {
        notes.push(format!(
            "layer {name}: {count} splats have {color_times} colors over time; the constant one is drawn"
        ));
    }
    if name.contains("deformable") {
        notes.push(format!(
            "layer {name}: {count} splats deform; they are drawn as rigid parts of their boxes"
        ));
    }
}

/// Notes on what a volume has and is not drawn.
fn note_unread(state: &State<'_>, notes: &mut Vec<String>) {
    let has = |part: &str| state.names().any(|name| name.contains(part));
    if has("tracks_delta_") {
        notes.push(
            "corrections of the tracks (tracks_calib) are left out: agents may stand some centimeters off"
                .into(),
        );
    }
}
