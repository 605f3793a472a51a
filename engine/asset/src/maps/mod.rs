//! Maps of lanes: OpenDRIVE, Lanelet2, Argoverse 2, CommonRoad and our own JSON.
//!
//! Every reader gives a [`LaneMap`]: borders and a centerline in driving direction, meters, x east
//! and y north where the file knows of such, and how lanes join. Coordinates are the file's own
//! ([`LaneMap::offset`] is zero); latitudes and longitudes are projected, see [`projection`]. A
//! link to a lane that the file does not hold is dropped, as maps are often cut out of larger ones
//! (our own JSON, which is written whole, is refused instead); an id that two lanes have is
//! refused, and so is a map without lanes.

pub mod argoverse2;
mod budget;
pub mod commonroad;
pub mod lane_json;
pub mod lanelet2;
mod light_direction;
mod links;
pub mod open_drive;
mod polyline;
pub mod projection;
mod speed;

use decouplegs_scene::{Invalid, Lane, LaneMap};
use glam::DVec3;

use crate::DecodeError;

pub use polyline::length_m;

/// Largest coordinate, meters: larger ones are no place on Earth.
const COORDINATE_MAX_M: f64 = 1e8;

/// The formats of maps that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFormat {
    /// ASAM OpenDRIVE, `.xodr`.
    OpenDrive,
    /// Lanelet2 in OpenStreetMap's XML, `.osm`.
    Lanelet2,
    /// Argoverse 2, `log_map_archive_*.json`.
    Argoverse2,
    /// CommonRoad scenarios, `.xml`.
    CommonRoad,
    /// Lane format of this project, see [`lane_json`].
    LaneJson,
}

impl MapFormat {
    /// Name of the format for users.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenDrive => "OpenDRIVE",
            Self::Lanelet2 => "Lanelet2",
            Self::Argoverse2 => "Argoverse 2 map",
            Self::CommonRoad => "CommonRoad",
            Self::LaneJson => "lane JSON",
        }
    }

    /// The format of `bytes`, told by the names in them.
    ///
    /// # Errors
    /// A sentence on what was found.
    pub fn detect(bytes: &[u8]) -> Result<Self, Invalid> {
        if let Some(name) = crate::xml::other_encoding(bytes) {
            return Err(format!("a text in {name}; convert it to UTF-8").into());
        }
        let text = bytes
            .strip_prefix(b"\xef\xbb\xbf")
            .unwrap_or(bytes)
            .trim_ascii_start();
        match text.first() {
            Some(b'<') => {
                let named = |name: &str| {
                    text.windows(name.len())
                        .take(ROOT_WITHIN_BYTES)
                        .position(|part| part == name.as_bytes())
                };
                let roots = [
                    ("<OpenDRIVE", Self::OpenDrive),
                    // With the prefix of a namespace.
                    (":OpenDRIVE", Self::OpenDrive),
                    ("<osm", Self::Lanelet2),
                    ("<commonRoad", Self::CommonRoad),
                ];
                let first = roots
                    .into_iter()
                    .filter_map(|(name, format)| Some((named(name)?, format)))
                    .min_by_key(|found| found.0);
                first
                    .map(|(_, format)| format)
                    .ok_or_else(|| "XML of another kind".into())
            }
            Some(b'{') if has_key(text, "lane_segments") => Ok(Self::Argoverse2),
            Some(b'{') => Ok(Self::LaneJson),
            Some(_) => Err("neither XML nor a JSON object".into()),
            None => Err("the file is empty".into()),
        }
    }
}

/// Number of bytes within which a root element starts.
const ROOT_WITHIN_BYTES: usize = 1 << 16;

/// True if `text` is a JSON object with `key`. The reader of the format explains invalid JSON.
fn has_key(text: &[u8], key: &str) -> bool {
    type Object = std::collections::HashMap<String, serde::de::IgnoredAny>;
    serde_json::from_slice::<Object>(text).is_ok_and(|object| object.contains_key(key))
}

/// Reads the lanes of a map from the bytes of its file.
///
/// # Errors
/// A [`DecodeError`] that names the line, element or lane at fault.
pub fn decode(bytes: &[u8], format: MapFormat) -> Result<LaneMap, DecodeError> {
    match format {
        MapFormat::OpenDrive => open_drive::decode(bytes),
        MapFormat::Lanelet2 => lanelet2::decode(bytes),
        MapFormat::Argoverse2 => argoverse2::decode(bytes),
        MapFormat::CommonRoad => commonroad::decode(bytes),
        MapFormat::LaneJson => lane_json::decode(bytes),
    }
}

/// The map of `lanes`, their links in order.
///
/// # Errors
/// A [`DecodeError`] where there are none or one of them is no lane.
fn finished(mut lanes: Vec<Lane>, offset: DVec3) -> Result<LaneMap, DecodeError> {
    if lanes.is_empty() {
        return Err(DecodeError::Malformed(
            "the file holds no lane; expected at least one".into(),
        ));
    }
    links::tidy(&mut lanes);
    // A limit of nothing is none: maps write 0 where they know no limit.
    for lane in &mut lanes {
        lane.speed_limit_mps = lane.speed_limit_mps.filter(|speed_mps| *speed_mps > 0.0);
    }
    let map = LaneMap {
        lanes,
        offset,
        lights: Vec::new(),
        signs: Vec::new(),
    };
    map.check()
        .map_err(|error| DecodeError::Malformed(error.into()))?;
    for lane in &map.lanes {
        let mut points = lane.centerline.iter().chain(&lane.left).chain(&lane.right);
        if let Some(point) = points.find(|point| point.abs().max_element() > COORDINATE_MAX_M) {
            let id = &lane.id;
            return Err(DecodeError::Malformed(format!(
                "lane {id}: a point at {point} m, which is no place on Earth"
            )));
        }
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_by_content() {
        for (text, expected) in [
            (
                "<?xml version='1.0'?>\n<OpenDRIVE>",
                Ok(MapFormat::OpenDrive),
            ),
            ("\u{feff} <osm version='0.6'>", Ok(MapFormat::Lanelet2)),
            ("<!-- not <osm --><commonRoad>", Ok(MapFormat::Lanelet2)),
            ("<commonRoad>", Ok(MapFormat::CommonRoad)),
            ("{\"lane_segments\": {}}", Ok(MapFormat::Argoverse2)),
            ("{\"lanes\": []}", Ok(MapFormat::LaneJson)),
            ("{broken", Ok(MapFormat::LaneJson)),
            ("<html>", Err("XML of another kind".into())),
            (
                "<od:OpenDRIVE xmlns:od='http://x'>",
                Ok(MapFormat::OpenDrive),
            ),
            ("[1]", Err("neither XML nor a JSON object".into())),
            ("", Err("the file is empty".into())),
        ] {
            assert_eq!(MapFormat::detect(text.as_bytes()), expected, "{text}");
        }
        let utf16: Vec<u8> = "\u{feff}<OpenDRIVE/>"
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect();
        let message = MapFormat::detect(&utf16).unwrap_err().to_string();
        assert!(
            message.contains("UTF-16") && message.contains("UTF-8"),
            "{message}"
        );
    }
}

#[cfg(test)]
mod limits {
    use super::*;

    #[test]
    fn a_speed_limit_of_nothing_is_none() {
        let lane = |id: &str, speed_limit_mps: Option<f64>| Lane {
            id: id.into(),
            centerline: vec![DVec3::ZERO, DVec3::X],
            speed_limit_mps,
            ..Lane::default()
        };
        let map = finished(
            vec![
                lane("a", Some(0.0)),
                lane("b", Some(-1.0)),
                lane("c", Some(9.0)),
            ],
            DVec3::ZERO,
        )
        .unwrap();
        let limits: Vec<Option<f64>> = map.lanes.iter().map(|lane| lane.speed_limit_mps).collect();
        assert_eq!(limits, [None, None, Some(9.0)]);
        let written = lane_json::encode(&map).unwrap();
        assert_eq!(lane_json::decode(&written).unwrap(), map);
    }
}
