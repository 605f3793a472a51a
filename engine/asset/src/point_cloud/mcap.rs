//! Sweeps as messages of ROS 2 in an MCAP file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use decouplegs_scene::lidar::LidarPoint;
use mcap::{Channel, Message, Schema, WriteOptions, Writer};

use super::{intensity_byte, rounded};
use crate::EncodeError;

/// Definition of the message, with those that it is made of.
const POINT_CLOUD2: &str = "\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
";

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
    writer: Writer<Cursor<Vec<u8>>>,
    channel: Arc<Channel<'static>>,
    frame: String,
    count: u32,
}

impl McapSweeps {
    /// No sweeps yet, of a sensor whose points are in the frame called `frame` and have `topic`.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn new(topic: &str, frame: &str) -> Result<Self, EncodeError> {
        let options = WriteOptions::new().compression(None).profile("ros2");
        let writer = options
            .create(Cursor::new(Vec::new()))
            .map_err(|error| EncodeError(error.to_string()))?;
        let schema = Schema {
            id: 1,
            name: "sensor_msgs/msg/PointCloud2".to_owned(),
            encoding: "ros2msg".to_owned(),
            data: Cow::Borrowed(POINT_CLOUD2.as_bytes()),
        };
        let channel = Channel {
            id: 1,
            topic: topic.to_owned(),
            schema: Some(Arc::new(schema)),
            message_encoding: "cdr".to_owned(),
            metadata: BTreeMap::new(),
        };
        Ok(Self {
            writer,
            channel: Arc::new(channel),
            frame: frame.to_owned(),
            count: 0,
        })
    }

    /// Adds a sweep that began at `start_ns`.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn add(&mut self, start_ns: u64, points: &[LidarPoint]) -> Result<(), EncodeError> {
        let message = Message {
            channel: self.channel.clone(),
            sequence: self.count,
            log_time: start_ns,
            publish_time: start_ns,
            data: Cow::Owned(message(start_ns, &self.frame, points)),
        };
        self.count += 1;
        self.writer
            .write(&message)
            .map_err(|error| EncodeError(error.to_string()))
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn finish(mut self) -> Result<Vec<u8>, EncodeError> {
        self.writer
            .finish()
            .map_err(|error| EncodeError(error.to_string()))?;
        Ok(self.writer.into_inner().into_inner())
    }
}

/// A message in the Common Data Representation of ROS 2, little endian.
fn message(start_ns: u64, frame: &str, points: &[LidarPoint]) -> Vec<u8> {
    let mut cdr = Cdr(vec![0, 1, 0, 0]);
    cdr.u32((start_ns / 1_000_000_000) as u32);
    cdr.u32((start_ns % 1_000_000_000) as u32);
    cdr.string(frame);
    cdr.u32(1);
    cdr.u32(points.len() as u32);
    cdr.u32(POINT_FIELDS.len() as u32);
    for (name, offset, datatype) in POINT_FIELDS {
        cdr.string(name);
        cdr.u32(offset);
        cdr.0.push(datatype);
        cdr.u32(1);
    }
    cdr.0.push(0);
    let data_bytes = POINT_BYTES * points.len() as u32;
    cdr.u32(POINT_BYTES);
    cdr.u32(data_bytes);
    cdr.u32(data_bytes);
    for point in points {
        cdr.0.extend(packed(point));
    }
    cdr.0.push(1);
    cdr.0
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

/// Bytes of a message, behind the 4 that name its encoding.
struct Cdr(Vec<u8>);

impl Cdr {
    /// A number, aligned to its size.
    fn u32(&mut self, value: u32) {
        while !self.0.len().is_multiple_of(4) {
            self.0.push(0);
        }
        self.0.extend(value.to_le_bytes());
    }

    /// A text with its length and a final zero.
    fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }
}
