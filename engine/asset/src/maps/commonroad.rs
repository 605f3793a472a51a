//! CommonRoad scenarios (`.xml`, versions 2018b and 2020a): lanelets between two bounds.
//!
//! A lanelet's kind is its `laneletType` (2020a; 2018b knows only roads). Its speed limit is its
//! `speedLimit` (2018b) or that of the signs that it refers to (2020a), meters per second.
//! Neighbors are kept where they run the same way. Traffic lights (2020a) have their cycles
//! (`lights`), and stop and yield signs stand at stop lines. The road users of a scenario are
//! [`crate::tracks::commonroad`]'s.

mod lights;

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, LaneMap, SignKind, StopLine, TrafficSign};
use glam::DVec3;

use super::links::{LaneIndices, join};
use super::polyline::{between, cleaned};
use super::speed;
use crate::DecodeError;
use crate::xml::{Element, excerpt, parse};

/// Signs that limit the speed, also in a zone: of Germany (and CommonRoad's own country), the
/// United States, Spain, France, Belgium, Russia, Croatia and Greece.
const SPEED_LIMIT_SIGNS: [&str; 9] = [
    "274", "274.1", "R2-1", "r301", "B14", "C43", "3.24", "B31", "R32",
];

/// The scenario that a document is, of a version that is read.
pub(crate) fn scenario<'a>(
    document: &'a roxmltree::Document<'a>,
) -> Result<Element<'a>, DecodeError> {
    let root = Element::root(document, "commonRoad")?;
    match root.attribute("commonRoadVersion") {
        Some("2018b" | "2020a") => Ok(root),
        found => {
            let version = excerpt(found.unwrap_or("none"));
            Err(DecodeError::Unsupported(format!(
                "CommonRoad version {version}; versions 2018b and 2020a are read"
            )))
        }
    }
}

/// Reads the lanelets of a scenario.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    let document = parse(bytes)?;
    let root = scenario(&document)?;
    let mut sign_limits = HashMap::new();
    for sign in root.all("trafficSign") {
        if let Some(limit_mps) = sign_limit_mps(sign) {
            sign_limits.insert(sign.needed_attribute("id")?, limit_mps);
        }
    }
    let elements: Vec<Element> = root.all("lanelet").collect();
    let mut lanes = elements
        .iter()
        .map(|element| lane(*element, &sign_limits))
        .collect::<Result<Vec<_>, _>>()?;
    let indices = LaneIndices::new(&lanes)?;
    for (at, element) in elements.iter().enumerate() {
        let linked = |name: &str| {
            element
                .all(name)
                .filter_map(|link| indices.get(link.attribute("ref")?))
                .collect::<Vec<_>>()
        };
        linked("successor")
            .into_iter()
            .for_each(|next| join(&mut lanes, at, next));
        linked("predecessor")
            .into_iter()
            .for_each(|before| join(&mut lanes, before, at));
        let beside = |name: &str| {
            let neighbor = element
                .first(name)
                .filter(|link| link.attribute("drivingDir") == Some("same"));
            neighbor.and_then(|link| indices.get(link.attribute("ref")?))
        };
        (lanes[at].left_neighbor, lanes[at].right_neighbor) =
            (beside("adjacentLeft"), beside("adjacentRight"));
    }
    let lights = lights::lights(root, &elements, &lanes)?;
    let signs = signs(root, &elements, &lanes)?;
    Ok(LaneMap {
        lights,
        signs,
        ..super::finished(lanes, DVec3::ZERO)?
    })
}

fn lane(element: Element, sign_limits: &HashMap<&str, f64>) -> Result<Lane, DecodeError> {
    let (left, left_has_height) = bound(element.needed("leftBound")?)?;
    let (right, right_has_height) = bound(element.needed("rightBound")?)?;
    let has_height = left_has_height && right_has_height;
    let line = |points: Vec<DVec3>| {
        cleaned(
            points
                .into_iter()
                .map(|point| if has_height { point } else { point.with_z(0.0) }),
        )
    };
    let (left, right) = (line(left), line(right));
    let own_limit = element
        .first("speedLimit")
        .map(Element::text_number)
        .transpose()?;
    let signs = element
        .all("trafficSignRef")
        .filter_map(|sign| sign_limits.get(sign.attribute("ref")?).copied());
    Ok(Lane {
        id: element.needed_attribute("id")?.to_owned(),
        kind: kind(element),
        centerline: between(&left, &right),
        left,
        right,
        has_height,
        speed_limit_mps: own_limit
            .or(signs.min_by(f64::total_cmp))
            .filter(|limit_mps| *limit_mps > 0.0),
        ..Lane::default()
    })
}

/// The points of a bound and whether all their heights are known.
fn bound(element: Element) -> Result<(Vec<DVec3>, bool), DecodeError> {
    let mut has_height = true;
    let mut points = Vec::new();
    for point in element.all("point") {
        let height_m = point.first("z").map(Element::text_number).transpose()?;
        has_height &= height_m.is_some();
        let [x, y] = [
            point.needed("x")?.text_number()?,
            point.needed("y")?.text_number()?,
        ];
        points.push(DVec3::new(x, y, height_m.unwrap_or(0.0)));
    }
    if points.is_empty() {
        Err(element.fault("it has no points"))
    } else {
        Ok((points, has_height))
    }
}

/// Stop and yield signs of driving lanes, at their stop lines: Germany's (and CommonRoad's own) and
/// those of the United States.
fn signs(
    root: Element,
    lanelets: &[Element],
    lanes: &[Lane],
) -> Result<Vec<TrafficSign>, DecodeError> {
    let mut kinds = HashMap::new();
    for sign in root.all("trafficSign") {
        let ids = sign
            .all("trafficSignElement")
            .filter_map(|part| part.first("trafficSignID"));
        let kind = ids
            .filter_map(|id| match id.text() {
                "206" | "R1-1" => Some(SignKind::Stop),
                "205" | "R1-2" => Some(SignKind::Yield),
                _ => None,
            })
            .next();
        if let (Some(kind), Some(id)) = (kind, sign.attribute("id")) {
            kinds.insert(id, kind);
        }
    }
    let mut signs = Vec::new();
    let driven = lanelets.iter().zip(lanes);
    for (lanelet, lane) in driven.filter(|(_, lane)| lane.kind == LaneKind::Driving) {
        let of_line = lanelet.first("stopLine");
        let of_line = of_line.iter().flat_map(|line| line.all("trafficSignRef"));
        let mut named = lanelet.all("trafficSignRef").chain(of_line);
        let kind = named.find_map(|sign| kinds.get(sign.attribute("ref")?).copied());
        if let Some(kind) = kind {
            signs.push(TrafficSign {
                kind,
                line: StopLine {
                    lane: lane.id.clone(),
                    at_m: lights::stop_at_m(*lanelet, lane)?,
                    ..StopLine::default()
                },
            });
        }
    }
    Ok(signs)
}

/// The least limit that the elements of a sign set, if they set one.
fn sign_limit_mps(sign: Element) -> Option<f64> {
    let mut least_mps: Option<f64> = None;
    for part in sign.all("trafficSignElement") {
        let is_limit = part
            .first("trafficSignID")
            .is_some_and(|id| SPEED_LIMIT_SIGNS.contains(&id.text()));
        if let Some(value) = part.first("additionalValue").filter(|_| is_limit) {
            // Meters a second, unless a converter wrote a unit.
            let Some((number, factor)) = speed::with_unit(value.text()) else {
                log::warn!(
                    "line {}: the speed limit '{}' is no speed; it is left out",
                    value.line(),
                    excerpt(value.text())
                );
                continue;
            };
            let limit_mps = number * factor.unwrap_or(1.0);
            least_mps = Some(least_mps.map_or(limit_mps, |least| least.min(limit_mps)));
        }
    }
    least_mps
}

fn kind(element: Element) -> LaneKind {
    let of = |name: &str| match name {
        "sidewalk" | "crosswalk" => LaneKind::Walking,
        "bicycleLane" => LaneKind::Bicycle,
        "parking" => LaneKind::Parking,
        "shoulder" | "border" | "restricted" => LaneKind::Other,
        _ => LaneKind::Driving,
    };
    // A lanelet has several types: an urban sidewalk is a sidewalk.
    let mut kinds = element.all("laneletType").map(|kind| of(kind.text()));
    kinds
        .find(|kind| *kind != LaneKind::Driving)
        .unwrap_or_default()
}
