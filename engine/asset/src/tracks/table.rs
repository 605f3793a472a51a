//! Tables of tracks: a row for each road user and moment, in any order.
//!
//! | column | also | what |
//! |---|---|---|
//! | `t` | `time_s`, `time` | the moment, seconds |
//! | `id` | `track_id`, `trackId` | names the road user |
//! | `class` | `type`, `agent_type`, `category`, `object_type` | its kind; `unknown` where absent |
//! | `x`, `y` | `x_m`, `y_m` | its center, world coordinates in meters |
//! | `z` | `z_m` | height of its center, where known |
//! | `yaw` | `yaw_rad` | heading from x towards y, where known |
//! | `qw`, `qx`, `qy`, `qz` | | or its rotation as a quaternion, of which the heading is kept |
//! | `l`, `w`, `h` | `length`, `width`, `height`, also with `_m` | its size, where known |
//!
//! Names are those of the CSV's first line or of the keys in a JSON array of objects; case does not
//! count, others are warned of. Names with another unit (`yaw_deg`, `timestamp_us`) are refused,
//! and so are headings beyond two turns and times of more than a day, which are of another unit
//! too. Empty cells and `null` are absent values. A road user has the class and the size of its
//! first row that tells them.

use std::collections::HashMap;

use decouplegs_scene::{Track, TrackPoint};
use glam::{DQuat, DVec2, DVec3};
use serde_json::{Map, Value};

use super::{finished, nominal_height_m};
use crate::DecodeError;
use crate::unknown_keys::UnknownKeys;
use crate::xml::{excerpt, finite};

/// Content of a column; the index of its names in [`NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Time,
    Id,
    Class,
    X,
    Y,
    Z,
    Yaw,
    Qw,
    Qx,
    Qy,
    Qz,
    Length,
    Width,
    Height,
}

const COLUMNS: usize = 14;

const NAMES: [&[&str]; COLUMNS] = [
    &["t", "time_s", "time"],
    &["id", "track_id", "trackid"],
    &["class", "type", "agent_type", "category", "object_type"],
    &["x", "x_m"],
    &["y", "y_m"],
    &["z", "z_m"],
    &["yaw", "yaw_rad"],
    &["qw"],
    &["qx"],
    &["qy"],
    &["qz"],
    &["l", "length_m", "length"],
    &["w", "width_m", "width"],
    &["h", "height_m", "height"],
];

/// The column of a name.
fn column(name: &str) -> Option<usize> {
    let name = name.trim().to_lowercase();
    NAMES
        .iter()
        .position(|names| names.contains(&name.as_str()))
}

/// The column of a name; `None` for those that are not read, which are counted.
///
/// # Errors
/// An error for a known value in another unit.
fn known(name: &str, unknown: &mut UnknownKeys) -> Result<Option<usize>, DecodeError> {
    let found = column(name);
    if found.is_some() {
        return Ok(found);
    }
    let lower = name.trim().to_lowercase();
    let start = lower.split(['_', '[', '(', ' ']).next().unwrap_or_default();
    let units = [
        ("deg", "radians"),
        ("ms", "seconds"),
        ("us", "seconds"),
        ("ns", "seconds"),
        ("ft", "meters"),
        ("cm", "meters"),
        ("mm", "meters"),
        ("feet", "meters"),
    ];
    let unit = lower
        .rsplit(['_', '[', '(', ' '])
        .next()
        .unwrap_or_default();
    let other = units
        .into_iter()
        .find(|(other, _)| unit.trim_end_matches([')', ']']) == *other);
    let is_measured = matches!(
        start,
        "t" | "time"
            | "timestamp"
            | "x"
            | "y"
            | "z"
            | "yaw"
            | "heading"
            | "l"
            | "w"
            | "h"
            | "length"
            | "width"
            | "height"
    );
    if let Some((other, expected)) = other.filter(|_| is_measured) {
        return Err(DecodeError::Malformed(format!(
            "the column '{}' is in {other}; expected {expected}: convert it, and name it as in the table of columns",
            excerpt(name)
        )));
    }
    unknown.add(name.trim());
    Ok(None)
}

/// Headings beyond a turn are named; beyond two, which unwrapped ones of a log may have, they are
/// none, radians.
const YAW_RAD_NAMED: f64 = std::f64::consts::TAU + 0.01;
const YAW_RAD_MAX: f64 = 2.0 * YAW_RAD_NAMED;
/// Longest time between rows of a table, seconds.
const SPAN_S_MAX: f64 = 86_400.0;

/// A value of a row.
#[derive(Clone, Copy, Default)]
enum Cell<'a> {
    #[default]
    Absent,
    Text(&'a str),
    Number(f64),
}

/// The values of a row by column, and its position in the file for sentences.
struct Row<'a> {
    position: &'a str,
    cells: [Cell<'a>; COLUMNS],
}

/// Reads tracks from a CSV table.
///
/// # Errors
/// A [`DecodeError`] that names the line and column at fault.
pub fn decode_csv(bytes: &[u8]) -> Result<Vec<Track>, DecodeError> {
    let malformed = |error: csv::Error| DecodeError::Malformed(error.to_string());
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes));
    let mut fields: [Option<usize>; COLUMNS] = [None; COLUMNS];
    let mut unknown = UnknownKeys::default();
    for (field, name) in reader.headers().map_err(malformed)?.iter().enumerate() {
        let Some(at) = known(name, &mut unknown)? else {
            continue;
        };
        if fields[at].replace(field).is_some() {
            let name = NAMES[at].join("' or '");
            return Err(DecodeError::Malformed(format!(
                "line 1: two columns are '{name}'; expected one"
            )));
        }
    }
    unknown.warn("columns");
    for needed in [Column::Time, Column::Id, Column::X, Column::Y] {
        if fields[needed as usize].is_none() {
            let names = NAMES[needed as usize].join("' or '");
            return Err(DecodeError::Malformed(format!(
                "line 1: no column is named '{names}'"
            )));
        }
    }
    let mut tracks = Tracks::default();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(malformed)? {
        let position = format!("line {}", record.position().map_or(0, csv::Position::line));
        let cells = fields.map(|field| match field.and_then(|field| record.get(field)) {
            None | Some("") => Cell::Absent,
            Some(text) => Cell::Text(text),
        });
        tracks.add(&Row {
            position: &position,
            cells,
        })?;
    }
    tracks.finish()
}

/// Reads tracks from a JSON array of objects.
///
/// # Errors
/// A [`DecodeError`] that names the line, or the row (from 1) and key at fault.
pub fn decode_json(bytes: &[u8]) -> Result<Vec<Track>, DecodeError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let rows: Vec<Map<String, Value>> =
        serde_json::from_slice(bytes).map_err(|error| DecodeError::Malformed(error.to_string()))?;
    let mut tracks = Tracks::default();
    let mut unknown = UnknownKeys::default();
    for (at, object) in rows.iter().enumerate() {
        let position = format!("row {}", at + 1);
        let mut cells = [Cell::Absent; COLUMNS];
        for (name, value) in object {
            let Some(at) = known(name, &mut unknown)? else {
                continue;
            };
            let cell = match value {
                Value::Null => continue,
                Value::String(text) => Cell::Text(text),
                Value::Number(number) => Cell::Number(number.as_f64().unwrap_or(f64::NAN)),
                _ => {
                    return Err(DecodeError::Malformed(format!(
                        "{position}, '{name}': expected a number or a text"
                    )));
                }
            };
            if !matches!(std::mem::replace(&mut cells[at], cell), Cell::Absent) {
                let names = NAMES[at].join("' or '");
                return Err(DecodeError::Malformed(format!(
                    "{position}: two values for '{names}'; expected one"
                )));
            }
        }
        tracks.add(&Row {
            position: &position,
            cells,
        })?;
    }
    unknown.warn("keys of rows");
    tracks.finish()
}

impl Row<'_> {
    fn fault(&self, column: Column, reason: &str) -> DecodeError {
        DecodeError::Malformed(format!(
            "{}, '{}': {reason}",
            self.position, NAMES[column as usize][0]
        ))
    }

    fn number(&self, column: Column) -> Result<Option<f64>, DecodeError> {
        let number = match self.cells[column as usize] {
            Cell::Absent => return Ok(None),
            Cell::Number(number) => Some(number).filter(|number| number.is_finite()),
            Cell::Text(text) => finite(text),
        };
        number.map(Some).ok_or_else(|| {
            self.fault(
                column,
                &format!("'{}' is no finite number", self.text(column)),
            )
        })
    }

    fn needed(&self, column: Column) -> Result<f64, DecodeError> {
        self.number(column)?
            .ok_or_else(|| self.fault(column, "it is empty; expected a number"))
    }

    fn text(&self, column: Column) -> String {
        match self.cells[column as usize] {
            Cell::Absent => String::new(),
            Cell::Text(text) => excerpt(text),
            Cell::Number(number) => number.to_string(),
        }
    }

    /// The road user's name, whole.
    fn id(&self) -> Result<String, DecodeError> {
        match self.cells[Column::Id as usize] {
            Cell::Absent => Err(self.fault(Column::Id, "it is empty; expected a name")),
            Cell::Text(text) => Ok(text.to_owned()),
            Cell::Number(number) => Ok(number.to_string()),
        }
    }

    fn point(&self) -> Result<TrackPoint, DecodeError> {
        Ok(TrackPoint {
            time_s: self.needed(Column::Time)?,
            position_m: DVec2::new(self.needed(Column::X)?, self.needed(Column::Y)?),
            z_m: self.number(Column::Z)?,
            yaw_rad: self.yaw_rad()?,
        })
    }

    /// The heading as such, or that of the quaternion.
    fn yaw_rad(&self) -> Result<Option<f64>, DecodeError> {
        if let Some(yaw_rad) = self.number(Column::Yaw)? {
            if yaw_rad.abs() > YAW_RAD_MAX {
                return Err(self.fault(
                    Column::Yaw,
                    &format!("{yaw_rad} is more than two turns; expected radians, not degrees"),
                ));
            }
            return Ok(Some(yaw_rad));
        }
        let Some(w) = self.number(Column::Qw)? else {
            return Ok(None);
        };
        let [x, y, z] = [
            self.needed(Column::Qx)?,
            self.needed(Column::Qy)?,
            self.needed(Column::Qz)?,
        ];
        let largest = w.abs().max(x.abs()).max(y.abs()).max(z.abs());
        if largest <= 0.0 {
            return Err(self.fault(Column::Qw, "the quaternion is zero; expected a rotation"));
        }
        let forward = (DQuat::from_xyzw(x, y, z, w) / largest).normalize() * DVec3::X;
        Ok(Some(forward.y.atan2(forward.x)))
    }

    fn dims_m(&self, class: &str) -> Result<Option<[f64; 3]>, DecodeError> {
        let mut dims_m = [None; 3];
        for (dim, column) in dims_m
            .iter_mut()
            .zip([Column::Length, Column::Width, Column::Height])
        {
            *dim = self.number(column)?;
            if dim.is_some_and(|dim| dim <= 0.0) {
                return Err(self.fault(
                    column,
                    &format!("{} m; expected more than zero", self.text(column)),
                ));
            }
        }
        let [length_m, width_m, height_m] = dims_m;
        Ok(length_m.zip(width_m).map(|(length, width)| {
            [
                length,
                width,
                height_m.unwrap_or_else(|| nominal_height_m(class)),
            ]
        }))
    }
}

/// Tracks as their rows come.
#[derive(Default)]
struct Tracks {
    tracks: Vec<Track>,
    by_id: HashMap<String, usize>,
}

impl Tracks {
    fn add(&mut self, row: &Row) -> Result<(), DecodeError> {
        let id = row.id()?;
        let at = *self.by_id.entry(id).or_insert_with_key(|id| {
            self.tracks.push(Track {
                id: id.clone(),
                ..Track::default()
            });
            self.tracks.len() - 1
        });
        let track = &mut self.tracks[at];
        if let Cell::Text(class) = row.cells[Column::Class as usize]
            && track.class.is_empty()
        {
            track.class = class.to_lowercase();
        }
        let dims_m = row.dims_m(&track.class)?;
        track.dims_m = track.dims_m.or(dims_m);
        track.points.push(row.point()?);
        Ok(())
    }

    fn finish(mut self) -> Result<Vec<Track>, DecodeError> {
        let times = || self.tracks.iter().flat_map(|track| &track.points);
        let first_s = times()
            .map(|point| point.time_s)
            .fold(f64::INFINITY, f64::min);
        let last_s = times()
            .map(|point| point.time_s)
            .fold(f64::NEG_INFINITY, f64::max);
        let turned =
            times().filter(|point| point.yaw_rad.is_some_and(|rad| rad.abs() > YAW_RAD_NAMED));
        let turned = turned.count();
        if turned > 0 {
            log::warn!("{turned} headings are more than a turn: they are taken for radians");
        }
        if last_s - first_s > SPAN_S_MAX {
            return Err(DecodeError::Malformed(format!(
                "times run from {first_s} to {last_s}, more than a day; expected seconds, not milli-, micro- or \
                 nanoseconds"
            )));
        }
        for track in &mut self.tracks {
            track.points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            if let Some(pair) = track
                .points
                .windows(2)
                .find(|pair| pair[0].time_s == pair[1].time_s)
            {
                let (id, time_s) = (excerpt(&track.id), pair[0].time_s);
                return Err(DecodeError::Malformed(format!(
                    "track {id}: two rows at {time_s} s; expected one a moment"
                )));
            }
            if track.class.is_empty() {
                track.class = "unknown".into();
            }
        }
        finished(self.tracks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_by_any_name_and_units_that_are_others() {
        let table = |names: &str, row: &str| {
            decode_csv(format!("{names}\n{row}\n").as_bytes()).map(|tracks| tracks[0].clone())
        };
        let track = table(
            "t,trackId,x,y,length,Width,height,agent_type,color",
            "0,7,1,2,8,2.5,3.2,truck,red",
        );
        let track = track.unwrap();
        assert_eq!(
            (track.dims_m, track.class.as_str()),
            (Some([8.0, 2.5, 3.2]), "truck")
        );
        assert!(table("t,id,x,y,yaw", "0,7,1,2,6.28").is_ok());
        for (names, row, part) in [
            ("t,id,x,y,yaw", "0,7,1,2,90", "radians, not degrees"),
            ("t,id,x,y,yaw_deg", "0,7,1,2,9", "'yaw_deg' is in deg"),
            ("t,id,x,y,timestamp_us", "0,7,1,2,9", "expected seconds"),
            ("t,id,x,y", "0,7,1,2\n1.7e15,8,1,2", "more than a day"),
        ] {
            let message = table(names, row).unwrap_err().to_string();
            assert!(message.contains(part), "{names}: {message}");
        }
    }

    #[test]
    fn columns_come_in_any_order_and_rows_in_any_time() {
        let text = "\u{feff}Y, X ,id,color,Time_s,class,l,w,yaw\n2,1,a,red,1.5,Car,4,2,0.5\n4,3,a,red,0.5,Car,,,\n0,0,b,,0,truck,,,\n";
        let tracks = decode_csv(text.as_bytes()).unwrap();
        let [a, b] = tracks.as_slice() else {
            panic!("{tracks:?}")
        };
        assert_eq!(
            (a.id.as_str(), a.class.as_str(), a.dims_m),
            ("a", "car", Some([4.0, 2.0, 1.5]))
        );
        assert_eq!(
            a.points
                .iter()
                .map(|point| point.time_s)
                .collect::<Vec<_>>(),
            [0.5, 1.5]
        );
        assert_eq!(
            (a.points[1].position_m, a.points[1].yaw_rad, a.points[1].z_m),
            (DVec2::new(1.0, 2.0), Some(0.5), None)
        );
        assert_eq!(
            (b.class.as_str(), b.dims_m, b.points[0].yaw_rad),
            ("truck", None, None)
        );
        let json = r#"[{"t":1.5,"id":"a","class":"Car","x":1,"y":2,"yaw":0.5,"l":4,"w":2,"h":null},{"t":"0.5","id":"a","x":3,"y":4}]"#;
        assert_eq!(decode_json(json.as_bytes()).unwrap()[..], tracks[..1]);
    }

    #[test]
    fn a_quaternion_tells_its_heading() {
        let tilted = DQuat::from_rotation_z(2.0)
            * DQuat::from_rotation_y(0.1)
            * DQuat::from_rotation_x(-0.05)
            * 3.0;
        let text = format!(
            "t,id,x,y,qw,qx,qy,qz\n0,7,0,0,{},{},{},{}\n",
            tilted.w, tilted.x, tilted.y, tilted.z
        );
        let yaw_rad = decode_csv(text.as_bytes()).unwrap()[0].points[0]
            .yaw_rad
            .unwrap();
        assert!((yaw_rad - 2.0).abs() < 1e-12, "{yaw_rad}");
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line_and_column() {
        for (text, part) in [
            ("t,id,x\n0,a,1\n", "no column is named 'y' or 'y_m'"),
            ("t,time_s,id,x,y\n", "two columns are 't' or"),
            ("t,id,x,y\n0,a,1,2\n1,a,nan,2\n", "line 3, 'x': 'nan'"),
            ("t,id,x,y\n0,a,1,1e999\n", "line 2, 'y'"),
            ("t,id,x,y\n0,a,,2\n", "line 2, 'x': it is empty"),
            ("t,id,x,y\n0,,1,2\n", "line 2, 'id': it is empty"),
            ("t,id,x,y\n0,a,1\n", "line: 2"),
            ("t,id,x,y\n0,a,1,2\n0,a,3,4\n", "track a: two rows at 0 s"),
            (
                "t,id,x,y,qw,qx,qy,qz\n0,a,1,2,0,0,0,0\n",
                "quaternion is zero",
            ),
            ("t,id,x,y,l,w\n0,a,1,2,-4,2\n", "line 2, 'l': -4 m"),
            ("t,id,x,y\n", "no track"),
        ] {
            let error = decode_csv(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
        for (text, part) in [
            (r#"[{"t":0,"id":"a","x":[1],"y":2}]"#, "row 1, 'x'"),
            (
                r#"[{"t":0,"id":"a","x":1,"y":2},{"t":1,"id":"a","x":1}]"#,
                "row 2, 'y': it is empty",
            ),
            (r#"[{"t":0,"time":0,"id":"a","x":1,"y":2}]"#, "two values"),
            (r#"[{"t":0,"#, "line 1"),
        ] {
            let error = decode_json(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
