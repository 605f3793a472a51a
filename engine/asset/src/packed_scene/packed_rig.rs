//! The rig of a package as its readers see it, for servers that answer for the same package.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use decouplegs_scene::{Pose, TimedPose, Trajectory};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::read::{NAME, is_package};
use crate::error::read_bytes;
use crate::zip::{Archive, first_stored, stored_in};
use crate::{AssetError, DecodeError};

/// Entry of the rig.
const RIG: &str = "rig_trajectories.json";
/// Entry of the scene's id and of the program that packed it.
const METADATA: &str = "metadata.yaml";
/// Bytes at the start of a package in which its id is looked for: it is in one of the first
/// entries.
const START_BYTES: u64 = 1 << 16;

/// The rig of a package.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedRig {
    /// Name and version of the program that wrote the package; empty if unknown.
    pub version: String,
    /// Origin of the rig in the vehicle frame (from the middle of the box), meters; zero where the
    /// package does not tell the box.
    pub origin_m: DVec3,
    /// Way of the rig: local frame, times of the package.
    pub way: Trajectory,
    /// Cameras by name, each with its pose in the rig.
    pub cameras: Vec<(String, Pose)>,
    /// Start of the first frame of a camera, seconds. `None`: no camera has a frame.
    pub first_frame_s: Option<f64>,
}

#[derive(Deserialize)]
struct RigFile {
    #[serde(default)]
    camera_calibrations: BTreeMap<String, Calibration>,
    rig_trajectories: Vec<RigWay>,
}

#[derive(Deserialize)]
struct RigWay {
    #[serde(rename = "T_rig_world_timestamps_us")]
    times_us: Vec<u64>,
    #[serde(rename = "T_rig_worlds")]
    worlds: Vec<[[f64; 4]; 4]>,
    #[serde(default)]
    cameras_frame_timestamps_us: BTreeMap<String, Vec<[u64; 2]>>,
    rig_bbox: Option<RigBox>,
}

#[derive(Deserialize)]
struct Calibration {
    logical_sensor_name: String,
    #[serde(rename = "T_sensor_rig")]
    rig_from_sensor: [[f64; 4]; 4],
}

#[derive(Deserialize)]
struct RigBox {
    centroid: [f64; 3],
}

/// Reads the rig of the package at `path`.
///
/// # Errors
/// [`AssetError`] naming the entry at fault.
pub fn read_packed_rig(path: &Path) -> Result<PackedRig, AssetError> {
    let bytes = read_bytes(path)?;
    rig_of(&bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: NAME,
        source,
    })
}

/// Id by which clients ask for the package at `path`, as its `metadata.yaml` says; `None` where it
/// has none. Only its start, and else its directory and that entry, are read.
#[must_use]
pub fn packed_scene_id(path: &Path) -> Option<String> {
    if !is_package(path) {
        return None;
    }
    let mut start = Vec::new();
    let mut file = File::open(path).ok()?;
    (&file).take(START_BYTES).read_to_end(&mut start).ok()?;
    let metadata = match first_stored(&start, METADATA) {
        Some(metadata) => metadata.to_vec(),
        None => stored_in(&mut file, METADATA, START_BYTES)?,
    };
    let id = value_of(&metadata, "scene_id")?;
    Some(id).filter(|id| !id.is_empty())
}

fn rig_of(bytes: &[u8]) -> Result<PackedRig, DecodeError> {
    let archive = Archive::parse(bytes)?;
    let text = archive.checked(RIG, bytes.len() as u64)?;
    let malformed = |reason: String| DecodeError::Malformed(format!("{RIG}: {reason}"));
    let file: RigFile =
        serde_json::from_slice(&text).map_err(|error| malformed(error.to_string()))?;
    let [way] = &file.rig_trajectories[..] else {
        let count = file.rig_trajectories.len();
        return Err(malformed(format!(
            "expected one of rig_trajectories, found {count}"
        )));
    };
    if way.times_us.len() != way.worlds.len() {
        return Err(malformed(format!(
            "{} times for {} poses",
            way.times_us.len(),
            way.worlds.len()
        )));
    }
    let poses = way.times_us.iter().zip(&way.worlds);
    let poses = poses.map(|(&time_us, rows)| TimedPose {
        time_s: time_us as f64 * 1e-6,
        pose: pose_of(rows),
    });
    let way_read =
        Trajectory::new(poses.collect()).map_err(|reason| malformed(reason.to_string()))?;
    let centroid = way
        .rig_bbox
        .as_ref()
        .map_or([0.0; 3], |rig_box| rig_box.centroid);
    let centroid = DVec3::from_array(centroid);
    if !centroid.is_finite() {
        return Err(malformed("rig_bbox.centroid is not finite".into()));
    }
    let frames = way.cameras_frame_timestamps_us.values();
    let first_frame_us = frames
        .filter_map(|of_camera| of_camera.first())
        .map(|frame| frame[0])
        .min();
    let cameras = file.camera_calibrations.into_values();
    let cameras = cameras.map(|camera| {
        let pose = pose_of(&camera.rig_from_sensor);
        (camera.logical_sensor_name, pose)
    });
    let metadata = archive.checked(METADATA, bytes.len() as u64);
    let version = metadata
        .ok()
        .and_then(|text| value_of(&text, "version_string"));
    Ok(PackedRig {
        version: version.unwrap_or_default(),
        origin_m: -centroid,
        way: way_read,
        cameras: cameras.collect(),
        first_frame_s: first_frame_us.map(|us| us as f64 * 1e-6),
    })
}

/// The pose in the rows of a matrix.
fn pose_of(rows: &[[f64; 4]; 4]) -> Pose {
    let [x, y, z, _] = rows.map(|[a, b, c, _]| DVec3::new(a, b, c));
    Pose::new(
        DQuat::from_mat3(&DMat3::from_cols(x, y, z).transpose()).normalize(),
        DVec3::new(rows[0][3], rows[1][3], rows[2][3]),
    )
}

/// The text of a key on a line of its own, written as JSON writes it.
fn value_of(yaml: &[u8], key: &str) -> Option<String> {
    let text = std::str::from_utf8(yaml).ok()?;
    let value = text
        .lines()
        .find_map(|line| line.strip_prefix(key)?.strip_prefix(": "))?;
    // Others write texts as YAML does, mostly without quotes.
    let plain = || value.trim().trim_matches('\'').to_owned();
    Some(serde_json::from_str(value).unwrap_or_else(|_| plain()))
}
