//! Recordings of NVIDIA NCore, version 4: rig, poses, LiDARs and labeled boxes of a drive.
//!
//! After the public package `nvidia-ncore` 19.8 (Apache-2.0). A sequence is a JSON file that names
//! its stores, each a folder (`.zarr`) or a tar (`.zarr.itar`) of zarr groups:
//!
//! | group | attributes that are read |
//! |---|---|
//! | `poses/*/static_poses`, `poses/*/dynamic_poses` | 4 x 4 matrices from one frame to another, by the names of both |
//! | `intrinsics/*/cameras/ID`, `intrinsics/*/lidars/ID` | models of sensors |
//! | `cameras/ID/frames` | start and end of each image, microseconds |
//! | `cameras/ID/frames/END/image` | the encoded image |
//! | `cuboids/*/cuboids` | labeled boxes, in the frame of a sensor at a time |
//!
//! **World** is the frame `world`, **times** are seconds from the first pose of the frame `rig`.

mod store;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::{Pose, RigCamera, TimedPose, Trajectory};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{Value, json};

use self::store::Store;
use crate::camera_model::read_rolling_camera_model;
use crate::rigid::pose_of_rows;
use crate::tracks::PoseRow;
use crate::{AssetError, DecodeError, read_bytes};

/// Frame of the vehicle.
const RIG: &str = "rig";
/// Frame of the world.
const WORLD: &str = "world";
/// Stores of a sequence at most.
const STORES_MAX: usize = 1000;

/// A camera of a sequence.
#[derive(Clone, Debug)]
pub struct NcoreCamera {
    /// Camera on the vehicle, from the origin of the frame `rig`.
    pub camera: RigCamera,
    /// Start and end of each image, microseconds.
    pub frames_us: Vec<[i64; 2]>,
}

/// A LiDAR of a sequence.
#[derive(Clone, Debug)]
pub struct NcoreLidar {
    /// Name, unique among LiDARs.
    pub name: String,
    /// Pose on the vehicle, from the origin of the frame `rig`.
    pub rig_from_lidar: Pose,
    /// Parameters of its model, JSON that [`crate::read_lidar`] reads; `None` where there are none.
    pub parameters: Option<String>,
}

/// A drive.
pub struct NcoreSequence {
    /// Cameras, in the order of their names.
    pub cameras: Vec<NcoreCamera>,
    /// LiDARs, in the order of their names.
    pub lidars: Vec<NcoreLidar>,
    /// Poses of the frame `rig` in the world, seconds from the first.
    pub rig: Trajectory,
    /// Labeled boxes, world coordinates.
    pub boxes: Vec<PoseRow>,
    /// Time of the first pose, microseconds.
    pub start_us: i64,
    /// Omissions, one sentence each.
    pub notes: Vec<String>,
    stores: Vec<Store>,
}

#[derive(Deserialize)]
struct Meta {
    version: Value,
    component_stores: Vec<MetaStore>,
}

#[derive(Deserialize)]
struct MetaStore {
    path: String,
}

#[derive(Deserialize)]
struct StaticPose {
    pose: [[f64; 4]; 4],
}

#[derive(Deserialize)]
struct DynamicPoses {
    poses: Vec<[[f64; 4]; 4]>,
    timestamps_us: Vec<i64>,
}

#[derive(Deserialize)]
struct Frames {
    frames_timestamps_us: Vec<[i64; 2]>,
}

#[derive(Deserialize)]
struct Cuboids {
    cuboid_track_observations: Vec<Cuboid>,
}

#[derive(Deserialize)]
struct Cuboid {
    track_id: String,
    class_id: String,
    timestamp_us: i64,
    reference_frame_id: String,
    reference_frame_timestamp_us: i64,
    bbox3: Box3,
}

#[derive(Deserialize)]
struct Box3 {
    centroid: [f64; 3],
    dim: [f64; 3],
    /// Angles about the fixed axes x, y and z, one after the other.
    rot: [f64; 3],
}

/// Poses between frames.
#[derive(Default)]
struct Poses {
    /// Poses on the vehicle, by the name of the sensor.
    on_rig: BTreeMap<String, Pose>,
    /// World from rig, microseconds.
    rig: Vec<(i64, Pose)>,
}

impl NcoreSequence {
    /// Reads the sequence of the JSON file at `path`, or that of the only such file in the folder
    /// `path`.
    ///
    /// # Errors
    /// Returns an error that names the file and the group at fault.
    pub fn read(path: &Path) -> Result<Self, AssetError> {
        let path = sequence_file(path)?;
        let in_file = |reason: String| AssetError::Decode {
            path: path.clone(),
            format: "NCore sequence",
            source: DecodeError::Malformed(reason),
        };
        let meta: Meta = serde_json::from_slice(&read_bytes(&path)?)
            .map_err(|error| in_file(error.to_string()))?;
        let version = match &meta.version {
            Value::String(version) => version.clone(),
            other => other.to_string(),
        };
        if !version.trim_start_matches('v').starts_with('4') {
            return Err(in_file(format!("version {version}; version 4 is read")));
        }
        let count = meta.component_stores.len();
        if !(1..=STORES_MAX).contains(&count) {
            return Err(in_file(format!(
                "{count} stores; expected 1 to {STORES_MAX}"
            )));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let open = |store: &MetaStore| Store::open(&folder.join(&store.path));
        let stores = meta.component_stores.iter().map(open);
        let stores: Vec<Store> = stores.collect::<Result<_, _>>()?;
        let mut notes = Vec::new();
        let poses = poses(&stores)?;
        let Some(&(start_us, _)) = poses.rig.first() else {
            return Err(in_file(format!(
                "its stores have no poses of the frame '{RIG}' in the frame '{WORLD}'; convert the recording with them"
            )));
        };
        let timed = |(time_us, pose): &(i64, Pose)| TimedPose {
            time_s: seconds(*time_us, start_us),
            pose: *pose,
        };
        let rig = Trajectory::new(poses.rig.iter().map(timed).collect())
            .map_err(|reason| in_file(format!("the poses of '{RIG}': {reason}")))?;
        let (cameras, lidars) = sensors(&stores, &poses, &mut notes)?;
        let boxes = boxes(&stores, &poses, &rig, start_us, &mut notes)?;
        Ok(Self {
            cameras,
            lidars,
            rig,
            boxes,
            start_us,
            notes,
            stores,
        })
    }

    /// Image of `camera` that ended at `end_us`, as it was encoded, and the extension of its
    /// format.
    ///
    /// # Errors
    /// Returns an error if the store cannot be read, or has no such image.
    pub fn image(&self, camera: &str, end_us: i64) -> Result<(Vec<u8>, String), AssetError> {
        let array = format!("cameras/{camera}/frames/{end_us}/image");
        for store in &self.stores {
            let (Some(bytes), Some(attributes)) = (store.image(&array)?, store.attributes(&array)?)
            else {
                continue;
            };
            let format = attributes["format"].as_str().unwrap_or_default();
            return match format {
                "jpeg" | "jpg" => Ok((bytes, "jpg".into())),
                "png" => Ok((bytes, "png".into())),
                other => Err(store.error(format!(
                    "'{array}' is of format {other:?}; jpeg and png are known"
                ))),
            };
        }
        Err(self.stores[0].error(format!("there is no image '{array}'")))
    }
}

/// The file at `path`, or the only JSON file in the folder `path` that names stores.
fn sequence_file(path: &Path) -> Result<PathBuf, AssetError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let entries = std::fs::read_dir(path).map_err(|source| AssetError::Read {
        path: path.to_owned(),
        source,
    })?;
    let files = entries.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = files
        .filter(|file| file.extension().is_some_and(|found| found == "json"))
        .collect();
    match (files.pop(), files.is_empty()) {
        (Some(file), true) => Ok(file),
        (found, _) => Err(AssetError::Decode {
            path: path.to_owned(),
            format: "NCore sequence",
            source: DecodeError::Malformed(format!(
                "{} JSON files are in the folder; name the one of the sequence",
                files.len() + usize::from(found.is_some())
            )),
        }),
    }
}

fn poses(stores: &[Store]) -> Result<Poses, AssetError> {
    let mut found = Poses::default();
    for store in stores {
        for instance in store.groups("poses") {
            let group = format!("poses/{instance}/static_poses");
            for (key, value) in entries(store, &group)? {
                let Some([from, to]) = frames_of(&key) else {
                    continue;
                };
                let own: StaticPose = typed(store, &group, &key, value)?;
                let pose = rigid(store, &group, &key, &own.pose)?;
                match (from.as_str(), to.as_str()) {
                    (_, RIG) => found.on_rig.insert(from, pose),
                    (RIG, _) => found.on_rig.insert(to, pose.inverse()),
                    _ => None,
                };
            }
            let group = format!("poses/{instance}/dynamic_poses");
            for (key, value) in entries(store, &group)? {
                if frames_of(&key) != Some([RIG.into(), WORLD.into()]) {
                    continue;
                }
                let own: DynamicPoses = typed(store, &group, &key, value)?;
                if own.poses.len() != own.timestamps_us.len() {
                    let (poses, times) = (own.poses.len(), own.timestamps_us.len());
                    let reason = format!("{group} {key}: {poses} poses and {times} times");
                    return Err(store.error(reason));
                }
                for (rows, time_us) in own.poses.iter().zip(own.timestamps_us) {
                    found.rig.push((time_us, rigid(store, &group, &key, rows)?));
                }
            }
        }
    }
    Ok(found)
}

/// Cameras and LiDARs that have a pose on the vehicle.
fn sensors(
    stores: &[Store],
    poses: &Poses,
    notes: &mut Vec<String>,
) -> Result<(Vec<NcoreCamera>, Vec<NcoreLidar>), AssetError> {
    let (mut cameras, mut lidars) = (BTreeMap::new(), BTreeMap::new());
    let mut unplaced = |name: &str| {
        notes.push(format!(
            "{name} is left out: no pose tells where it is on the vehicle"
        ));
    };
    for store in stores {
        for instance in store.groups("intrinsics") {
            let group = format!("intrinsics/{instance}/cameras");
            for name in store.groups(&group) {
                let Some(&rig_from_camera) = poses.on_rig.get(&name) else {
                    unplaced(&name);
                    continue;
                };
                let Some(model) = store.attributes(&format!("{group}/{name}"))? else {
                    continue;
                };
                let frames_us = frames(stores, &name)?;
                let intrinsics = intrinsics(&model, &frames_us)
                    .map_err(|reason| store.error(format!("camera {name}: {reason}")))?;
                let camera = RigCamera {
                    name: name.clone(),
                    intrinsics,
                    rig_from_camera,
                };
                cameras.insert(name, NcoreCamera { camera, frames_us });
            }
        }
        for name in store.groups("lidars") {
            let Some(&rig_from_lidar) = poses.on_rig.get(&name) else {
                unplaced(&name);
                continue;
            };
            let parameters = lidar_parameters(stores, &name)?;
            lidars.insert(
                name.clone(),
                NcoreLidar {
                    name,
                    rig_from_lidar,
                    parameters,
                },
            );
        }
    }
    Ok((
        cameras.into_values().collect(),
        lidars.into_values().collect(),
    ))
}

fn frames(stores: &[Store], camera: &str) -> Result<Vec<[i64; 2]>, AssetError> {
    let group = format!("cameras/{camera}/frames");
    for store in stores {
        if let Some(value) = store.attributes(&group)? {
            let own: Frames = typed(store, &group, "its attributes", value)?;
            return Ok(own.frames_timestamps_us);
        }
    }
    Ok(Vec::new())
}

fn lidar_parameters(stores: &[Store], name: &str) -> Result<Option<String>, AssetError> {
    for store in stores {
        for instance in store.groups("intrinsics") {
            let group = format!("intrinsics/{instance}/lidars/{name}");
            if let Some(mut model) = store.attributes(&group)? {
                return Ok(Some(model["lidar_model_parameters"].take().to_string()));
            }
        }
    }
    Ok(None)
}

/// Intrinsics of an encoded model, whose shutter takes as long as `frames_us` do.
fn intrinsics(
    model: &Value,
    frames_us: &[[i64; 2]],
) -> Result<decouplegs_scene::Intrinsics, String> {
    let kind = match model["camera_model_type"].as_str() {
        // As older versions called it, and without a distortion.
        Some("pinhole" | "ideal-pinhole") => "opencv-pinhole",
        Some(kind) => kind,
        None => return Err("camera_model_type is missing".into()),
    };
    let model = json!({"type": kind, "parameters": model["camera_model_parameters"]});
    read_rolling_camera_model(&model, frames_us)
}

fn boxes(
    stores: &[Store],
    poses: &Poses,
    rig: &Trajectory,
    start_us: i64,
    notes: &mut Vec<String>,
) -> Result<Vec<PoseRow>, AssetError> {
    let (mut rows, mut unplaced) = (Vec::new(), 0);
    for store in stores {
        for instance in store.groups("cuboids") {
            let group = format!("cuboids/{instance}/cuboids");
            let Some(value) = store.attributes(&group)? else {
                continue;
            };
            let own: Cuboids = typed(store, &group, "its attributes", value)?;
            for cuboid in own.cuboid_track_observations {
                let time_s = seconds(cuboid.reference_frame_timestamp_us, start_us);
                let world_from_rig = rig.at(time_s);
                let world_from_frame = match cuboid.reference_frame_id.as_str() {
                    WORLD => Some(Pose::IDENTITY),
                    RIG => Some(world_from_rig),
                    sensor => poses.on_rig.get(sensor).map(|own| world_from_rig.then(own)),
                };
                match world_from_frame.and_then(|frame| row(&cuboid, &frame, start_us)) {
                    Some(row) => rows.push(row),
                    None => unplaced += 1,
                }
            }
        }
    }
    if unplaced > 0 {
        notes.push(format!(
            "{unplaced} boxes are left out: they have no size, or stand in frames that have no pose"
        ));
    }
    Ok(rows)
}

/// A box in the world; `None` where it is no box.
fn row(cuboid: &Cuboid, world_from_frame: &Pose, start_us: i64) -> Option<PoseRow> {
    let Box3 { centroid, dim, rot } = cuboid.bbox3;
    let numbers = [centroid, dim, rot];
    let is_box = numbers.as_flattened().iter().all(|value| value.is_finite())
        && dim.iter().all(|side_m| *side_m > 0.0);
    let [x, y, z] = rot;
    let rotation =
        DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
    let own = Pose::new(DQuat::from_mat3(&rotation), DVec3::from_array(centroid));
    let pose = world_from_frame.then(&own);
    is_box.then(|| PoseRow {
        id: cuboid.track_id.clone(),
        class: match cuboid.class_id.to_lowercase().as_str() {
            "automobile" => "car".into(),
            "heavy_truck" => "truck".into(),
            "person" => "pedestrian".into(),
            "rider" => "cyclist".into(),
            other => other.to_owned(),
        },
        time_s: seconds(cuboid.timestamp_us, start_us),
        position: pose.translation,
        rotation: pose.rotation,
        dims_m: Some(dim),
        note: String::new(),
    })
}

/// Keys and values of the attributes of `group`.
fn entries(store: &Store, group: &str) -> Result<Vec<(String, Value)>, AssetError> {
    Ok(match store.attributes(group)? {
        Some(Value::Object(entries)) => entries.into_iter().collect(),
        _ => Vec::new(),
    })
}

fn typed<T: serde::de::DeserializeOwned>(
    store: &Store,
    group: &str,
    key: &str,
    value: Value,
) -> Result<T, AssetError> {
    serde_json::from_value(value).map_err(|error| store.error(format!("{group}: {key}: {error}")))
}

fn rigid(store: &Store, group: &str, key: &str, rows: &[[f64; 4]; 4]) -> Result<Pose, AssetError> {
    pose_of_rows(rows)
        .ok_or_else(|| store.error(format!("{group} {key} is no rotation and translation")))
}

/// Names of the frames of a key: a tuple of Python, `('rig', 'world')`.
fn frames_of(key: &str) -> Option<[String; 2]> {
    let inner = key.trim().strip_prefix('(')?.strip_suffix(')')?;
    let bare = |name: &str| name.trim().trim_matches(['\'', '"']).to_owned();
    let (from, to) = inner.split_once(',')?;
    Some([bare(from), bare(to)])
}

fn seconds(time_us: i64, start_us: i64) -> f64 {
    time_us.saturating_sub(start_us) as f64 * 1e-6
}
