//! Lane format of this project: JSON that can be written by hand or by a script from any source.
//!
//! ```json
//! {"version": 1, "lanes": [
//!   {"id": "a", "centerline": [[0, 0], [50, 0]]},
//!   {"id": "b", "kind": "driving", "centerline": [[50, 0, 1.5], [90, 8, 1.5]],
//!    "left": [[50, 2, 1.5], [90, 10, 1.5]], "right": [[50, -2, 1.5], [90, 6, 1.5]],
//!    "successors": ["a"], "left_neighbor": null, "speed_limit_mps": 13.9}
//! ]}
//! ```
//!
//! Beside `lanes` a file may have `lights`, the traffic lights: each has a `name`, `stop_lines` as
//! pairs of lane and meters along it (and a list of the successors that it is for, where it is not
//! for all), and, where they are known, `phases` as pairs of color (green,
//! yellow, red) and seconds, and `offset_s`, its position in the cycle at time 0. It may have
//! `signs`, each with a `kind` (stop, yield), its `lane` and `at_m`, its position along the lane.
//!
//! A lane needs its id, a text or a whole number, and its centerline, world coordinates in meters
//! in driving direction. Points of two numbers have no height: where a lane has one, or says
//! `"has_height": false`, its z is 0. `kind` is one of [`LaneKind::by_name`]'s, driving where
//! absent. Links name lanes of the same file; predecessors follow from successors. `offset` (see
//! [`LaneMap::offset`]) is zero where absent. Keys that are not known are refused, so that no
//! typing error passes for an absent key. `centreline`, `left_neighbour` and `right_neighbour`, as
//! older files have them, are read too.

use std::io::{self, Write};
use std::path::Path;

use decouplegs_scene::{Invalid, Lane, LaneKind, LaneMap, TrafficLight, TrafficSign};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::links::{LaneIndices, join};
use super::polyline::cleaned;
use crate::traffic_light_form::{self, Fault, LIGHTS_MAX, Least, LightForm};
use crate::traffic_sign_form::{self, SIGNS_MAX, SignForm};
use crate::xml::excerpt;
use crate::{AssetError, DecodeError, write_atomically};

/// The version that is written, and the only one there is.
pub const VERSION: u32 = 1;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: Option<u32>,
    offset: Option<[f64; 3]>,
    lanes: Vec<LaneForm>,
    #[serde(default)]
    lights: Vec<LightForm>,
    #[serde(default)]
    signs: Vec<SignForm>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct LaneForm {
    id: Id,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    kind: Option<String>,
    #[serde(alias = "centreline")]
    centerline: Vec<Point>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    left: Vec<Point>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    right: Vec<Point>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    has_height: Option<bool>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    successors: Vec<Id>,
    #[serde(
        default,
        alias = "left_neighbour",
        skip_serializing_if = "Option::is_none"
    )]
    left_neighbor: Option<Id>,
    #[serde(
        default,
        alias = "right_neighbour",
        skip_serializing_if = "Option::is_none"
    )]
    right_neighbor: Option<Id>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_limit_mps: Option<f64>,
}

#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "expected an id: a text or a whole number")]
enum Id {
    Text(String),
    Number(i64),
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a point of 2 or 3 numbers")]
enum Point {
    Solid([f64; 3]),
    Flat([f64; 2]),
}

impl Id {
    fn into_text(self) -> String {
        match self {
            Self::Text(text) => text,
            Self::Number(number) => number.to_string(),
        }
    }
}

/// Reads lanes from the bytes of a file.
///
/// # Errors
/// A [`DecodeError`] that names the line or the lane at fault.
pub fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    let file: File =
        serde_json::from_slice(bytes).map_err(|error| DecodeError::Malformed(error.to_string()))?;
    if let Some(version) = file.version.filter(|version| *version != VERSION) {
        return Err(DecodeError::Unsupported(format!(
            "version {version}; version {VERSION} is read"
        )));
    }
    let mut lanes = Vec::with_capacity(file.lanes.len());
    let mut links = Vec::with_capacity(file.lanes.len());
    for mut form in file.lanes {
        links.push((
            std::mem::take(&mut form.successors),
            form.left_neighbor.take(),
            form.right_neighbor.take(),
        ));
        lanes.push(form.into_lane()?);
    }
    let indices = LaneIndices::new(&lanes)?;
    for (at, (successors, left, right)) in links.into_iter().enumerate() {
        let index = |id: Id| {
            let id = id.into_text();
            let from = excerpt(&lanes[at].id);
            let missing = || {
                DecodeError::Malformed(format!(
                    "lane {from} names lane {}, which is not there",
                    excerpt(&id)
                ))
            };
            indices.get(&id).ok_or_else(missing)
        };
        let next = successors
            .into_iter()
            .map(index)
            .collect::<Result<Vec<_>, _>>()?;
        let (left, right) = (left.map(index).transpose()?, right.map(index).transpose()?);
        (lanes[at].left_neighbor, lanes[at].right_neighbor) = (left, right);
        next.into_iter().for_each(|next| join(&mut lanes, at, next));
    }
    let mut map = super::finished(lanes, DVec3::from_array(file.offset.unwrap_or_default()))?;
    map.lights = items(
        ("lights", "traffic lights", LIGHTS_MAX),
        &file.lights,
        light,
    )?;
    map.signs = items(("signs", "signs", SIGNS_MAX), &file.signs, sign)?;
    map.check()
        .map_err(|error| DecodeError::Malformed(error.into()))?;
    Ok(map)
}

fn light(form: &LightForm) -> Result<TrafficLight, Fault> {
    let light = form.light()?;
    traffic_light_form::check(&light, Least::OF_MAP)?;
    Ok(light)
}

fn sign(form: &SignForm) -> Result<TrafficSign, Fault> {
    let sign = form.sign()?;
    traffic_sign_form::check(&sign)?;
    Ok(sign)
}

/// The list with a key, at most `most` items that are called `what`.
fn items<F, T>(
    (key, what, most): (&str, &str, usize),
    forms: &[F],
    read: impl Fn(&F) -> Result<T, Fault>,
) -> Result<Vec<T>, DecodeError> {
    if forms.len() > most {
        return Err(DecodeError::Malformed(format!(
            "{} {what}; expected at most {most}",
            forms.len()
        )));
    }
    let refused = |(at, fault): (usize, Fault)| {
        DecodeError::Malformed(format!("{key}[{at}].{}: {}", fault.field, fault.reason))
    };
    let forms = forms.iter().enumerate();
    forms
        .map(|(at, form)| read(form).map_err(|fault| refused((at, fault))))
        .collect()
}

/// JSON of a list with a key after another one; empty for no forms.
fn list<F: Serialize>(key: &str, forms: impl Iterator<Item = F>) -> Result<String, String> {
    let items = forms.map(|form| serde_json::to_string(&form));
    let items = items.collect::<Result<Vec<_>, _>>();
    let items = items.map_err(|error| error.to_string())?;
    Ok(if items.is_empty() {
        String::new()
    } else {
        format!(", \"{key}\": [\n{}\n]", items.join(",\n"))
    })
}

impl LaneForm {
    fn into_lane(self) -> Result<Lane, DecodeError> {
        let id = self.id.into_text();
        let kind = match self.kind {
            None => LaneKind::Driving,
            Some(name) => LaneKind::by_name(&name).ok_or_else(|| {
                let kinds = "driving, bicycle, walking, parking or other";
                DecodeError::Malformed(format!(
                    "lane {}: the kind '{}'; expected {kinds}",
                    excerpt(&id),
                    excerpt(&name)
                ))
            })?,
        };
        if let Some(limit) = self.speed_limit_mps.filter(|limit| *limit <= 0.0) {
            return Err(DecodeError::Malformed(format!(
                "lane {}: a speed limit of {limit} m/s; expected more",
                excerpt(&id)
            )));
        }
        let mut points = self.centerline.iter().chain(&self.left).chain(&self.right);
        let is_solid = points.all(|point| matches!(point, Point::Solid(_)));
        if self.has_height == Some(true) && !is_solid {
            return Err(DecodeError::Malformed(format!(
                "lane {}: has_height, but a point of two numbers",
                excerpt(&id)
            )));
        }
        let has_height = is_solid && self.has_height != Some(false);
        let line = |points: Vec<Point>| {
            cleaned(points.into_iter().map(|point| match point {
                Point::Solid([x, y, z]) => DVec3::new(x, y, if has_height { z } else { 0.0 }),
                Point::Flat([x, y]) => DVec3::new(x, y, 0.0),
            }))
        };
        let [centerline, left, right] = [self.centerline, self.left, self.right].map(line);
        Ok(Lane {
            id,
            kind,
            centerline,
            left,
            right,
            has_height,
            speed_limit_mps: self.speed_limit_mps,
            ..Lane::default()
        })
    }

    fn from_lane(lane: &Lane, all: &[Lane]) -> Self {
        let line = |points: &[DVec3]| -> Vec<Point> {
            let point = |point: &DVec3| match lane.has_height {
                true => Point::Solid(point.to_array()),
                false => Point::Flat([point.x, point.y]),
            };
            points.iter().map(point).collect()
        };
        let id = |at: usize| Id::Text(all[at].id.clone());
        Self {
            id: Id::Text(lane.id.clone()),
            kind: Some(lane.kind.name().to_owned()),
            centerline: line(&lane.centerline),
            left: line(&lane.left),
            right: line(&lane.right),
            has_height: Some(lane.has_height),
            successors: lane.successors.iter().copied().map(id).collect(),
            left_neighbor: lane.left_neighbor.map(id),
            right_neighbor: lane.right_neighbor.map(id),
            speed_limit_mps: lane.speed_limit_mps,
        }
    }
}

/// The bytes of a file that holds `map`, a lane a line; numbers come back to the last bit.
///
/// # Errors
/// A sentence on what is wrong with the map, see [`LaneMap::check`].
pub fn encode(map: &LaneMap) -> Result<Vec<u8>, Invalid> {
    map.check()?;
    let lanes = map
        .lanes
        .iter()
        .map(|lane| serde_json::to_string(&LaneForm::from_lane(lane, &map.lanes)));
    let lanes = lanes
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| error.to_string())?;
    let offset =
        serde_json::to_string(&map.offset.to_array()).map_err(|error| error.to_string())?;
    let lights = list("lights", map.lights.iter().map(LightForm::from_light))?;
    let signs = list("signs", map.signs.iter().map(SignForm::from_sign))?;
    Ok(format!(
        "{{\"version\": {VERSION}, \"offset\": {offset}, \"lanes\": [\n{}\n]{lights}{signs}}}\n",
        lanes.join(",\n")
    )
    .into_bytes())
}

/// Writes `map` to `path`, whole or not at all.
///
/// # Errors
/// [`AssetError::Write`].
pub fn write(path: &Path, map: &LaneMap) -> Result<(), AssetError> {
    let refused = |reason| AssetError::Write {
        path: path.to_owned(),
        source: io::Error::new(io::ErrorKind::InvalidInput, reason),
    };
    let bytes = encode(map).map_err(refused)?;
    write_atomically(path, |file| file.write_all(&bytes))
}
