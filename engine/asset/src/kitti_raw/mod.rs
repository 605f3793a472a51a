//! A drive of KITTI's raw data, "synced and rectified": poses of its inertial unit, rectified
//! cameras, the place of its LiDAR, and labeled boxes.
//!
//! The world is the frame of the inertial unit (IMU) at the first frame: x forward, y left, z up,
//! meters. Poses are those of KITTI's development kit: Mercator's projection at the latitude of the
//! first packet. Records with one index belong together, at the time of the image.
//! Source: A. Geiger et al., "Vision meets Robotics: The KITTI Dataset", 2013.

mod tables;
mod tracklets;

use std::path::{Path, PathBuf};

use decouplegs_scene::{Intrinsics, Pose, TimedPose, Trajectory, VehicleSize};
use glam::{DQuat, DVec3};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

pub use tables::{Calibration, Packet, decode_calibration, decode_packet, decode_times};
pub use tracklets::{Tracklet, decode_tracklets};

/// Frames of a drive at most: a day at 10 Hz.
const FRAMES_MAX: usize = 864_000;

/// File of the calibration of the cameras.
const CAMERAS_FILE: &str = "calib_cam_to_cam.txt";

/// Box of KITTI's car, a VW Passat B6 estate without mirrors.
pub const CAR: VehicleSize = VehicleSize {
    length_m: 4.774,
    width_m: 1.82,
    height_m: 1.517,
};

/// Height of the IMU above the road, meters (KITTI's page of the sensor setup).
pub const IMU_HEIGHT_M: f64 = 0.93;

/// Middle of the car's box in the frame of the IMU, meters. The IMU is over the rear axle, 0.32 m
/// to the left of the middle.
pub const IMU_TO_MIDDLE_M: DVec3 = DVec3::new(1.23, -0.32, 0.5 * CAR.height_m - IMU_HEIGHT_M);

/// A drive.
#[derive(Clone, Debug)]
pub struct KittiDrive {
    /// Poses of the IMU, times since the first frame with an image.
    pub imu: Trajectory,
    /// Rotation from the world to one whose z is up: the first IMU was not level.
    pub level_from_world: DQuat,
    /// Rectified cameras that have images.
    pub cameras: Vec<KittiCamera>,
    /// IMU from LiDAR.
    pub imu_from_lidar: Pose,
    /// Labeled boxes; none where the drive has no `tracklet_labels.xml`.
    pub tracklets: Vec<Tracklet>,
    /// Scans of the LiDAR: indices of their frames, and their files.
    pub scans: Vec<(usize, PathBuf)>,
    /// Times of all frames, since the first with an image, seconds.
    pub times_s: Vec<f64>,
}

/// A rectified camera.
#[derive(Clone, Debug)]
pub struct KittiCamera {
    /// Number of the camera, 0 to 3; 2 and 3 are in color, 1 and 3 to the right.
    pub number: u32,
    /// Rectified pinhole.
    pub intrinsics: Intrinsics,
    /// IMU from camera.
    pub imu_from_camera: Pose,
    /// Images in their order.
    pub images: Vec<KittiImage>,
}

/// An image of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct KittiImage {
    /// Index of the frame.
    pub frame: usize,
    /// Path of the file.
    pub path: PathBuf,
}

impl KittiDrive {
    /// Reads the drive in `folder` (`2011_09_26_drive_0009_sync`), whose calibration lies in it or
    /// in the folder above, as KITTI unpacks it.
    ///
    /// # Errors
    /// [`AssetError::Read`] or [`AssetError::Decode`] of the file at fault.
    pub fn read(folder: &Path) -> Result<Self, AssetError> {
        let read = |name: &str| read_bytes(&calibration_path(folder, name));
        let calibration = decode_calibration(
            &read("calib_imu_to_velo.txt")?,
            &read("calib_velo_to_cam.txt")?,
            &read(CAMERAS_FILE)?,
        )
        .map_err(|source| fault(&calibration_path(folder, CAMERAS_FILE), source))?;
        let colored = cameras_in(folder, &[2, 3], &calibration)?;
        let cameras = match colored.is_empty() {
            true => cameras_in(folder, &[0, 1], &calibration)?,
            false => colored,
        };
        let first = cameras
            .iter()
            .filter_map(|camera| Some(camera.images.first()?.frame))
            .min();
        let first = first.ok_or_else(|| {
            let reason = "no image was found; expected image_02/data/0000000000.png and the like";
            fault(folder, DecodeError::Malformed(reason.into()))
        })?;
        let times_path = folder
            .join(format!("image_{:02}", cameras[0].number))
            .join("timestamps.txt");
        let times_s =
            decode_times(&read_bytes(&times_path)?).map_err(|source| fault(&times_path, source))?;
        let start_s = times_s.get(first).copied().ok_or_else(|| {
            let reason = format!(
                "{} times; expected one for each image, and there is an image {first}",
                times_s.len()
            );
            fault(&times_path, DecodeError::Malformed(reason))
        })?;
        let times_s: Vec<f64> = times_s.iter().map(|time_s| time_s - start_s).collect();
        let last = cameras
            .iter()
            .filter_map(|camera| Some(camera.images.last()?.frame))
            .max()
            .unwrap_or(first);
        let (imu, level_from_world) = imu_way(folder, first..=last, &times_s)?;
        let labels = folder.join("tracklet_labels.xml");
        let tracklets = match labels.exists() {
            true => {
                decode_tracklets(&read_bytes(&labels)?).map_err(|source| fault(&labels, source))?
            }
            false => Vec::new(),
        };
        Ok(Self {
            imu,
            level_from_world,
            cameras,
            imu_from_lidar: calibration.imu_from_lidar(),
            scans: numbered(&folder.join("velodyne_points").join("data"), &["bin"]),
            tracklets,
            times_s,
        })
    }
}

fn fault(path: &Path, source: DecodeError) -> AssetError {
    AssetError::Decode {
        path: path.to_owned(),
        format: "KITTI raw",
        source,
    }
}

/// Path of a file of the calibration: in the folder of the drive, or above it.
fn calibration_path(folder: &Path, name: &str) -> PathBuf {
    let own = folder.join(name);
    match own.exists() {
        true => own,
        false => folder.join("..").join(name),
    }
}

/// Cameras of `numbers` that have images.
fn cameras_in(
    folder: &Path,
    numbers: &[u32],
    calibration: &Calibration,
) -> Result<Vec<KittiCamera>, AssetError> {
    let mut cameras = Vec::new();
    for &number in numbers {
        let images = images_in(&folder.join(format!("image_{number:02}")).join("data"));
        if images.is_empty() {
            continue;
        }
        let (intrinsics, imu_from_camera) = calibration
            .camera(number)
            .map_err(|source| fault(&calibration_path(folder, CAMERAS_FILE), source))?;
        cameras.push(KittiCamera {
            number,
            intrinsics,
            imu_from_camera,
            images,
        });
    }
    Ok(cameras)
}

/// Images of a folder in the order of their frames; none where there is no such folder.
fn images_in(folder: &Path) -> Vec<KittiImage> {
    let images = numbered(folder, &["png", "jpg", "jpeg"]).into_iter();
    images
        .map(|(frame, path)| KittiImage { frame, path })
        .collect()
}

/// Files of a folder that are named by their frames and end in one of `endings`, in the order of
/// frames; none where there is no such folder.
fn numbered(folder: &Path, endings: &[&str]) -> Vec<(usize, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let file = |entry: std::fs::DirEntry| {
        let path = entry.path();
        let ends = path
            .extension()
            .is_some_and(|end| endings.iter().any(|own| end.eq_ignore_ascii_case(own)));
        let frame = path.file_stem()?.to_str()?.parse().ok()?;
        (ends && frame < FRAMES_MAX).then_some((frame, path))
    };
    let mut files: Vec<(usize, PathBuf)> = entries.filter_map(file).collect();
    files.sort();
    files.dedup_by_key(|(frame, _)| *frame);
    files
}

/// Poses of the IMU at `frames`, world coordinates, and the rotation that levels the world.
fn imu_way(
    folder: &Path,
    frames: std::ops::RangeInclusive<usize>,
    times_s: &[f64],
) -> Result<(Trajectory, DQuat), AssetError> {
    let oxts = folder.join("oxts").join("data");
    let mut poses: Vec<(usize, Pose)> = Vec::new();
    let mut scale = None;
    for frame in frames {
        let path = oxts.join(format!("{frame:010}.txt"));
        if !path.exists() {
            continue;
        }
        let packet = decode_packet(&read_bytes(&path)?).map_err(|source| fault(&path, source))?;
        let scale = *scale.get_or_insert_with(|| packet.mercator_scale());
        poses.push((frame, packet.pose(scale)));
    }
    let (_, start) = *poses.first().ok_or_else(|| {
        let reason =
            "no packet was found; expected 0000000000.txt and the like, one for each image";
        fault(&oxts, DecodeError::Malformed(reason.into()))
    })?;
    let world_from_earth = start.inverse();
    let timed = poses.iter().filter_map(|(frame, pose)| {
        Some(TimedPose {
            time_s: *times_s.get(*frame)?,
            pose: world_from_earth.then(pose),
        })
    });
    let way = Trajectory::new(timed.collect()).map_err(|reason| {
        fault(
            &oxts,
            DecodeError::Malformed(format!("the poses are no way: {reason}")),
        )
    })?;
    // The heading stays: only pitch and roll of the first IMU are taken out.
    let heading = DQuat::from_rotation_z(start.heading_rad());
    Ok((way, heading.inverse() * start.rotation))
}
