//! Poses of road users as a table, which [`super::read_tracks`] reads back as tracks.

use std::io::{self, Write};
use std::path::Path;

use glam::{DQuat, DVec3};
use serde_json::{Map, Value};

use super::TrackFormat;
use crate::{AssetError, write_atomically};

/// Pose of a road user at a moment, in all six degrees of freedom.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseRow {
    /// Names the road user.
    pub id: String,
    /// Class, in lower case.
    pub class: String,
    /// The moment, seconds.
    pub time_s: f64,
    /// Center of its box, world coordinates in meters.
    pub position: DVec3,
    /// World from road user (x forward, y left, z up); the file has w first.
    pub rotation: DQuat,
    /// Length, width and height, meters, where known.
    pub dims_m: Option<[f64; 3]>,
    /// Whatever a reader should know of it; tables of tracks ignore it.
    pub note: String,
}

/// Names of the columns, in order.
const COLUMNS: [&str; 14] = [
    "time_s", "id", "class", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "length_m", "width_m",
    "height_m", "note",
];

impl PoseRow {
    /// Checks the row and describes the first fault.
    fn check(&self) -> Result<(), String> {
        let (id, time_s) = (&self.id, self.time_s);
        let dims_are_finite = self
            .dims_m
            .is_none_or(|dims| dims.iter().all(|dim| dim.is_finite()));
        if !(time_s.is_finite()
            && self.position.is_finite()
            && self.rotation.is_finite()
            && dims_are_finite)
        {
            return Err(format!(
                "{id} at {time_s} s holds a number that is not finite"
            ));
        }
        Ok(())
    }

    /// Values in the order of the columns; the shortest text of each number that reads back to the
    /// same bits.
    fn values(&self) -> [Value; 14] {
        let number = Value::from;
        let dim = |axis: usize| self.dims_m.map_or(Value::Null, |dims| number(dims[axis]));
        let (position, rotation) = (self.position, self.rotation);
        [
            number(self.time_s),
            Value::from(self.id.as_str()),
            Value::from(self.class.as_str()),
            number(position.x),
            number(position.y),
            number(position.z),
            number(rotation.w),
            number(rotation.x),
            number(rotation.y),
            number(rotation.z),
            dim(0),
            dim(1),
            dim(2),
            Value::from(self.note.as_str()),
        ]
    }
}

/// The bytes of a table of `rows`, CSV or JSON.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] where a row holds a number that is not finite, or for
/// CommonRoad, which is not written.
pub fn encode_poses(rows: &[PoseRow], format: TrackFormat) -> io::Result<Vec<u8>> {
    let refused = |reason: String| io::Error::new(io::ErrorKind::InvalidInput, reason);
    rows.iter().try_for_each(PoseRow::check).map_err(refused)?;
    match format {
        TrackFormat::Csv => csv_of(rows),
        TrackFormat::Json => json_of(rows),
        TrackFormat::CommonRoad => Err(refused("poses are written as .csv or .json".into())),
    }
}

fn csv_of(rows: &[PoseRow]) -> io::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    for row in rows {
        writer.write_record(row.values().map(|value| match value {
            Value::String(text) => text,
            Value::Null => String::new(),
            number => number.to_string(),
        }))?;
    }
    writer
        .into_inner()
        .map_err(|error| io::Error::other(error.to_string()))
}

/// A row a line.
fn json_of(rows: &[PoseRow]) -> io::Result<Vec<u8>> {
    let mut text = String::from("[");
    for (at, row) in rows.iter().enumerate() {
        let pairs = COLUMNS.into_iter().map(str::to_owned).zip(row.values());
        let object: Map<String, Value> = pairs.filter(|(_, value)| !value.is_null()).collect();
        text += if at == 0 { "\n" } else { ",\n" };
        text += &serde_json::to_string(&object)?;
    }
    text += "\n]\n";
    Ok(text.into_bytes())
}

/// Writes a table of `rows` to `path`, as CSV or JSON by its extension, whole or not at all.
///
/// # Errors
/// [`AssetError::Unrecognized`] for another extension, [`AssetError::Write`] where a number is not
/// finite or the disk fails.
pub fn write_poses(path: &Path, rows: &[PoseRow]) -> Result<(), AssetError> {
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    let format = match extension.as_str() {
        "csv" => TrackFormat::Csv,
        "json" => TrackFormat::Json,
        _ => {
            let found = format!("the extension '{extension}' tells no form of table");
            return Err(AssetError::Unrecognized {
                path: path.to_owned(),
                found,
                expected: ".csv or .json",
            });
        }
    };
    let bytes = encode_poses(rows, format).map_err(|source| AssetError::Write {
        path: path.to_owned(),
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracks::read_tracks;

    #[test]
    fn what_is_written_is_read_back_to_the_last_bit() {
        let row = |id: &str, time_s: f64, dims_m, note: &str| PoseRow {
            id: id.into(),
            class: "car".into(),
            time_s,
            position: DVec3::new(
                456_789.123_456_789_1,
                5_432_109.876_543_21 + time_s / 3.0,
                0.1 + 0.2,
            ),
            rotation: DQuat::from_rotation_z(0.3) * DQuat::from_rotation_x(0.01),
            dims_m,
            note: note.into(),
        };
        let rows = [
            row("a", 0.0, Some([4.7, 1.9, 1.6]), "on \"road\", 2\nlines"),
            row("a", 0.1, None, ""),
            row("b,c", 1e-7, None, ""),
        ];
        let directory = tempfile::tempdir().unwrap();
        for name in ["poses.csv", "poses.json"] {
            let path = directory.path().join(name);
            write_poses(&path, &rows).unwrap();
            let tracks = read_tracks(&path).unwrap();
            assert_eq!(
                tracks
                    .iter()
                    .map(|track| track.id.as_str())
                    .collect::<Vec<_>>(),
                ["a", "b,c"],
                "{name}"
            );
            assert_eq!(tracks[0].dims_m, Some([4.7, 1.9, 1.6]));
            let points = tracks.iter().flat_map(|track| &track.points);
            for (point, row) in points.zip(&rows) {
                assert_eq!(
                    (point.time_s, point.position()),
                    (row.time_s, row.position),
                    "{name}"
                );
                assert!((point.yaw_rad.unwrap() - 0.3).abs() < 1e-12);
            }
        }
        assert!(
            write_poses(&directory.path().join("poses.txt"), &rows)
                .unwrap_err()
                .to_string()
                .contains(".csv or .json")
        );
        let broken = [row("z", f64::NAN, None, "")];
        assert!(
            write_poses(&directory.path().join("x.csv"), &broken)
                .unwrap_err()
                .to_string()
                .contains("z at NaN s")
        );
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 2);
    }
}
