//! A scene of nuScenes: its cameras, its LiDAR, the poses at which they were read, and the
//! annotated boxes.
//!
//! The world is nuScenes' global frame, z up, meters; the vehicle's frame is x forward, y left,
//! z up from the middle of the rear axle on the ground. Times are seconds after the first sample.
//! Source: H. Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", 2020, and the
//! schema of its development kit.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::{Intrinsics, Pose, TimedPose, Track, Trajectory, VehicleSize};
use glam::{DQuat, DVec3};
use serde::Deserialize;

use crate::error::read_bytes;
use crate::tracks::nuscenes as annotated;
use crate::xml::excerpt;
use crate::{AssetError, DecodeError};

/// Box of nuScenes' car, a Renault Zoe.
pub const CAR: VehicleSize = VehicleSize {
    length_m: 4.084,
    width_m: 1.73,
    height_m: 1.562,
};

/// Middle of the car's box from the middle of its rear axle on the ground, meters: the wheelbase is
/// 2.588 m, and the rear overhang 0.656 m.
pub const AXLE_TO_MIDDLE_M: DVec3 = DVec3::new(0.5 * CAR.length_m - 0.656, 0.0, 0.5 * CAR.height_m);

/// The table that tells a folder of tables from others.
const SCENES: &str = "scene.json";
/// Poses of the vehicle that are nearer in time than this are one, microseconds: each sensor has a
/// pose of its own.
const SAME_POSE_US: i64 = 1000;
/// Coordinates beyond this are no place on the earth, meters.
const FAR_M: f64 = 1e8;

/// A scene.
#[derive(Clone, Debug, PartialEq)]
pub struct NuscenesScene {
    /// Name of the scene.
    pub name: String,
    /// Poses of the middle of the rear axle on the ground, at the times of all readings.
    pub ego: Trajectory,
    /// Cameras, by channel.
    pub cameras: Vec<NuscenesCamera>,
    /// Vehicle from LiDAR, whose x axis is to the right and y forward; `None` where there is none.
    pub ego_from_lidar: Option<Pose>,
    /// Annotated boxes of the keyframes.
    pub tracks: Vec<Track>,
}

/// A camera of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct NuscenesCamera {
    /// Channel, such as `CAM_FRONT`.
    pub channel: String,
    /// Pinhole of the undistorted images.
    pub intrinsics: Intrinsics,
    /// Vehicle from camera.
    pub ego_from_camera: Pose,
    /// Images in the order of their times.
    pub images: Vec<NuscenesImage>,
}

/// An image.
#[derive(Clone, Debug, PartialEq)]
pub struct NuscenesImage {
    /// Time, seconds.
    pub time_s: f64,
    /// Path from the folder of the data set.
    pub file: String,
    /// World from vehicle when it was taken.
    pub world_from_ego: Pose,
    /// True for images of samples, which are annotated.
    pub is_keyframe: bool,
}

/// Bytes of the tables beside those of annotations.
pub struct Tables<'a> {
    /// Tables of scenes, samples and annotations.
    pub annotated: annotated::Tables<'a>,
    /// Content of `sample_data.json`.
    pub readings: &'a [u8],
    /// Content of `ego_pose.json`.
    pub ego_poses: &'a [u8],
    /// Content of `calibrated_sensor.json`.
    pub calibrated: &'a [u8],
    /// Content of `sensor.json`.
    pub sensors: &'a [u8],
}

#[derive(Deserialize)]
struct Reading<'a> {
    #[serde(borrow)]
    sample_token: Option<Cow<'a, str>>,
    #[serde(borrow)]
    ego_pose_token: Cow<'a, str>,
    #[serde(borrow)]
    calibrated_sensor_token: Cow<'a, str>,
    timestamp: i64,
    is_key_frame: bool,
    width: Option<u32>,
    height: Option<u32>,
    #[serde(borrow)]
    filename: Cow<'a, str>,
}

#[derive(Deserialize)]
struct EgoPose<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
    translation: [f64; 3],
    rotation: [f64; 4],
}

#[derive(Deserialize)]
struct Calibrated<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
    #[serde(borrow)]
    sensor_token: Cow<'a, str>,
    translation: [f64; 3],
    rotation: [f64; 4],
    camera_intrinsic: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
struct Sensor<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
    #[serde(borrow)]
    channel: Cow<'a, str>,
    #[serde(borrow)]
    modality: Cow<'a, str>,
}

impl NuscenesScene {
    /// Reads the scene called `scene`, or at that place of the table counted from 0; the only one
    /// if it is `None`. `folder` is that of the data set, with one folder of tables in it
    /// (`v1.0-mini`), or the folder of tables.
    ///
    /// # Errors
    /// [`AssetError::Read`] or [`AssetError::Decode`] of the table at fault.
    pub fn read(folder: &Path, scene: Option<&str>) -> Result<Self, AssetError> {
        let folder = tables_in(folder)?;
        let table = |name: &str| read_bytes(&folder.join(name));
        let annotations = folder.join("sample_annotation.json");
        // The tables of a test set have no annotations.
        let [instances, categories, boxes] = match annotations.is_file() {
            true => [
                table("instance.json")?,
                table("category.json")?,
                read_bytes(&annotations)?,
            ],
            false => std::array::from_fn(|_| b"[]".to_vec()),
        };
        let tables = Tables {
            annotated: annotated::Tables {
                scenes: &table(SCENES)?,
                samples: &table("sample.json")?,
                instances: &instances,
                categories: &categories,
                annotations: &boxes,
            },
            readings: &table("sample_data.json")?,
            ego_poses: &table("ego_pose.json")?,
            calibrated: &table("calibrated_sensor.json")?,
            sensors: &table("sensor.json")?,
        };
        decode(&tables, scene).map_err(|source| fault(&folder, source))
    }
}

/// The folder of tables that is `folder`, or the only one in it.
fn tables_in(folder: &Path) -> Result<PathBuf, AssetError> {
    if folder.join(SCENES).is_file() {
        return Ok(folder.to_owned());
    }
    let entries = std::fs::read_dir(folder).map_err(|source| AssetError::Read {
        path: folder.to_owned(),
        source,
    })?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut found: Vec<PathBuf> = paths.filter(|path| path.join(SCENES).is_file()).collect();
    found.sort();
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(fault(
            folder,
            DecodeError::Malformed(
                "it has no tables; expected a folder such as v1.0-mini with scene.json in it"
                    .into(),
            ),
        )),
        several => {
            let name =
                |path: &PathBuf| excerpt(&path.file_name().unwrap_or_default().to_string_lossy());
            let names: Vec<String> = several.iter().take(8).map(name).collect();
            Err(fault(
                folder,
                DecodeError::Malformed(format!(
                    "it has several folders of tables ({}); name one of them",
                    names.join(", ")
                )),
            ))
        }
    }
}

fn fault(path: &Path, source: DecodeError) -> AssetError {
    AssetError::Decode {
        path: path.to_owned(),
        format: "nuScenes",
        source,
    }
}

fn malformed(text: String) -> DecodeError {
    DecodeError::Malformed(text)
}

/// Reads a scene from the bytes of the tables.
///
/// # Errors
/// A [`DecodeError`] that names the table, and the line or token, at fault.
pub fn decode(tables: &Tables, scene: Option<&str>) -> Result<NuscenesScene, DecodeError> {
    let scenes: Vec<annotated::Scene> = annotated::rows(tables.annotated.scenes, SCENES)?;
    let chosen = annotated::chosen(&scenes, scene)?;
    let samples: Vec<annotated::Sample> = annotated::rows(tables.annotated.samples, "sample.json")?;
    let times: HashMap<&str, i64> = samples
        .iter()
        .filter(|sample| sample.scene_token == chosen.token)
        .map(|sample| (sample.token.as_ref(), sample.timestamp))
        .collect();
    let start = times.values().copied().min();
    let start = start.ok_or_else(|| {
        malformed(format!(
            "sample.json has no sample of the scene {}",
            excerpt(&chosen.name)
        ))
    })?;
    let all: Vec<Reading> = annotated::rows(tables.readings, "sample_data.json")?;
    let is_own = |reading: &&Reading| {
        let sample = reading.sample_token.as_deref();
        sample.is_some_and(|token| times.contains_key(token)) && reading.timestamp >= start
    };
    let mut readings: Vec<&Reading> = all.iter().filter(is_own).collect();
    readings.sort_by_key(|reading| reading.timestamp);
    let poses = poses_of(&readings, tables.ego_poses)?;
    let seconds = |timestamp: i64| timestamp.saturating_sub(start) as f64 * 1e-6;
    let mut way: Vec<(i64, Pose)> = Vec::new();
    for (reading, pose) in readings.iter().zip(&poses) {
        let is_new =
            |(before, _): &(i64, Pose)| reading.timestamp.saturating_sub(*before) >= SAME_POSE_US;
        if way.last().is_none_or(is_new) {
            way.push((reading.timestamp, *pose));
        }
    }
    let way = way.into_iter().map(|(timestamp, pose)| TimedPose {
        time_s: seconds(timestamp),
        pose,
    });
    let ego = Trajectory::new(way.collect()).map_err(|reason| {
        malformed(format!(
            "the readings of sample_data.json are no way: {reason}"
        ))
    })?;
    let sensors = Sensors::from_tables(tables)?;
    let mut cameras: Vec<(&str, NuscenesCamera)> = Vec::new();
    let mut ego_from_lidar = None;
    for (reading, pose) in readings.iter().zip(&poses) {
        let token = reading.calibrated_sensor_token.as_ref();
        let (calibrated, sensor) = sensors.find(token)?;
        match sensor.modality.as_ref() {
            "lidar" if ego_from_lidar.is_none() => ego_from_lidar = Some(calibrated.pose()?),
            "camera" => {
                let index = match cameras.iter().position(|(known, _)| *known == token) {
                    Some(index) => index,
                    None => {
                        cameras.push((token, calibrated.camera(sensor, reading)?));
                        cameras.len() - 1
                    }
                };
                cameras[index].1.images.push(NuscenesImage {
                    time_s: seconds(reading.timestamp),
                    file: reading.filename.clone().into_owned(),
                    world_from_ego: *pose,
                    is_keyframe: reading.is_key_frame,
                });
            }
            _ => {}
        }
    }
    let mut cameras: Vec<NuscenesCamera> = cameras.into_iter().map(|(_, camera)| camera).collect();
    cameras.sort_by(|a, b| a.channel.cmp(&b.channel));
    if cameras.is_empty() {
        return Err(malformed(format!(
            "sample_data.json has no image of the scene {}",
            excerpt(&chosen.name)
        )));
    }
    Ok(NuscenesScene {
        name: chosen.name.clone().into_owned(),
        ego,
        cameras,
        ego_from_lidar,
        tracks: annotated::decode_annotated(&tables.annotated, scene)?,
    })
}

/// Poses of the vehicle at `readings`.
fn poses_of(readings: &[&Reading], table: &[u8]) -> Result<Vec<Pose>, DecodeError> {
    let rows: Vec<EgoPose> = annotated::rows(table, "ego_pose.json")?;
    let by_token: HashMap<&str, &EgoPose> =
        rows.iter().map(|row| (row.token.as_ref(), row)).collect();
    let pose = |reading: &&Reading| {
        let token = reading.ego_pose_token.as_ref();
        let row = by_token.get(token).ok_or_else(|| {
            malformed(format!(
                "ego_pose.json has no pose {}, which sample_data.json names",
                excerpt(token)
            ))
        })?;
        pose_of(row.translation, row.rotation)
            .ok_or_else(|| malformed(format!("ego_pose.json: {} is no pose", excerpt(token))))
    };
    readings.iter().map(pose).collect()
}

/// Pose of a translation and a quaternion w, x, y, z; `None` if it is none.
fn pose_of(translation: [f64; 3], [w, x, y, z]: [f64; 4]) -> Option<Pose> {
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let translation = DVec3::from_array(translation);
    let is_pose =
        translation.abs().max_element() <= FAR_M && (0.5..2.0).contains(&rotation.length());
    is_pose.then(|| Pose::new(rotation, translation))
}

/// Sensors by the tokens of their calibrations.
struct Sensors<'a> {
    calibrated: HashMap<String, Calibrated<'a>>,
    sensors: HashMap<String, Sensor<'a>>,
}

impl<'a> Sensors<'a> {
    fn from_tables(tables: &Tables<'a>) -> Result<Self, DecodeError> {
        let calibrated: Vec<Calibrated> =
            annotated::rows(tables.calibrated, "calibrated_sensor.json")?;
        let sensors: Vec<Sensor> = annotated::rows(tables.sensors, "sensor.json")?;
        Ok(Self {
            calibrated: calibrated
                .into_iter()
                .map(|row| (row.token.clone().into_owned(), row))
                .collect(),
            sensors: sensors
                .into_iter()
                .map(|row| (row.token.clone().into_owned(), row))
                .collect(),
        })
    }

    fn find(&self, token: &str) -> Result<(&Calibrated<'a>, &Sensor<'a>), DecodeError> {
        let missing = |table: &str, token: &str| {
            malformed(format!(
                "{table} has no row {}, which is named",
                excerpt(token)
            ))
        };
        let calibrated = self.calibrated.get(token);
        let calibrated = calibrated.ok_or_else(|| missing("calibrated_sensor.json", token))?;
        let sensor = self.sensors.get(calibrated.sensor_token.as_ref());
        let sensor = sensor.ok_or_else(|| missing("sensor.json", &calibrated.sensor_token))?;
        Ok((calibrated, sensor))
    }
}

impl Calibrated<'_> {
    fn pose(&self) -> Result<Pose, DecodeError> {
        pose_of(self.translation, self.rotation).ok_or_else(|| {
            malformed(format!(
                "calibrated_sensor.json: {} has no pose",
                excerpt(&self.token)
            ))
        })
    }

    fn camera(&self, sensor: &Sensor, reading: &Reading) -> Result<NuscenesCamera, DecodeError> {
        let no_camera = |reason: String| {
            malformed(format!(
                "calibrated_sensor.json: {} is no camera: {reason}",
                excerpt(&self.token)
            ))
        };
        let [first, second, _] = self.camera_intrinsic.as_slice() else {
            return Err(no_camera("expected a matrix of 3 x 3".into()));
        };
        let (&[fx, _, cx], &[_, fy, cy]) = (first.as_slice(), second.as_slice()) else {
            return Err(no_camera("expected a matrix of 3 x 3".into()));
        };
        let size_px = [reading.width, reading.height].map(Option::unwrap_or_default);
        // nuScenes counts pixels from the middle of the first, not from its corner.
        let intrinsics = Intrinsics::pinhole(size_px, [fx, fy], [cx + 0.5, cy + 0.5]);
        intrinsics
            .check()
            .map_err(|reason| no_camera(reason.to_string()))?;
        Ok(NuscenesCamera {
            channel: sensor.channel.clone().into_owned(),
            intrinsics,
            ego_from_camera: self.pose()?,
            images: Vec::new(),
        })
    }
}
