//! Obstacles of a place as JSON: boxes on the plane that a vehicle can hit.
//!
//! ```json
//! {"version": 1, "obstacles": [
//!   {"kind": "house", "center_m": [12.0, 31.5], "yaw_rad": 0.1, "length_m": 14.0, "width_m": 9.0}
//! ]}
//! ```
//!
//! `center_m` is in world coordinates. `kind` is one of [`ObstacleKind::by_name`]'s, `captured
//! object` if left out; `yaw_rad` is 0 if left out. All boxes together reach over at most
//! [`SQUARES_MAX`] squares of 4 m.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::{Obstacle, ObstacleKind};
use glam::DVec2;
use serde::{Deserialize, Serialize};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError, memory, write_atomically};

/// The version that is written, and the only one there is.
const VERSION: u32 = 1;
/// Most boxes of a file.
const OBSTACLES_MAX: usize = 1_000_000;
/// Most squares of 4 m that the boxes of a file reach over, each box counted by itself:
/// programs list the boxes of each square. A million posts on corners of squares have half of that.
pub const SQUARES_MAX: u64 = 8_000_000;
/// Side of a square, meters.
const SQUARE_M: f64 = 4.0;
/// Bytes of a list of squares for each square: a box in it, and as much again as the list grows.
const SQUARE_BYTES: u64 = 48;
/// Largest side of a box and largest coordinate, meters.
const SIDE_M_MAX: f64 = 1000.0;
const COORDINATE_M_MAX: f64 = 1e8;

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: u32,
    obstacles: Vec<Form>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Form {
    #[serde(default = "captured")]
    kind: String,
    center_m: [f64; 2],
    #[serde(default)]
    yaw_rad: f64,
    length_m: f64,
    width_m: f64,
}

fn captured() -> String {
    ObstacleKind::Captured.name().to_owned()
}

/// Reads the obstacles of the file at `path`.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Decode`] with the obstacle at fault.
pub fn read_obstacles(path: &Path) -> Result<Vec<Obstacle>, AssetError> {
    decode(&read_bytes(path)?).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "obstacle",
        source,
    })
}

/// Reads obstacles from the bytes of a file.
///
/// # Errors
/// A [`DecodeError`] that names the line or the obstacle (from 0) at fault.
pub fn decode(bytes: &[u8]) -> Result<Vec<Obstacle>, DecodeError> {
    let malformed = |reason: String| DecodeError::Malformed(reason);
    let file: File = serde_json::from_slice(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes))
        .map_err(|error| malformed(error.to_string()))?;
    if file.version != VERSION {
        return Err(malformed(format!(
            "version {}; this program reads version {VERSION}",
            file.version
        )));
    }
    if file.obstacles.len() > OBSTACLES_MAX {
        return Err(malformed(format!(
            "{} obstacles; at most {OBSTACLES_MAX} are read",
            file.obstacles.len()
        )));
    }
    let numbered = file.obstacles.iter().enumerate();
    let obstacles: Vec<Obstacle> = numbered
        .map(|(index, form)| {
            form.obstacle()
                .map_err(|reason| malformed(format!("obstacle {index}: {reason}")))
        })
        .collect::<Result<_, _>>()?;
    let squares: u64 = obstacles.iter().map(squares_of).sum();
    if squares > SQUARES_MAX {
        return Err(malformed(format!(
            "its {} boxes together reach over {squares} squares of {SQUARE_M} m, one box counted after the other; at most {SQUARES_MAX} are read: leave out boxes that lie on others, and cut large ones into smaller",
            obstacles.len()
        )));
    }
    let what = format!("an index of {} boxes", obstacles.len());
    memory::require_product(&what, &[squares], SQUARE_BYTES)
        .map_err(|error| malformed(error.into()))?;
    Ok(obstacles)
}

/// Most squares that a box reaches over, wherever it stands.
fn squares_of(obstacle: &Obstacle) -> u64 {
    let (sin, cos) = obstacle.yaw_rad.sin_cos();
    let (sin, cos) = (sin.abs(), cos.abs());
    let extent_m = [
        cos * obstacle.length_m + sin * obstacle.width_m,
        sin * obstacle.length_m + cos * obstacle.width_m,
    ];
    let along = |extent_m: f64| (extent_m / SQUARE_M).ceil() as u64 + 1;
    extent_m.map(along).into_iter().product()
}

/// Writes obstacles to `path`, atomically.
///
/// # Errors
/// [`AssetError::Write`].
pub fn write_obstacles(path: &Path, obstacles: &[Obstacle]) -> Result<(), AssetError> {
    // A line per obstacle: people delete lines.
    let lines: Vec<String> = obstacles
        .iter()
        .map(|obstacle| {
            let form = serde_json::to_string(&Form::from_obstacle(obstacle));
            format!("  {}", form.expect("numbers and names are JSON"))
        })
        .collect();
    let text = format!(
        "{{\"version\": {VERSION}, \"obstacles\": [\n{}\n]}}\n",
        lines.join(",\n")
    );
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

impl Form {
    fn from_obstacle(obstacle: &Obstacle) -> Self {
        Self {
            kind: obstacle.kind.name().to_owned(),
            center_m: obstacle.center_m.to_array(),
            yaw_rad: obstacle.yaw_rad,
            length_m: obstacle.length_m,
            width_m: obstacle.width_m,
        }
    }

    fn obstacle(&self) -> Result<Obstacle, String> {
        let kind = ObstacleKind::by_name(&self.kind).ok_or_else(|| {
            let names = ObstacleKind::ALL.map(ObstacleKind::name).join(", ");
            format!("the kind '{}' is unknown; there are {names}", self.kind)
        })?;
        let [x, y] = self.center_m;
        for (name, value, range) in [
            ("center_m", x, -COORDINATE_M_MAX..=COORDINATE_M_MAX),
            ("center_m", y, -COORDINATE_M_MAX..=COORDINATE_M_MAX),
            ("yaw_rad", self.yaw_rad, -1e3..=1e3),
            ("length_m", self.length_m, 0.0..=SIDE_M_MAX),
            ("width_m", self.width_m, 0.0..=SIDE_M_MAX),
        ] {
            if !range.contains(&value) {
                let (least, most) = (range.start(), range.end());
                return Err(format!("{name} is {value}; expected {least} to {most}"));
            }
        }
        Ok(Obstacle {
            kind,
            center_m: DVec2::new(x, y),
            yaw_rad: self.yaw_rad,
            length_m: self.length_m,
            width_m: self.width_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn obstacles_are_written_and_read_again_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("obstacles.json");
        let obstacles: Vec<Obstacle> = ObstacleKind::ALL
            .into_iter()
            .enumerate()
            .map(|(index, kind)| Obstacle {
                kind,
                center_m: DVec2::new(0.1 + index as f64, -7.0 / 3.0),
                yaw_rad: 0.7,
                length_m: 1.0 / 3.0,
                width_m: 0.0,
            })
            .collect();
        for some in [&obstacles[..], &[]] {
            write_obstacles(&path, some).unwrap();
            assert_eq!(read_obstacles(&path).unwrap(), some);
        }
    }

    #[test]
    fn faults_name_the_obstacle() {
        let good = "{\"center_m\": [1, 2], \"length_m\": 1, \"width_m\": 1}";
        let file = |forms: &str| format!("{{\"version\": 1, \"obstacles\": [{good}, {forms}]}}");
        assert_eq!(decode(file(good).as_bytes()).unwrap().len(), 2);
        for (from, to, part) in [
            ("[1, 2]", "[1e300, 2]", "obstacle 1: center_m is"),
            ("\"length_m\": 1", "\"length_m\": -1", "0 to 1000"),
            ("{", "{\"kind\": \"cow\", ", "'cow' is unknown"),
            ("\"width_m\": 1", "\"width\": 1", "unknown field"),
        ] {
            let error = decode(file(&good.replace(from, to)).as_bytes()).unwrap_err();
            assert!(error.to_string().contains(part), "{from}: {error}");
        }
        // As large as each may be, at one place: 300 kB that would be gigabytes of squares.
        let large = "{\"center_m\": [0, 0], \"length_m\": 1000, \"width_m\": 1000}";
        let many = |count: usize| decode(file(&[large].repeat(count).join(", ")).as_bytes());
        assert_eq!(many(120).unwrap().len(), 121);
        let error = many(5000).unwrap_err().to_string();
        assert!(error.contains("at most 8000000 are read"), "{error}");
        // A line has no area, and reaches over squares.
        let line = "{\"center_m\": [0, 0], \"length_m\": 1000, \"width_m\": 0, \"yaw_rad\": 0.8}";
        let lines = [line].repeat(300).join(", ");
        assert!(decode(file(&lines).as_bytes()).is_err());
        let other = decode(b"{\"version\": 2, \"obstacles\": []}").unwrap_err();
        assert!(other.to_string().contains("version 2"));
    }
}
