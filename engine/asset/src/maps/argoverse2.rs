//! Argoverse 2 maps (`log_map_archive_*.json`): lane segments between two boundaries, in city
//! coordinates with heights.
//!
//! A segment's centerline is the file's or, where it has none, the middle of its boundaries.
//! Neighbors are kept where they run the same way, told by their ends. Pedestrian crossings and
//! drivable areas are not read, and speed limits are not in the format.

use std::collections::BTreeMap;

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::DVec3;
use serde::Deserialize;

use super::links::{LaneIndices, join};
use super::polyline::{at_heights_of, between, cleaned};
use crate::DecodeError;

#[derive(Deserialize)]
struct File {
    lane_segments: BTreeMap<String, Segment>,
}

#[derive(Deserialize)]
struct Segment {
    id: i64,
    #[serde(default)]
    lane_type: String,
    left_lane_boundary: Vec<Point>,
    right_lane_boundary: Vec<Point>,
    centerline: Option<Vec<Point>>,
    #[serde(default)]
    successors: Vec<i64>,
    #[serde(default)]
    predecessors: Vec<i64>,
    left_neighbor_id: Option<i64>,
    right_neighbor_id: Option<i64>,
}

#[derive(Clone, Copy, Deserialize)]
struct Point {
    x: f64,
    y: f64,
    z: f64,
}

/// Reads the lane segments of a file, in the order of their keys.
///
/// # Errors
/// A [`DecodeError`] that names the line or segment at fault.
pub fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    let file: File =
        serde_json::from_slice(bytes).map_err(|error| DecodeError::Malformed(error.to_string()))?;
    let segments: Vec<Segment> = file.lane_segments.into_values().collect();
    let mut lanes: Vec<Lane> = segments.iter().map(lane).collect();
    let indices = LaneIndices::new(&lanes)?;
    let index = |id: i64| indices.get(&id.to_string());
    for (at, segment) in segments.iter().enumerate() {
        for next in segment.successors.iter().filter_map(|&id| index(id)) {
            join(&mut lanes, at, next);
        }
        for before in segment.predecessors.iter().filter_map(|&id| index(id)) {
            join(&mut lanes, before, at);
        }
        let beside = |id: Option<i64>| {
            id.and_then(index)
                .filter(|&other| run_alike(&lanes[at], &lanes[other]))
        };
        let (left, right) = (
            beside(segment.left_neighbor_id),
            beside(segment.right_neighbor_id),
        );
        (lanes[at].left_neighbor, lanes[at].right_neighbor) = (left, right);
    }
    super::finished(lanes, DVec3::ZERO)
}

fn lane(segment: &Segment) -> Lane {
    let line = |points: &[Point]| {
        cleaned(
            points
                .iter()
                .map(|point| DVec3::new(point.x, point.y, point.z)),
        )
    };
    let (left, right) = (
        line(&segment.left_lane_boundary),
        line(&segment.right_lane_boundary),
    );
    let middle = between(&left, &right);
    let centerline = match segment.centerline.as_deref().map(line) {
        // Motion forecasting maps have centerlines at z = 0 between borders at their true heights.
        Some(flat) if !middle.is_empty() && has_no_height(&flat) && !has_no_height(&middle) => {
            at_heights_of(&flat, &middle)
        }
        Some(given) => given,
        None => middle,
    };
    let kind = match segment.lane_type.as_str() {
        "VEHICLE" | "BUS" | "" => LaneKind::Driving,
        "BIKE" => LaneKind::Bicycle,
        _ => LaneKind::Other,
    };
    Lane {
        id: segment.id.to_string(),
        kind,
        centerline,
        left,
        right,
        has_height: true,
        ..Lane::default()
    }
}

fn has_no_height(line: &[DVec3]) -> bool {
    line.iter().all(|point| point.z == 0.0)
}

/// True if two lanes lead in the same direction, from end to end.
fn run_alike(a: &Lane, b: &Lane) -> bool {
    let way = |lane: &Lane| Some((*lane.centerline.last()? - *lane.centerline.first()?).truncate());
    way(a).zip(way(b)).is_some_and(|(a, b)| a.dot(b) > 0.0)
}
