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

#[cfg(test)]
mod tests {
    use decouplegs_scene::{Lane, LaneMap};
    use glam::{DVec2, DVec3};

    use super::*;

    /// A lane along points, with borders 1.75 m beside them.
    fn lane(id: &str, points: &[DVec2]) -> Lane {
        let line = |left_m: f64| -> Vec<DVec3> {
            let last = points.len() - 1;
            let point = |at: usize| {
                let along = points[(at + 1).min(last)] - points[at.saturating_sub(1)];
                (points[at] + left_m * along.normalize().perp()).extend(0.0)
            };
            (0..points.len()).map(point).collect()
        };
        Lane {
            id: id.into(),
            centerline: line(0.0),
            left: line(1.75),
            right: line(-1.75),
            ..Lane::default()
        }
    }

    /// Two lanes beside each other to the east, `length_m` long, that turn by `turn_rad` in 50 m in
    /// their middle.
    fn two_lanes(length_m: f64, turn_rad: f64) -> LaneMap {
        let points = |left_m: f64| -> Vec<DVec2> {
            let count = (length_m / 5.0) as u32;
            let mut at_m = DVec2::ZERO;
            let mut points = Vec::new();
            for step in 0..=count {
                let share = (5.0 * f64::from(step) - 0.5 * length_m) / 50.0 + 0.5;
                let ahead = DVec2::from_angle(turn_rad * share.clamp(0.0, 1.0));
                points.push(at_m + left_m * ahead.perp());
                at_m += 5.0 * ahead;
            }
            points
        };
        let (mut right, mut left) = (lane("right", &points(0.0)), lane("left", &points(3.5)));
        (right.left_neighbor, left.right_neighbor) = (Some(1), Some(0));
        LaneMap {
            lanes: vec![right, left],
            ..LaneMap::default()
        }
    }

    fn classes_of(map: &LaneMap) -> Vec<LaneClass> {
        classes(&RoadGraph::new(map).unwrap())
    }

    const TOWN: LaneClass = LaneClass {
        speed_mps: 50.0 / 3.6,
        is_motorway: false,
        is_assumed: false,
    };

    #[test]
    fn two_long_straight_lanes_are_a_motorway_where_the_map_tells_no_limit() {
        let motorway = LaneClass {
            speed_mps: MOTORWAY_MPS,
            is_motorway: true,
            is_assumed: true,
        };
        assert_eq!(classes_of(&two_lanes(300.0, 0.0)), [motorway; 2]);
        assert_eq!(classes_of(&two_lanes(300.0, 0.1)), [motorway; 2]);
        // A limit of the map stays.
        let mut map = two_lanes(300.0, 0.0);
        map.lanes[0].speed_limit_mps = Some(22.0);
        let told = LaneClass {
            speed_mps: 22.0,
            is_assumed: false,
            ..motorway
        };
        assert_eq!(classes_of(&map), [told, motorway]);
    }

    #[test]
    fn short_bent_single_and_crossed_roads_are_those_of_towns() {
        assert_eq!(classes_of(&two_lanes(100.0, 0.0)), [TOWN; 2]);
        assert_eq!(classes_of(&two_lanes(300.0, 0.5)), [TOWN; 2]);
        let mut single = two_lanes(300.0, 0.0);
        single.lanes.truncate(1);
        single.lanes[0].left_neighbor = None;
        assert_eq!(classes_of(&single), [TOWN]);
        let mut crossed = two_lanes(300.0, 0.0);
        let across = [DVec2::new(150.0, -60.0), DVec2::new(150.0, 60.0)];
        crossed.lanes.push(lane("across", &across));
        assert_eq!(classes_of(&crossed), [TOWN; 3]);
    }

    #[test]
    fn lanes_one_after_the_other_count_together() {
        let mut map = two_lanes(100.0, 0.0);
        let mut onward = two_lanes(100.0, 0.0);
        for (at, lane) in onward.lanes.iter_mut().enumerate() {
            lane.id += " onward";
            for line in [&mut lane.centerline, &mut lane.left, &mut lane.right] {
                line.iter_mut().for_each(|point| point.x += 100.0);
            }
            lane.left_neighbor = lane.left_neighbor.map(|beside| beside + 2);
            lane.right_neighbor = lane.right_neighbor.map(|beside| beside + 2);
            lane.predecessors = vec![at];
            map.lanes[at].successors = vec![at + 2];
        }
        map.lanes.append(&mut onward.lanes);
        let all = classes_of(&map);
        assert!(all.iter().all(|class| class.is_motorway), "{all:?}");
    }
}
