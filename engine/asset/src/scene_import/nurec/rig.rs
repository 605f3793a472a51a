//! Cameras and way of the ego: `rig_trajectories.json`.

use std::collections::BTreeMap;

use decouplegs_scene::{Pose, Rig, RigCamera, TimedPose, Trajectory};
use glam::DVec3;
use serde::Deserialize;
use serde_json::Value;

use super::tracks::seconds;
use crate::DecodeError;
use crate::camera_model::read_rolling_camera_model;
use crate::lidar_file;
use crate::rigid::pose_of_rows;
use crate::scene_import::ImportedLidar;

/// Name of the entry.
pub(super) const RIG: &str = "rig_trajectories.json";

/// The ego of a package.
#[derive(Clone, Debug)]
pub(super) struct PackageRig {
    /// Frame of the splats from the world.
    pub(super) nre_from_world: Pose,
    /// Cameras on the vehicle; their poses are from the middle of its box.
    pub(super) rig: Rig,
    /// LiDARs on the vehicle, from the middle of its box.
    pub(super) lidars: Vec<ImportedLidar>,
    /// Images that the package has of each camera, in the order of the rig.
    pub(super) images: Vec<usize>,
    /// Way of the middle of the box, world coordinates, seconds from the first pose.
    pub(super) ego: Trajectory,
    /// Height of the middle of the box above the ground, meters, where the package has a box.
    pub(super) ego_height_m: Option<f64>,
    /// First pose, microseconds of the package.
    pub(super) start_us: i64,
    /// Omissions, one sentence each.
    pub(super) notes: Vec<String>,
}

#[derive(Deserialize)]
struct File {
    world_to_nre: Option<Matrix>,
    #[serde(default)]
    camera_calibrations: BTreeMap<String, Calibration>,
    #[serde(default)]
    lidar_calibrations: BTreeMap<String, LidarCalibration>,
    rig_trajectories: Vec<Way>,
}

#[derive(Deserialize)]
struct Matrix {
    matrix: [[f64; 4]; 4],
}

#[derive(Deserialize)]
struct Calibration {
    logical_sensor_name: String,
    #[serde(default)]
    unique_sensor_idx: u64,
    #[serde(rename = "T_sensor_rig")]
    rig_from_sensor: [[f64; 4]; 4],
    camera_model: Value,
}

#[derive(Deserialize)]
struct LidarCalibration {
    logical_sensor_name: Option<String>,
    #[serde(rename = "T_sensor_rig")]
    rig_from_sensor: Option<[[f64; 4]; 4]>,
    lidar_model: Option<Value>,
}

#[derive(Deserialize)]
struct Way {
    #[serde(rename = "T_rig_world_timestamps_us")]
    times_us: Vec<i64>,
    #[serde(rename = "T_rig_worlds")]
    worlds: Vec<[[f64; 4]; 4]>,
    #[serde(default)]
    cameras_frame_timestamps_us: BTreeMap<String, Vec<Vec<i64>>>,
    rig_bbox: Option<RigBox>,
}

#[derive(Deserialize)]
struct RigBox {
    centroid: [f64; 3],
}

/// Reads the rig.
///
/// # Errors
/// A sentence that names the key at fault.
pub(super) fn read(text: &[u8]) -> Result<PackageRig, DecodeError> {
    let malformed = |reason: String| DecodeError::Malformed(format!("{RIG}: {reason}"));
    let file: File = serde_json::from_slice(text).map_err(|error| malformed(error.to_string()))?;
    let mut notes = Vec::new();
    let Some(way) = file.rig_trajectories.first() else {
        return Err(malformed("'rig_trajectories' is empty".into()));
    };
    if file.rig_trajectories.len() > 1 {
        let count = file.rig_trajectories.len();
        notes.push(format!("the first of {count} rig trajectories is driven"));
    }
    if way.times_us.len() != way.worlds.len() || way.worlds.is_empty() {
        return Err(malformed(format!(
            "{} times for {} poses of the rig",
            way.times_us.len(),
            way.worlds.len()
        )));
    }
    let nre_from_world = match &file.world_to_nre {
        Some(matrix) => pose(&matrix.matrix, "world_to_nre").map_err(malformed)?,
        None => Pose::IDENTITY,
    };
    let centroid = way.rig_bbox.as_ref().map(|found| found.centroid);
    let middle = DVec3::from_array(centroid.unwrap_or_default());
    if !middle.is_finite() {
        return Err(malformed("rig_bbox.centroid is not finite".into()));
    }
    let start_us = way.times_us[0];
    let mut knots = Vec::with_capacity(way.worlds.len());
    for (&time_us, rows) in way.times_us.iter().zip(&way.worlds) {
        let rig = pose(rows, "T_rig_worlds").map_err(malformed)?;
        knots.push(TimedPose {
            time_s: seconds(time_us, start_us),
            pose: Pose::new(rig.rotation, rig.transform(middle)),
        });
    }
    let ego = Trajectory::new(knots).map_err(|reason| malformed(reason.to_string()))?;
    let mut cameras: Vec<(u64, RigCamera, usize)> = Vec::new();
    for (key, calibration) in &file.camera_calibrations {
        let frames = way.cameras_frame_timestamps_us.get(key);
        let frames = frames.map_or(&[][..], Vec::as_slice);
        let camera = camera(calibration, middle, frames)
            .map_err(|reason| malformed(format!("camera {key}: {reason}")))?;
        cameras.push((calibration.unique_sensor_idx, camera, frames.len()));
    }
    cameras.sort_by_key(|(index, ..)| *index);
    let mut names = std::collections::HashSet::new();
    let lidars = lidars(&file.lidar_calibrations, middle, &mut notes).map_err(malformed)?;
    if let Some((_, twice, _)) = cameras
        .iter()
        .find(|(_, camera, _)| !names.insert(&camera.name))
    {
        return Err(malformed(format!(
            "two cameras are called {:?}",
            twice.name
        )));
    }
    Ok(PackageRig {
        nre_from_world,
        lidars,
        images: cameras.iter().map(|(.., images)| *images).collect(),
        rig: cameras.into_iter().map(|(_, camera, _)| camera).collect(),
        ego,
        ego_height_m: centroid.map(|[_, _, z]| z).filter(|z| *z > 0.0),
        start_us,
        notes,
    })
}

/// LiDARs of the package that have a model, with poses from the `middle` of the vehicle's box. The
/// notes name the others.
fn lidars(
    calibrations: &BTreeMap<String, LidarCalibration>,
    middle: DVec3,
    notes: &mut Vec<String>,
) -> Result<Vec<ImportedLidar>, String> {
    let mut lidars: Vec<ImportedLidar> = Vec::new();
    for (key, calibration) in calibrations {
        let name = calibration.logical_sensor_name.as_ref().unwrap_or(key);
        let own = (&calibration.rig_from_sensor, &calibration.lidar_model);
        let (Some(rows), Some(model)) = own else {
            notes.push(format!(
                "the LiDAR {name} is left out: the package has no pose or no model of it; `lidar --sensor` traces with models of our own"
            ));
            continue;
        };
        let rig_from_lidar =
            pose(rows, "T_sensor_rig").map_err(|reason| format!("LiDAR {key}: {reason}"))?;
        let parameters = model.get("parameters").unwrap_or(model).to_string();
        if let Err(reason) = lidar_file::decode(parameters.as_bytes()) {
            notes.push(format!("the LiDAR {name} is left out: {reason}"));
            continue;
        }
        if lidars.iter().any(|other| other.name == *name) {
            return Err(format!("two LiDARs are called {name:?}"));
        }
        lidars.push(ImportedLidar {
            name: name.clone(),
            rig_from_lidar: Pose {
                translation: rig_from_lidar.translation - middle,
                ..rig_from_lidar
            },
            parameters,
        });
    }
    Ok(lidars)
}

fn camera(
    calibration: &Calibration,
    middle: DVec3,
    frames: &[Vec<i64>],
) -> Result<RigCamera, String> {
    let frames_us = frames
        .iter()
        .filter_map(|frame| frame.as_slice().try_into().ok());
    let intrinsics = read_rolling_camera_model(&calibration.camera_model, frames_us)?;
    let rig_from_camera = pose(&calibration.rig_from_sensor, "T_sensor_rig")?;
    Ok(RigCamera {
        name: calibration.logical_sensor_name.clone(),
        intrinsics,
        rig_from_camera: Pose {
            translation: rig_from_camera.translation - middle,
            ..rig_from_camera
        },
    })
}

/// The pose in the rows of the matrix `name`.
fn pose(rows: &[[f64; 4]; 4], name: &str) -> Result<Pose, String> {
    pose_of_rows(rows).ok_or_else(|| format!("{name} is no rotation and translation"))
}
