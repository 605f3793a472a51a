//! Sweeps of real LiDARs, which those of a scene are compared with.
//!
//! | file | a point |
//! |---|---|
//! | `*.pcd.bin` (nuScenes) | x, y, z, intensity, ring, float32 |
//! | `*.bin` (KITTI) | x, y, z, reflectance, float32 |
//! | `*.npy` | `[points, 3 or more]`, float32 or float64 in meters, int32 in millimeters |
//! | `*.npz` | such an array `points`, and perhaps `world_from_lidar`, `[4, 4]` |
//!
//! Points are in the frame of the sensor: x forward, y left, z up; those of nuScenes, x right and y
//! forward, are turned. A point at the sensor, or one that is no number, is none.

mod array;

use std::path::Path;

use decouplegs_scene::Pose;
use glam::{DMat3, DQuat, DVec3};

use crate::zip::Archive;
use crate::{AssetError, DecodeError, read_bytes};
use array::Array;

/// Points of one sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// Points in the frame of the sensor, meters.
    pub points_m: Vec<DVec3>,
    /// Pose of the sensor in the world, where the file tells it.
    pub world_from_lidar: Option<Pose>,
}

/// Most bytes that an array in an archive may unpack to.
const ARRAY_BYTES_MAX: u64 = 1 << 30;

/// Points nearer than this are none: sensors write zeros where nothing came back.
const RANGE_MIN_M: f64 = 1e-3;
/// Points farther than this are none.
const RANGE_MAX_M: f64 = 1e5;

/// A format of scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanFormat {
    /// KITTI's.
    Kitti,
    /// nuScenes'.
    NuScenes,
    /// A NumPy array.
    Npy,
    /// An archive of NumPy arrays.
    Npz,
}

impl ScanFormat {
    /// The format that a file's name tells.
    #[must_use]
    pub fn of_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let endings = [
            (".pcd.bin", Self::NuScenes),
            (".bin", Self::Kitti),
            (".npy", Self::Npy),
            (".npz", Self::Npz),
        ];
        let found = endings.iter().find(|(ending, _)| name.ends_with(ending));
        found.map(|(_, format)| *format)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Kitti => "KITTI .bin",
            Self::NuScenes => "nuScenes .pcd.bin",
            Self::Npy => "NumPy .npy",
            Self::Npz => "NumPy .npz",
        }
    }
}

/// Reads the sweep in the file at `path`; its name tells the format.
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`] for another name, or [`AssetError::Decode`]:
/// it is no such file, or has no point.
pub fn read_scan(path: &Path) -> Result<Scan, AssetError> {
    let format = ScanFormat::of_path(path).ok_or_else(|| AssetError::Unrecognized {
        path: path.to_owned(),
        found: "the name tells no format of scans".into(),
        expected: "*.bin (KITTI), *.pcd.bin (nuScenes), *.npy or *.npz",
    })?;
    decode(format, &read_bytes(path)?).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: format.name(),
        source,
    })
}

/// The sweep in `bytes`.
///
/// # Errors
/// A sentence saying what is wrong.
pub fn decode(format: ScanFormat, bytes: &[u8]) -> Result<Scan, DecodeError> {
    let (points_m, world_from_lidar) = match format {
        ScanFormat::Kitti => (records(bytes, 4)?, None),
        ScanFormat::NuScenes => {
            let turned = records(bytes, 5)?.into_iter();
            (
                turned.map(|at| DVec3::new(at.y, -at.x, at.z)).collect(),
                None,
            )
        }
        ScanFormat::Npy => (points(&Array::parse(bytes)?)?, None),
        ScanFormat::Npz => {
            let archive = Archive::parse(bytes)?;
            let array = |name: &str| archive.checked(name, ARRAY_BYTES_MAX);
            let points = points(&Array::parse(&array("points.npy")?)?)?;
            let pose = match archive.has("world_from_lidar.npy") {
                true => Some(pose(&Array::parse(&array("world_from_lidar.npy")?)?)?),
                false => None,
            };
            (points, pose)
        }
    };
    let is_point = |at: &DVec3| {
        let range_m = at.length();
        (RANGE_MIN_M..=RANGE_MAX_M).contains(&range_m)
    };
    let points_m: Vec<DVec3> = points_m.into_iter().filter(is_point).collect();
    if points_m.is_empty() {
        return Err(malformed("it has no point that a sensor could have seen"));
    }
    Ok(Scan {
        points_m,
        world_from_lidar,
    })
}

fn malformed(message: impl Into<String>) -> DecodeError {
    DecodeError::Malformed(message.into())
}

/// First three of the `values` float32 of each point.
fn records(bytes: &[u8], values: usize) -> Result<Vec<DVec3>, DecodeError> {
    if !bytes.len().is_multiple_of(4 * values) {
        return Err(malformed(format!(
            "{} bytes are no whole number of points of {} bytes",
            bytes.len(),
            4 * values
        )));
    }
    let value = |point: &[u8], at: usize| {
        let own = &point[4 * at..4 * at + 4];
        f64::from(f32::from_le_bytes([own[0], own[1], own[2], own[3]]))
    };
    let point = |point: &[u8]| DVec3::new(value(point, 0), value(point, 1), value(point, 2));
    Ok(bytes.chunks_exact(4 * values).map(point).collect())
}

/// Points of an array `[points, 3 or more]`.
fn points(array: &Array<'_>) -> Result<Vec<DVec3>, DecodeError> {
    let &[count, values] = &array.shape[..] else {
        return Err(malformed(format!(
            "the points are an array of {} dimensions; expected [points, 3 or more]",
            array.shape.len()
        )));
    };
    if values < 3 {
        return Err(malformed(format!(
            "a point has {values} values; expected 3 or more"
        )));
    }
    let unit_m = if array.is_integer() { 1e-3 } else { 1.0 };
    let value = |point: usize, at: usize| unit_m * array.value(point * values + at);
    let point = |point: usize| DVec3::new(value(point, 0), value(point, 1), value(point, 2));
    Ok((0..count).map(point).collect())
}

/// Distance of columns of a rotation from unit length and right angles, at most.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Pose of a matrix `[4, 4]`.
fn pose(array: &Array<'_>) -> Result<Pose, DecodeError> {
    if array.shape != [4, 4] {
        return Err(malformed(format!(
            "world_from_lidar is {:?}; expected [4, 4]",
            array.shape
        )));
    }
    let column = |at: usize| DVec3::from_array([0, 1, 2].map(|row| array.value(4 * row + at)));
    let axes = DMat3::from_cols(column(0), column(1), column(2));
    let off = axes.transpose() * axes - DMat3::IDENTITY;
    let is_rotation = off
        .to_cols_array()
        .iter()
        .all(|entry| entry.abs() < ROTATION_TOLERANCE);
    if !is_rotation || axes.determinant() < 0.0 || !column(3).is_finite() {
        return Err(malformed("world_from_lidar is no rotation and place"));
    }
    Ok(Pose::new(DQuat::from_mat3(&axes).normalize(), column(3)))
}

#[cfg(test)]
mod tests;
