//! Sweeps as messages of ROS 2 in an MCAP file.

use std::io::Cursor;

use decouplegs_asset::EncodeError;
use decouplegs_scene::lidar::LidarPoint;

use super::{intensity_byte, rounded};
use crate::ros::{Cdr, McapLog, POINT_CLOUD2, Topic};

/// Fields of a point: name, offset, and type as in `PointField`. Autoware's `PointXYZIRCAEDT`, 32
/// bytes: angles in radians, distance in meters, time in nanoseconds after the stamp.
pub const POINT_FIELDS: [(&str, u32, u8); 10] = [
    ("x", 0, 7),
    ("y", 4, 7),
    ("z", 8, 7),
    ("intensity", 12, 2),
    ("return_type", 13, 2),
    ("channel", 14, 4),
    ("azimuth", 16, 7),
    ("elevation", 20, 7),
    ("distance", 24, 7),
    ("time_stamp", 28, 6),
];

/// Bytes of a point.
const POINT_BYTES: u32 = 32;

/// `return_type` as Autoware numbers them: the strongest of one return; of two, the strongest and
/// the last.
const RETURN_SINGLE_STRONGEST: u8 = 1;
const RETURN_DUAL_STRONGEST_FIRST: u8 = 3;
const RETURN_DUAL_WEAK_LAST: u8 = 6;

/// Sweeps of one sensor that become one file.
pub struct McapSweeps {
    log: McapLog<Cursor<Vec<u8>>>,
    topic: Topic,
    frame: String,
}

impl McapSweeps {
    /// No sweeps yet, of a sensor whose points are in the frame called `frame` and have `topic`.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn new(topic: &str, frame: &str) -> Result<Self, EncodeError> {
        let mut log = McapLog::new(Cursor::new(Vec::new()))?;
        Ok(Self {
            topic: log.topic(topic, POINT_CLOUD2, false),
            log,
            frame: frame.to_owned(),
        })
    }

    /// Adds a sweep that began at `start_ns`.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn add(&mut self, start_ns: u64, points: &[LidarPoint]) -> Result<(), EncodeError> {
        let message = point_cloud2(start_ns, &self.frame, points);
        self.log.add(self.topic, start_ns, &message)
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn finish(self) -> Result<Vec<u8>, EncodeError> {
        Ok(self.log.finish()?.into_inner())
    }
}

/// Message of a sweep that began at `start_ns`, with the points in `frame`.
#[must_use]
pub fn point_cloud2(start_ns: u64, frame: &str, points: &[LidarPoint]) -> Vec<u8> {
    let mut cdr = Cdr::with_header(start_ns, frame);
    cdr.u32(1);
    cdr.u32(points.len() as u32);
    cdr.u32(POINT_FIELDS.len() as u32);
    for (name, offset, datatype) in POINT_FIELDS {
        cdr.string(name);
        cdr.u32(offset);
        cdr.u8(datatype);
        cdr.u32(1);
    }
    cdr.u8(0);
    cdr.u32(POINT_BYTES);
    cdr.u32(POINT_BYTES * points.len() as u32);
    let data: Vec<u8> = points.iter().flat_map(packed).collect();
    cdr.bytes(&data);
    cdr.u8(1);
    cdr.finish()
}

/// The bytes of a point.
fn packed(point: &LidarPoint) -> [u8; POINT_BYTES as usize] {
    let mut bytes = [0; POINT_BYTES as usize];
    let [x, y, z] = rounded(point.position_m);
    let direction = point.beam.direction;
    let azimuth = direction.y.atan2(direction.x) as f32;
    let elevation = direction.z.clamp(-1.0, 1.0).asin() as f32;
    for (at, value) in [
        (0, x),
        (4, y),
        (8, z),
        (16, azimuth),
        (20, elevation),
        (24, point.measured.range_m),
    ] {
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    bytes[12] = intensity_byte(point);
    bytes[13] = match (point.measured.number, point.measured.count) {
        (_, 1) => RETURN_SINGLE_STRONGEST,
        (1, _) => RETURN_DUAL_STRONGEST_FIRST,
        _ => RETURN_DUAL_WEAK_LAST,
    };
    bytes[14..16].copy_from_slice(&point.beam.ring.to_le_bytes());
    bytes[28..32].copy_from_slice(&point.beam.offset_ns().to_le_bytes());
    bytes
}
