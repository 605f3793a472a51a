//! The lanes that a track drives along: map matching by a hidden Markov model (Newson and Krumm,
//! Hidden Markov Map Matching Through Noise and Sparseness, 2009).
//!
//! States are the lanes near a point. A whole track decides: lanes that lie side by side are told
//! apart by the sum over all points, and by which lanes continue in which. Where a lane is left
//! sideways the route begins a new leg.

use std::collections::HashMap;

use decouplegs_scene::{LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use super::RegisterOptions;
use crate::lane_index::{LaneIndex, LanePoint};
use crate::polyline::{Polyline, wrapped};

/// A point of a track, as lanes are chosen by it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Index of the point in the track.
    pub index: usize,
    /// World coordinates, meters.
    pub position: DVec2,
    /// The way it moves, radians.
    pub heading_rad: f64,
    /// Height of the road below, where the log tells.
    pub ground_z_m: Option<f64>,
}

/// Lanes that continue in one another, and the part of the track on them.
#[derive(Clone, Debug, PartialEq)]
pub struct Leg {
    /// Indices in [`LaneMap::lanes`], in driving order.
    pub lanes: Vec<usize>,
    /// Centerlines of the lanes as one line.
    pub line: Polyline,
    /// Positions and headings along the line, [`STEP_M`] apart.
    pub samples: Vec<(DVec2, f64)>,
    /// Waypoints on it, rising.
    pub waypoints: Vec<usize>,
    /// Arc length of each point along the line, meters; approximate, as lanes do not meet exactly.
    pub arcs_m: Vec<f64>,
    /// True if the lane was entered sideways: a lane change.
    pub by_lane_change: bool,
}

/// Distance of the samples of a leg's line, meters.
pub const STEP_M: f64 = 0.5;
/// Costs are squares of deviations: a meter off costs 1.
const OFF_COST_MAX: f64 = 9.0;
/// A heading across the lane.
const HEADING_COST: f64 = 10.0;
/// A meter by which way along lanes and way of the track differ.
const WAY_COST: f64 = 0.3;
/// A lane change, between lanes that the map calls neighbors, and between others side by side.
const LANE_CHANGE_COST: f64 = 12.0;
const UNLINKED_CHANGE_COST: f64 = 18.0;
/// A lane that follows no lane before it: links are missing, or the track was interrupted.
const JUMP_COST: f64 = 60.0;
/// Cost of forbidden steps; finite, so that a path is found where there is no other.
const FORBIDDEN_COST: f64 = 1e6;
/// Directions that differ by more are not along each other, radians.
const ALONG_RAD: f64 = 1.3;
/// Lanes of one way that may be passed between two waypoints.
const HOPS_MAX: usize = 6;
/// Lanes that are examined for one waypoint.
const LANES_MAX: usize = 16;
/// Largest distance of neighboring lanes, meters.
const NEIGHBOR_MAX_M: f64 = 6.0;

/// True if tracks of `class` may be on lanes of `kind`.
#[must_use]
pub fn may_use(class: &str, kind: LaneKind) -> bool {
    match class {
        "pedestrian" | "person" => kind == LaneKind::Walking,
        "bicycle" | "cyclist" => matches!(kind, LaneKind::Bicycle | LaneKind::Driving),
        _ => matches!(kind, LaneKind::Driving | LaneKind::Parking),
    }
}

struct State {
    at: LanePoint,
    cost: f64,
    /// The state of the waypoint before that the cheapest way came from.
    from: usize,
    step: Step,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    /// Lanes of the way on: the same lane alone, or these and then another.
    On(Vec<usize>),
    LaneChange,
    Jump,
}

/// The legs of the cheapest way along `waypoints`, those left out that have no lane for `class`
/// within [`RegisterOptions::radius_m`]. Lanes are changed sideways only where `lane_changes`
/// allows it.
///
/// # Errors
/// A sentence: no lane near, or the track drives against its lanes.
pub fn find(
    map: &LaneMap,
    index: &LaneIndex,
    waypoints: &[Waypoint],
    class: &str,
    lane_changes: bool,
    options: &RegisterOptions,
) -> Result<Vec<Leg>, String> {
    let near: Vec<Vec<LanePoint>> = waypoints
        .iter()
        .map(|waypoint| lanes_at(map, index, waypoint, class, options))
        .collect();
    let along: Vec<Vec<LanePoint>> = near
        .iter()
        .zip(waypoints)
        .map(|(near, waypoint)| along_only(near, waypoint))
        .collect();
    let matched = along.iter().filter(|lanes| !lanes.is_empty()).count();
    if 2 * matched < waypoints.len().max(1) {
        let against = near
            .iter()
            .zip(&along)
            .filter(|(near, along)| along.is_empty() && !near.is_empty())
            .count();
        if 2 * against >= waypoints.len() {
            return Err(format!(
                "drives against its lanes at {against} of {} positions",
                waypoints.len()
            ));
        }
        let radius_m = options.radius_m;
        return Err(format!(
            "no lane for class {class:?} within {radius_m} m at {} of {} positions",
            waypoints.len() - matched,
            waypoints.len()
        ));
    }
    let kept: Vec<usize> = (0..waypoints.len())
        .filter(|&at| !along[at].is_empty())
        .collect();
    let columns = Search {
        map,
        index,
        lane_changes,
    }
    .cheapest_ways(waypoints, &kept, along);
    legs(index, &kept, &columns)
}

fn lanes_at(
    map: &LaneMap,
    index: &LaneIndex,
    waypoint: &Waypoint,
    class: &str,
    options: &RegisterOptions,
) -> Vec<LanePoint> {
    let mut near = index.lanes_near(waypoint.position, options.radius_m);
    near.retain(|point| may_use(class, map.lanes[point.lane].kind));
    if let Some(z_m) = waypoint.ground_z_m {
        let on_deck = |point: &LanePoint| {
            !map.lanes[point.lane].has_height || (point.foot.point.z - z_m).abs() < options.deck_m
        };
        if near.iter().any(on_deck) {
            near.retain(on_deck);
        }
    }
    near
}

fn along_only(near: &[LanePoint], waypoint: &Waypoint) -> Vec<LanePoint> {
    let along = |point: &&LanePoint| {
        wrapped(point.foot.heading_rad - waypoint.heading_rad).abs() < ALONG_RAD
    };
    near.iter().filter(along).take(LANES_MAX).copied().collect()
}

fn place_cost(at: &LanePoint, waypoint: &Waypoint) -> f64 {
    let turned = wrapped(at.foot.heading_rad - waypoint.heading_rad);
    (at.foot.distance_m * at.foot.distance_m).min(OFF_COST_MAX)
        + HEADING_COST * (1.0 - turned.cos())
}

/// Search space of routes.
struct Search<'a> {
    map: &'a LaneMap,
    index: &'a LaneIndex,
    lane_changes: bool,
}

/// Lanes ahead of a lane: the meters from its start to theirs, and the lanes passed on the way,
/// themselves the last.
type Ahead = HashMap<usize, (f64, Vec<usize>)>;

impl Search<'_> {
    /// For each kept waypoint its lanes, each with the cheapest way to it.
    fn cheapest_ways(
        &self,
        waypoints: &[Waypoint],
        kept: &[usize],
        mut along: Vec<Vec<LanePoint>>,
    ) -> Vec<Vec<State>> {
        let mut columns: Vec<Vec<State>> = Vec::with_capacity(kept.len());
        for (order, &at) in kept.iter().enumerate() {
            let lanes = std::mem::take(&mut along[at]);
            let waypoint = &waypoints[at];
            let first = |lane: LanePoint| State {
                cost: place_cost(&lane, waypoint),
                at: lane,
                from: 0,
                step: Step::Jump,
            };
            let Some(before) = columns.last() else {
                columns.push(lanes.into_iter().map(first).collect());
                continue;
            };
            let traveled_m = waypoint
                .position
                .distance(waypoints[kept[order - 1]].position);
            let ahead: Vec<Ahead> = before
                .iter()
                .map(|state| self.ways_ahead(state.at.lane, traveled_m))
                .collect();
            let state_at = |lane: LanePoint| {
                let steps = before
                    .iter()
                    .zip(&ahead)
                    .enumerate()
                    .map(|(from, (state, ahead))| {
                        let (cost, step) = self.step_between(&state.at, &lane, ahead, traveled_m);
                        (state.cost + cost, from, step)
                    });
                let (cost, from, step) =
                    steps
                        .min_by(|a, b| a.0.total_cmp(&b.0))
                        .unwrap_or((0.0, 0, Step::Jump));
                State {
                    cost: cost + place_cost(&lane, waypoint),
                    at: lane,
                    from,
                    step,
                }
            };
            let column = lanes.into_iter().map(state_at).collect();
            columns.push(column);
        }
        columns
    }

    fn ways_ahead(&self, lane: usize, traveled_m: f64) -> Ahead {
        let mut ahead = Ahead::new();
        let own_m = self.index.line(lane).map_or(0.0, Polyline::length_m);
        let mut open = vec![(lane, own_m, Vec::new())];
        for _ in 0..HOPS_MAX {
            let mut further = Vec::new();
            for (lane, way_m, passed) in open {
                for &next in &self.map.lanes[lane].successors {
                    let Some(line) = self.index.line(next) else {
                        continue;
                    };
                    if ahead.get(&next).is_some_and(|known| known.0 <= way_m) {
                        continue;
                    }
                    let passed: Vec<usize> = passed.iter().copied().chain([next]).collect();
                    ahead.insert(next, (way_m, passed.clone()));
                    if way_m - own_m + line.length_m() < 2.0 * traveled_m + 10.0 {
                        further.push((next, way_m + line.length_m(), passed));
                    }
                }
            }
            open = further;
        }
        ahead
    }

    /// The cheapest step from a position on a lane to one at the next waypoint.
    fn step_between(
        &self,
        from: &LanePoint,
        to: &LanePoint,
        ahead: &Ahead,
        traveled_m: f64,
    ) -> (f64, Step) {
        let way_cost = |way_m: f64| WAY_COST * (way_m - traveled_m).abs();
        let mut steps = vec![];
        if from.lane == to.lane {
            steps.push((
                way_cost(to.foot.arc_m - from.foot.arc_m),
                Step::On(Vec::new()),
            ));
        }
        if let Some((way_m, passed)) = ahead.get(&to.lane) {
            steps.push((
                way_cost(way_m - from.foot.arc_m + to.foot.arc_m),
                Step::On(passed.clone()),
            ));
        }
        if from.lane != to.lane {
            let beside = |lane: usize| {
                let lane = &self.map.lanes[lane];
                [lane.left_neighbor, lane.right_neighbor].contains(&Some(to.lane))
            };
            let linked = beside(from.lane)
                || self.map.lanes[from.lane]
                    .successors
                    .iter()
                    .copied()
                    .any(beside);
            let apart_m = (to.foot.point - from.foot.point).truncate().length();
            let same_way = wrapped(to.foot.heading_rad - from.foot.heading_rad).abs() < 0.5;
            let sideways = linked || (same_way && apart_m < traveled_m + NEIGHBOR_MAX_M);
            let sideways_cost = if linked {
                LANE_CHANGE_COST
            } else {
                UNLINKED_CHANGE_COST
            };
            match (sideways, self.lane_changes) {
                (true, true) => steps.push((sideways_cost, Step::LaneChange)),
                (true, false) => {}
                (false, _) => steps.push((JUMP_COST, Step::Jump)),
            }
        } else if traveled_m > 0.0 {
            steps.push((JUMP_COST, Step::Jump));
        }
        steps
            .into_iter()
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((FORBIDDEN_COST, Step::Jump))
    }
}

fn legs(index: &LaneIndex, kept: &[usize], columns: &[Vec<State>]) -> Result<Vec<Leg>, String> {
    let mut states: Vec<&State> = Vec::with_capacity(columns.len());
    let last = columns.last().and_then(|column| {
        column
            .iter()
            .enumerate()
            .min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))
    });
    let mut at = last.ok_or("no waypoints")?.0;
    for column in columns.iter().rev() {
        states.push(&column[at]);
        at = column[at].from;
    }
    states.reverse();
    let mut parts: Vec<Part> = Vec::new();
    for (order, state) in states.iter().enumerate() {
        let length_of = |lane: &usize| index.line(*lane).map_or(0.0, Polyline::length_m);
        match (&state.step, parts.last_mut()) {
            (Step::On(passed), Some(part)) => {
                for &lane in passed {
                    part.before_m += part.lanes.last().map_or(0.0, length_of);
                    part.lanes.push(lane);
                }
                part.waypoints.push(kept[order]);
                part.arcs_m.push(part.before_m + state.at.foot.arc_m);
            }
            (step, _) => parts.push(Part {
                lanes: vec![state.at.lane],
                before_m: 0.0,
                waypoints: vec![kept[order]],
                arcs_m: vec![state.at.foot.arc_m],
                by_lane_change: order > 0 && *step == Step::LaneChange,
            }),
        }
    }
    let leg = |Part {
                   lanes,
                   waypoints,
                   arcs_m,
                   by_lane_change,
                   ..
               }: Part| {
        let line = joined(index, &lanes).ok_or("the lanes' centerlines make no line")?;
        let steps = (line.length_m() / STEP_M).floor() as usize + 1;
        let sample = |step: usize| {
            let arc_m = STEP_M * step as f64;
            (line.at(arc_m).truncate(), line.heading_at(arc_m))
        };
        Ok(Leg {
            lanes,
            samples: (0..steps).map(sample).collect(),
            line,
            waypoints,
            arcs_m,
            by_lane_change,
        })
    };
    parts.into_iter().map(leg).collect()
}

/// A leg that grows.
struct Part {
    lanes: Vec<usize>,
    /// Length of its lanes but the last.
    before_m: f64,
    waypoints: Vec<usize>,
    arcs_m: Vec<f64>,
    by_lane_change: bool,
}

/// The centerlines of `lanes` as one line. Where a lane begins a little before the end of the one
/// before, the line would turn back: points that near to the one before are left out.
fn joined(index: &LaneIndex, lanes: &[usize]) -> Option<Polyline> {
    const SEAM_M: f64 = 0.3;
    let mut points: Vec<DVec3> = Vec::new();
    for line in lanes.iter().filter_map(|&lane| index.line(lane)) {
        let seam = points.last().map(|point| point.truncate());
        points.extend(line.points().iter().enumerate().filter_map(|(at, point)| {
            let near = at == 0 && seam.is_some_and(|seam| seam.distance(point.truncate()) < SEAM_M);
            (!near).then_some(*point)
        }));
    }
    Polyline::new(points)
}
