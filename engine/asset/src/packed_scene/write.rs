//! A scene into a package.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::agents::{sequence_tracks, track_ids};
use super::nurec_volume;
use super::rig::{geographic_origin, offset_of, package_us, rig_trajectories, span_of};
use super::{OURS, PackOptions, SCENE};
use crate::zip::StoredZip;
use crate::{AssetError, SceneFile, SceneLidar, SeenFrom, write_atomically};

/// The layer that makes a zip a USDZ: an empty stage.
const STAGE: &str = "#usda 1.0\n(\n    defaultPrim = \"World\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"World\"\n{\n}\n";

/// Summary of a packed scene.
#[derive(Clone, Debug, PartialEq)]
pub struct PackSummary {
    /// Names of the entries, in order.
    pub entries: Vec<String>,
    /// First and last moment of the scene, seconds.
    pub span_s: (f64, f64),
    /// Seconds that the package adds to the times of the scene.
    pub offset_s: f64,
    /// True if the map says where on Earth it is; without that AlpaSim cannot lay it under the
    /// scene.
    pub is_georeferenced: bool,
    /// Largest step between two positions of splats of 16 bits, meters; `None` of a package that
    /// holds the splats as they are.
    pub position_step_m: Option<f32>,
}

/// Writes `scene`, whose paths are relative to `directory`, as a package to `out`, atomically.
///
/// # Errors
/// [`AssetError`] of the file at fault; [`AssetError::Placement`] when the scene's times do not
/// fit, the id is none, a camera to be renamed is not there or an asset is a folder.
pub fn pack(
    scene: &SceneFile,
    directory: &Path,
    options: &PackOptions,
    out: &Path,
) -> Result<PackSummary, AssetError> {
    let refused = |message: String| AssetError::Placement(message);
    check_id(&options.scene_id).map_err(refused)?;
    let scene = &with_camera_names(scene, &options.camera_names).map_err(refused)?;
    let span_s = span_of(scene).map_err(refused)?;
    let mut texts: Vec<(&str, Vec<u8>)> = vec![
        ("default.usda", STAGE.into()),
        (
            "metadata.yaml",
            metadata(scene, options, span_s).into_bytes(),
        ),
        (
            "rig_trajectories.json",
            rig_trajectories(scene, options, span_s)
                .to_string()
                .into_bytes(),
        ),
        (
            "sequence_tracks.json",
            sequence_tracks(scene, directory, options, span_s)?
                .to_string()
                .into_bytes(),
        ),
        (
            "data_info.json",
            data_info(options, span_s).to_string().into_bytes(),
        ),
    ];
    texts.extend(options.map.as_ref().map(|map| ("map.xodr", map.clone())));
    if let Some(mesh) = &options.ground_mesh {
        texts.extend([
            ("mesh_ground.ply", mesh.clone()),
            ("mesh.ply", mesh.clone()),
        ]);
    }
    let mut position_step_m = None;
    let files = if options.as_nurec {
        let tracks = track_ids(scene, span_s);
        let volume = nurec_volume::volume(scene, directory, &tracks)?;
        texts[0].1 = nurec_volume::STAGE.into();
        let stage = nurec_volume::stage(volume.bounds_m).into_bytes();
        texts.push((nurec_volume::VOLUME_STAGE, stage));
        texts.push((nurec_volume::VOLUME, volume.bytes));
        position_step_m = Some(volume.step_m);
        Vec::new()
    } else {
        let (own, files) = renamed(scene);
        let text = own.to_toml().map_err(|error| refused(error.into()))?;
        texts.push((SCENE, text.into_bytes()));
        files
    };
    check_files(directory, &files)?;
    let entries: Vec<String> = texts
        .iter()
        .map(|(name, _)| (*name).to_owned())
        .chain(files.iter().map(|(_, name)| name.clone()))
        .collect();
    write_atomically(out, |file| {
        let mut zip = StoredZip::new(file);
        texts
            .iter()
            .try_for_each(|(name, content)| zip.add(name, content))?;
        files
            .iter()
            .try_for_each(|(path, name)| zip.add_from(name, || File::open(directory.join(path))))?;
        zip.finish()?.flush()
    })?;
    let is_georeferenced = options
        .map
        .as_deref()
        .is_some_and(|map| geographic_origin(map).is_some());
    Ok(PackSummary {
        entries,
        span_s,
        offset_s: offset_of(span_s.0),
        is_georeferenced,
        position_step_m,
    })
}

/// Checks that `files` of `directory` can be read: here, so that the complaint names the file and
/// not the package.
fn check_files(directory: &Path, files: &[(PathBuf, String)]) -> Result<(), AssetError> {
    for (path, _) in files {
        let path = directory.join(path);
        if path.is_dir() {
            return Err(AssetError::Placement(format!(
                "{} is a folder; zip it to a .sog, or convert it",
                path.display()
            )));
        }
        File::open(&path).map_err(|source| AssetError::Read { path, source })?;
    }
    Ok(())
}

/// Checks that an id can name a scene in requests and files of others.
fn check_id(id: &str) -> Result<(), String> {
    if id.is_empty() || id.contains(|c: char| c.is_control() || "/\\\"@".contains(c)) {
        return Err(format!(
            "{id:?} is no scene id; expected a name without slashes, quotes and @"
        ));
    }
    Ok(())
}

/// The scene with other names of cameras.
fn with_camera_names(scene: &SceneFile, names: &[(String, String)]) -> Result<SceneFile, String> {
    let mut scene = scene.clone();
    for (index, (from, to)) in names.iter().enumerate() {
        if names[..index].iter().any(|(other, _)| other == from) {
            return Err(format!("camera {from:?} is renamed twice"));
        }
        if to.is_empty() || to.contains(|c: char| c.is_control() || matches!(c, '/' | '\\' | '@')) {
            return Err(format!(
                "{to:?} is no name of a camera; expected one without slashes and @"
            ));
        }
        if !scene.rig.cameras().any(|camera| camera.name == *from) {
            let there: Vec<&str> = scene
                .rig
                .cameras()
                .map(|camera| camera.name.as_str())
                .collect();
            return Err(format!(
                "the scene has no camera {from:?} to rename, only: {}",
                there.join(", ")
            ));
        }
    }
    let renamed = |name: &String| names.iter().find(|(from, _)| from == name);
    for camera in scene.rig.cameras_mut() {
        if let Some((_, to)) = renamed(&camera.name) {
            camera.name.clone_from(to);
        }
    }
    let mut seen = HashSet::new();
    let sensors = scene.rig.sensors.iter().map(|sensor| sensor.name());
    let lidars = scene.lidars.iter().map(|lidar| lidar.name.as_str());
    if let Some(twice) = sensors.chain(lidars).find(|name| !seen.insert(*name)) {
        return Err(format!("two sensors would be called {twice:?}"));
    }
    Ok(scene)
}

/// The scene as it names its files in the package, and where each comes from and what it is called
/// there. One that is named often is packed once.
fn renamed(scene: &SceneFile) -> (SceneFile, Vec<(PathBuf, String)>) {
    let mut own = scene.clone();
    let mut files: Vec<(PathBuf, String)> = Vec::new();
    let mut known: HashMap<PathBuf, PathBuf> = HashMap::new();
    let mut take = |path: &mut PathBuf, folder: &str| {
        if let Some(name) = known.get(path) {
            *path = name.clone();
            return;
        }
        let file_name: String = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .chars()
            .filter(|c| fits(*c))
            .collect();
        // Numbered: files of one name may come from several folders.
        let name = format!("{folder}{:04}_{file_name}", known.len());
        files.push((path.clone(), format!("{OURS}{name}")));
        known.insert(
            std::mem::replace(path, PathBuf::from(&name)),
            PathBuf::from(name),
        );
    };
    take(&mut own.background, "");
    own.agents
        .iter_mut()
        .for_each(|agent| take(&mut agent.asset, "assets/"));
    let models = own.lidars.iter_mut().filter_map(SceneLidar::file_mut);
    models.for_each(|file| take(file, ""));
    if let Some(sky) = &mut own.sky_map {
        take(&mut sky.file, "");
    }
    let seen_from = own.recording.seen_from.as_mut();
    if let Some(file) = seen_from.and_then(SeenFrom::file_mut) {
        take(file, "");
    }
    if let Some(file) = &mut own.recording.ground {
        take(file, "");
    }
    if let Some(path) = own.light.as_mut().and_then(|light| light.transfer.as_mut()) {
        take(path, "");
    }
    (own, files)
}

/// True if a character of a file name may stand in an entry's.
fn fits(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-')
}

/// `metadata.yaml`. Texts are written as JSON writes them, which YAML reads.
fn metadata(scene: &SceneFile, options: &PackOptions, span_s: (f64, f64)) -> String {
    let quoted = |text: &str| Value::from(text).to_string();
    let cameras: Vec<&str> = scene
        .rig
        .cameras()
        .map(|camera| camera.name.as_str())
        .collect();
    let id = quoted(&options.scene_id);
    format!(
        "scene_id: {id}\nuuid: {id}\nversion_string: {}\ntraining_date: \"1970-01-01\"\ndataset_hash: \"\"\nis_resumable: false\n\
         sensors:\n  camera_ids: {}\n  lidar_ids: []\nlogger:\n  name: null\n  run_id: null\n  run_url: null\n\
         time_range:\n  start: {:?}\n  end: {:?}\ntraining_step_outputs: {{}}\n",
        quoted(concat!("decouplegs ", env!("CARGO_PKG_VERSION"))),
        json!(cameras),
        span_s.0 + offset_of(span_s.0),
        span_s.1 + offset_of(span_s.0)
    )
}

/// `data_info.json`.
fn data_info(options: &PackOptions, span_s: (f64, f64)) -> Value {
    let us = |time_s: f64| package_us(time_s, offset_of(span_s.0));
    json!({
        "sequence_id": options.scene_id,
        "pose-range": {"start-timestamp_us": us(span_s.0), "end-timestamp_us": us(span_s.1)},
    })
}
