//! Writers of LiDAR points, in the formats of public data sets and tools.
//!
//! | format | a point | frame by custom |
//! |---|---|---|
//! | KITTI `.bin` | x, y, z, intensity 0 to 1, float32 | sensor |
//! | nuScenes `.pcd.bin` | x, y, z, intensity 0 to 255, ring from the lowest, float32 | sensor, x right, y forward |
//! | Argoverse 2 `.feather` | x, y, z float16, intensity and laser uint8, offset in ns int32 | vehicle |
//! | PCD 0.7, PLY, NumPy | all of [`FIELDS`] | any |
//! | MCAP | ROS 2 `sensor_msgs/PointCloud2`, the 32 bytes of Autoware's `PointXYZIRCAEDT` | any |

mod feather;
mod mcap;

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use decouplegs_asset::{AssetError, EncodeError, write_atomically};
use decouplegs_scene::lidar::LidarPoint;
use glam::DVec3;

pub use mcap::{McapSweeps, POINT_FIELDS, point_cloud2};

/// A format of one file per sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointFormat {
    /// KITTI's.
    Kitti,
    /// nuScenes'.
    NuScenes,
    /// Argoverse 2's.
    Argoverse2,
    /// Point Cloud Library's, binary.
    Pcd,
    /// PLY, binary.
    Ply,
    /// NumPy structured array.
    Npy,
}

impl PointFormat {
    /// Extension of its files.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Kitti => "bin",
            Self::NuScenes => "pcd.bin",
            Self::Argoverse2 => "feather",
            Self::Pcd => "pcd",
            Self::Ply => "ply",
            Self::Npy => "npy",
        }
    }
}

/// Type of a value of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// 32-bit float.
    F32,
    /// 8-bit unsigned integer.
    U8,
    /// 16-bit unsigned integer.
    U16,
    /// 32-bit unsigned integer.
    U32,
}

impl FieldType {
    /// Names in PCD (type, size), PLY and NumPy.
    fn names(self) -> ((char, u8), &'static str, &'static str) {
        match self {
            Self::F32 => (('F', 4), "float", "<f4"),
            Self::U8 => (('U', 1), "uchar", "|u1"),
            Self::U16 => (('U', 2), "ushort", "<u2"),
            Self::U32 => (('U', 4), "uint", "<u4"),
        }
    }
}

/// Values of a point in PCD, PLY and NumPy files: position and range in meters, intensity from 0
/// to 1, ring from the highest row, time of firing after the start of the sweep, number among the
/// returns of the beam.
pub const FIELDS: [(&str, FieldType); 12] = [
    ("x", FieldType::F32),
    ("y", FieldType::F32),
    ("z", FieldType::F32),
    ("intensity", FieldType::F32),
    ("range", FieldType::F32),
    ("offset_ns", FieldType::U32),
    ("column", FieldType::U32),
    ("ring", FieldType::U16),
    ("laser", FieldType::U16),
    ("instance", FieldType::U16),
    ("return_number", FieldType::U8),
    ("return_count", FieldType::U8),
];

/// Bytes of a point of [`FIELDS`].
const FIELD_BYTES: usize = 36;

/// Writes `points` of a sensor with `rings` rows to `path`, atomically. `comments` are lines for
/// people, in the headers of PCD and PLY.
///
/// # Errors
/// [`AssetError::Write`], or [`AssetError::Encode`] where the format cannot hold the points.
pub fn write_points(
    path: &Path,
    format: PointFormat,
    points: &[LidarPoint],
    rings: usize,
    comments: &[String],
) -> Result<(), AssetError> {
    let bytes = encode(format, points, rings, comments).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: format.extension(),
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))
}

/// The bytes of a file of `points`; see [`write_points`].
///
/// # Errors
/// An [`EncodeError`] where the format cannot hold the points.
pub fn encode(
    format: PointFormat,
    points: &[LidarPoint],
    rings: usize,
    comments: &[String],
) -> Result<Vec<u8>, EncodeError> {
    let count = points.len();
    let comment = |line: &String| format!("# {}\n", line.replace('\n', " "));
    Ok(match format {
        PointFormat::Kitti => floats(points, |point| {
            let [x, y, z] = rounded(point.position_m);
            [x, y, z, point.measured.intensity]
        }),
        PointFormat::NuScenes => floats(points, |point| {
            let [x, y, z] = rounded(point.position_m);
            let from_lowest = rings as f32 - 1.0 - f32::from(point.beam.ring);
            [-y, x, z, 255.0 * point.measured.intensity, from_lowest]
        }),
        PointFormat::Argoverse2 => feather::encode(points)?,
        PointFormat::Pcd => {
            let mut header: String = comments.iter().map(comment).collect();
            let column = |of: &dyn Fn(&(&str, FieldType)) -> String| {
                FIELDS.iter().map(of).collect::<Vec<_>>().join(" ")
            };
            let names = column(&|(name, _)| (*name).to_owned());
            let sizes = column(&|(_, kind)| kind.names().0.1.to_string());
            let kinds = column(&|(_, kind)| kind.names().0.0.to_string());
            let ones = column(&|_| "1".to_owned());
            let _ = write!(
                header,
                "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {names}\nSIZE {sizes}\n\
                 TYPE {kinds}\nCOUNT {ones}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
                 POINTS {count}\nDATA binary\n"
            );
            [header.into_bytes(), records(points)].concat()
        }
        PointFormat::Ply => {
            let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
            for line in comments {
                let _ = writeln!(header, "comment {}", line.replace('\n', " "));
            }
            let _ = writeln!(header, "element vertex {count}");
            for (name, kind) in FIELDS {
                let _ = writeln!(header, "property {} {name}", kind.names().1);
            }
            header.push_str("end_header\n");
            [header.into_bytes(), records(points)].concat()
        }
        PointFormat::Npy => {
            let fields: Vec<String> = FIELDS
                .iter()
                .map(|(name, kind)| format!("('{name}', '{}')", kind.names().2))
                .collect();
            let mut header = format!(
                "{{'descr': [{}], 'fortran_order': False, 'shape': ({count},), }}",
                fields.join(", ")
            );
            // Magic, version, length and header fill a multiple of 64 bytes and end in a line feed.
            let filled = (10 + header.len() + 1).next_multiple_of(64);
            header.push_str(&" ".repeat(filled - 10 - header.len() - 1));
            header.push('\n');
            let length = (header.len() as u16).to_le_bytes();
            let start = [b"\x93NUMPY\x01\x00".as_slice(), &length, header.as_bytes()].concat();
            [start, records(points)].concat()
        }
    })
}

fn rounded(position_m: DVec3) -> [f32; 3] {
    position_m.as_vec3().to_array()
}

/// Intensity from 0 to 255.
fn intensity_byte(point: &LidarPoint) -> u8 {
    (255.0 * point.measured.intensity).round() as u8
}

fn floats<const N: usize>(
    points: &[LidarPoint],
    values: impl Fn(&LidarPoint) -> [f32; N],
) -> Vec<u8> {
    let values = points.iter().flat_map(values);
    values.flat_map(f32::to_le_bytes).collect()
}

/// All of [`FIELDS`] of each point.
fn records(points: &[LidarPoint]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(FIELD_BYTES * points.len());
    for point in points {
        let [x, y, z] = rounded(point.position_m);
        let measured = &point.measured;
        for value in [x, y, z, measured.intensity, measured.range_m] {
            bytes.extend(value.to_le_bytes());
        }
        for value in [point.beam.offset_ns(), point.beam.column] {
            bytes.extend(value.to_le_bytes());
        }
        for value in [point.beam.ring, point.beam.laser, measured.instance] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([measured.number, measured.count]);
    }
    bytes
}
