//! Free speeds of lanes whose limit the map does not tell, by class of road.
//!
//! A lane is part of a motorway where at least two lanes run beside each other in
//! one direction, for [`MOTORWAY_M`] or more as far as the map goes, without a sharp bend and
//! without any lane that crosses within [`AROUND_M`]. Without a limit,
//! all others have that of towns.

use std::collections::HashMap;

use crate::polyline::wrapped;
use crate::road_graph::{RoadGraph, RoadLane};

/// Free speed of motorways: 100 km/h, between the limits of urban motorways (80 to 105 km/h) and
/// Treiber's 120 km/h.
const MOTORWAY_MPS: f64 = 100.0 / 3.6;
/// Least length of a motorway, meters.
const MOTORWAY_M: f64 = 150.0;
/// Distance along lanes within which nothing crosses a motorway, meters.
const AROUND_M: f64 = 300.0;
/// Lanes that are looked through at most.
const LANES_MAX: usize = 400;
/// Lanes at a larger angle cross; at a smaller one they merge or part, radians.
const CROSSES_RAD: f64 = 0.5;
/// Lanes that turn by more, in radians over so many meters, are ramps and streets: it is a radius
/// of 250 m, which 80 km/h are for. Turns are looked for in these steps, meters.
const BEND_RAD: f64 = 0.2;
const BEND_M: f64 = 50.0;
const BEND_STEP_M: f64 = 10.0;

/// Class of road of a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LaneClass {
    /// Speed before drivers take their share, m/s: the limit, or where the map tells none that of
    /// the class.
    pub speed_mps: f64,
    /// True for lanes of a motorway. They have no sharp bends: what the points of their lines show
    /// of some is error of the map.
    pub is_motorway: bool,
    /// True where the map tells no limit of a motorway.
    pub is_assumed: bool,
}

/// Classes of all lanes of the map.
pub(super) fn classes(graph: &RoadGraph) -> Vec<LaneClass> {
    let class = |lane: usize| {
        let road = graph.lane(lane);
        let is_motorway = road.is_some() && is_motorway(graph, lane);
        let is_assumed = is_motorway && road.is_some_and(|road| !road.has_limit);
        let speed_mps = match road {
            Some(_) if is_assumed => MOTORWAY_MPS,
            Some(road) => road.speed_limit_mps,
            None => 0.0,
        };
        LaneClass {
            speed_mps,
            is_motorway,
            is_assumed,
        }
    };
    (0..graph.lanes_in_map()).map(class).collect()
}

/// True if the lines of a lane and its surroundings are those of a motorway.
fn is_motorway(graph: &RoadGraph, lane: usize) -> bool {
    let road = graph.road(lane);
    if road.left.or(road.right).is_none() {
        return false;
    }
    let behind = around(graph, lane, |road| &road.predecessors);
    let ahead = around(graph, lane, |road| &road.successors);
    let far_m = |found: &HashMap<usize, f64>| found.values().copied().fold(0.0, f64::max);
    let length_m = far_m(&behind) + far_m(&ahead) - road.line.length_m();
    let mut all = behind.keys().chain(ahead.keys());
    length_m >= MOTORWAY_M && all.all(|&lane| is_plain(graph, lane))
}

/// Lanes within [`AROUND_M`] of one, itself too, along links and to the sides; and how far each
/// reaches, meters.
fn around(
    graph: &RoadGraph,
    lane: usize,
    links: impl Fn(&RoadLane) -> &Vec<usize>,
) -> HashMap<usize, f64> {
    let mut found = HashMap::new();
    let mut open = vec![(lane, 0.0_f64)];
    while let Some((lane, from_m)) = open.pop() {
        let road = graph.road(lane);
        let to_m = from_m + road.line.length_m();
        if found.len() >= LANES_MAX || found.get(&lane).is_some_and(|&known_m| known_m <= to_m) {
            continue;
        }
        found.insert(lane, to_m);
        open.extend(
            [road.left, road.right]
                .into_iter()
                .flatten()
                .map(|beside| (beside, from_m)),
        );
        if to_m < AROUND_M {
            open.extend(links(road).iter().map(|&next| (next, to_m)));
        }
    }
    found
}

/// True if a lane has no sharp bend, and no lane crosses it.
fn is_plain(graph: &RoadGraph, lane: usize) -> bool {
    let road = graph.road(lane);
    let mut conflicts = road.conflicts.iter();
    let crosses = conflicts.any(|conflict| {
        let other = graph.road(conflict.other);
        let own_rad = road.line.heading_at(conflict.from_m);
        wrapped(other.line.heading_at(conflict.other_from_m) - own_rad).abs() > CROSSES_RAD
    });
    let length_m = road.line.length_m();
    let count = (length_m / BEND_STEP_M).ceil().clamp(1.0, 1e4) as u32;
    let mut places = (0..count).map(|at| BEND_STEP_M * f64::from(at));
    let turns_rad = |at_m: f64| {
        let to_rad = road.line.heading_at((at_m + BEND_M).min(length_m));
        wrapped(to_rad - road.line.heading_at(at_m)).abs()
    };
    !crosses && places.all(|at_m| turns_rad(at_m) <= BEND_RAD)
}
