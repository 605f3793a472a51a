//! Junctions, crossings and edges of lanes: what rules of the road ask of a position.

use decouplegs_scene::episode::{LaneOffset, RoadRecord};
use decouplegs_scene::{LaneKind, LaneMap, VehicleState};
use glam::{DVec2, DVec3};

use crate::lane_index::{LaneIndex, LanePoint};
use crate::polyline::Polyline;
use crate::road_graph::{Conflict, RoadGraph, RoadLane};
use crate::road_surface::HALF_WIDTH_M;

/// Distance from all centerlines beyond which the ego is on no lane, meters.
const LANE_M_MAX: f64 = 6.0;
/// Lanes within this angle of the ego's heading are in its direction, as cosines: to be beside one,
/// and to be on one.
const BESIDE_COS: f64 = 0.5;
const ON_COS: f64 = 0.7;
/// Least angle at which lanes cross, as a sine: about 20 degrees. Others merge, or lie upon each
/// other.
const CROSSING_SIN: f64 = 0.35;
/// Way of a vehicle's end into a lane that crosses up to which it does not count as in its way,
/// meters: stop lines of maps are not that exact.
const INTO_M: f64 = 1.5;
/// Distance between positions of a crosswalk that are examined, meters.
const CROSSWALK_STRIDE_M: f64 = 1.0;
/// Half of a crosswalk's width, meters.
const CROSSWALK_M: f64 = 2.0;
/// A position is beyond the end of a lane, and not beside it, where its distance is larger than
/// its offset by this, meters.
const BEYOND_M: f64 = 0.05;

/// Greatest length of a lane that is a connection within a junction as a whole, meters, and the
/// least share of it that has to be in the way of others.
const CONNECTION_M: f64 = 60.0;
const CONNECTION_SHARE: f64 = 0.2;

/// Stretch of a lane, meters along it.
type Stretch = [f64; 2];

/// Parts of one lane.
#[derive(Clone, Debug, Default)]
struct LaneParts {
    is_driving: bool,
    /// Stretch within a junction.
    junction: Option<Stretch>,
    /// Stretches on which a vehicle's middle is in the way of what crosses.
    crossings: Vec<Stretch>,
    left: Option<Polyline>,
    right: Option<Polyline>,
    /// Lanes that it continues in.
    onward: Vec<usize>,
    /// Lanes beside it with the same direction.
    beside: [Option<usize>; 2],
}

/// Parts of the lanes of a map.
///
/// A lane is part of a junction where another crosses it, or crosses one that starts from the same
/// lane or is in its way: all of a connection, otherwise from the first to the last lane that is in
/// its way. Lanes that only merge make no junction.
#[derive(Clone, Debug)]
pub struct RoadParts {
    index: LaneIndex,
    lanes: Vec<LaneParts>,
}

impl RoadParts {
    /// Parts of the lanes of `map`, whose graph is `graph`.
    #[must_use]
    pub fn new(map: &LaneMap, graph: &RoadGraph) -> Self {
        let line = |points: &[DVec3]| Polyline::new(points.iter().copied());
        let mut lanes: Vec<LaneParts> = map
            .lanes
            .iter()
            .map(|lane| LaneParts {
                is_driving: lane.kind == LaneKind::Driving,
                left: line(&lane.left),
                right: line(&lane.right),
                onward: lane.successors.clone(),
                beside: [lane.left_neighbor, lane.right_neighbor],
                ..LaneParts::default()
            })
            .collect();
        for (from, lane) in map.lanes.iter().enumerate() {
            for &before in &lane.predecessors {
                if !lanes[before].onward.contains(&from) {
                    lanes[before].onward.push(from);
                }
            }
        }
        let half_length_m = 0.5 * graph.vehicle().length_m;
        for (at, parts) in lanes.iter_mut().enumerate() {
            let Some(road) = graph.lane(at) else {
                continue;
            };
            let crossing = road.conflicts.iter().filter(|&one| crosses(graph, at, one));
            let shorter = |one: &Conflict| [one.from_m + INTO_M, one.to_m - INTO_M];
            parts.crossings = crossing.map(shorter).filter(|[a, b]| a < b).collect();
            let is_crossed =
                |lane: usize| conflicts(graph, lane).any(|one| crosses(graph, lane, one));
            let before = road.predecessors.iter().filter_map(|&one| graph.lane(one));
            let siblings = before.flat_map(|lane| &lane.successors);
            let in_way = road.conflicts.iter().map(|one| &one.other);
            if siblings.chain(in_way).any(|&lane| is_crossed(lane)) {
                parts.junction = junction_of(road);
            }
        }
        let mut found = Self {
            index: LaneIndex::new(map),
            lanes,
        };
        found.add_crosswalks(map, half_length_m);
        found
    }

    /// Adds the stretches of driving lanes on which a vehicle stands on a crosswalk.
    fn add_crosswalks(&mut self, map: &LaneMap, half_length_m: f64) {
        let walks = map
            .lanes
            .iter()
            .filter(|lane| lane.kind == LaneKind::Walking);
        let stretch_m = CROSSWALK_M + half_length_m - INTO_M;
        for walk in walks.filter_map(|lane| Polyline::new(lane.centerline.iter().copied())) {
            let count = (walk.length_m() / CROSSWALK_STRIDE_M)
                .ceil()
                .clamp(1.0, 1e4) as usize;
            for step in 0..=count {
                let at = walk.at(walk.length_m() * step as f64 / count as f64);
                for point in self.index.lanes_near(at.truncate(), CROSSWALK_STRIDE_M) {
                    let lane = &mut self.lanes[point.lane];
                    let across = walk.heading_at(walk.length_m() * step as f64 / count as f64)
                        - point.foot.heading_rad;
                    if lane.is_driving && across.sin().abs() > CROSSING_SIN {
                        let arc_m = point.foot.arc_m;
                        lane.crossings.push([arc_m - stretch_m, arc_m + stretch_m]);
                    }
                }
            }
        }
    }

    /// Position of a vehicle on the road. Nothing is known of its turns.
    #[must_use]
    pub fn record(&self, state: &VehicleState) -> RoadRecord {
        let near = self.near(state.position_m);
        let below = || near.iter().filter(is_on);
        let is_within = |stretch: &Stretch, arc_m: f64| (stretch[0]..=stretch[1]).contains(&arc_m);
        let in_junction = below().any(|point| {
            let junction = self.lanes[point.lane].junction;
            junction.is_some_and(|stretch| is_within(&stretch, point.foot.arc_m))
        });
        let on_crossing = below().any(|point| {
            let mut stretches = self.lanes[point.lane].crossings.iter();
            stretches.any(|stretch| is_within(stretch, point.foot.arc_m))
        });
        let lane = near
            .iter()
            .find(|point| cos_to(state, point) > BESIDE_COS)
            .map(|point| self.offset(point));
        RoadRecord {
            in_junction,
            on_crossing,
            wrong_turn: false,
            lane,
        }
    }

    /// Lanes that a vehicle is on, in its direction, with the places on them.
    pub(crate) fn lanes_on(&self, state: &VehicleState) -> Vec<(usize, f64)> {
        let near = self.near(state.position_m);
        let on = near.iter().filter(is_on);
        let ahead = on.filter(|point| cos_to(state, point) > ON_COS);
        ahead.map(|point| (point.lane, point.foot.arc_m)).collect()
    }

    /// Length of a lane, meters.
    pub(crate) fn length_m(&self, lane: usize) -> f64 {
        self.index.line(lane).map_or(0.0, Polyline::length_m)
    }

    /// Lanes that a lane continues in.
    pub(crate) fn onward(&self, lane: usize) -> &[usize] {
        &self.lanes[lane].onward
    }

    /// Lanes beside a lane with the same direction.
    pub(crate) fn beside(&self, lane: usize) -> impl Iterator<Item = usize> {
        self.lanes[lane].beside.into_iter().flatten()
    }

    /// Driving lanes near a position, the nearest first.
    fn near(&self, at: DVec2) -> Vec<LanePoint> {
        let mut near = self.index.lanes_near(at, LANE_M_MAX);
        near.retain(|point| self.lanes[point.lane].is_driving);
        near
    }

    fn offset(&self, point: &LanePoint) -> LaneOffset {
        let (lane, foot) = (&self.lanes[point.lane], &point.foot);
        let edge = match foot.lateral_m >= 0.0 {
            true => &lane.left,
            false => &lane.right,
        };
        let apart_m = |edge: &Polyline| edge.project(foot.point.truncate()).distance_m;
        LaneOffset {
            lateral_m: foot.lateral_m,
            half_width_m: edge.as_ref().map_or(HALF_WIDTH_M, apart_m),
        }
    }
}

/// Stretch of a lane within a junction: all of a short one, otherwise from the first to the last
/// lane that is in its way.
fn junction_of(road: &RoadLane) -> Option<Stretch> {
    let ends = road.conflicts.iter().map(|one| [one.from_m, one.to_m]);
    let [from_m, to_m] = ends.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
    let length_m = road.line.length_m();
    let is_connection = length_m <= CONNECTION_M && to_m - from_m >= CONNECTION_SHARE * length_m;
    Some(if is_connection {
        [0.0, length_m]
    } else {
        [from_m, to_m]
    })
}

/// Conflicts of a lane; none where vehicles do not drive on it.
fn conflicts(graph: &RoadGraph, lane: usize) -> impl Iterator<Item = &Conflict> {
    graph
        .lane(lane)
        .into_iter()
        .flat_map(|lane| &lane.conflicts)
}

/// True if the two lanes of a conflict of `lane` cross each other.
fn crosses(graph: &RoadGraph, lane: usize, conflict: &Conflict) -> bool {
    let (Some(own), Some(other)) = (graph.lane(lane), graph.lane(conflict.other)) else {
        return false;
    };
    let shares = |a: &[usize], b: &[usize]| a.iter().any(|one| b.contains(one));
    let merges = shares(&own.successors, &other.successors)
        || shares(&own.predecessors, &other.predecessors)
        || own.successors.contains(&conflict.other)
        || other.successors.contains(&lane);
    let own_rad = own.line.heading_at(0.5 * (conflict.from_m + conflict.to_m));
    let other_m = 0.5 * (conflict.other_from_m + conflict.other_to_m);
    let across = (other.line.heading_at(other_m) - own_rad).sin();
    !merges && across.abs() > CROSSING_SIN
}

/// True for a lane that a position is on, and not beyond its ends.
fn is_on(point: &&LanePoint) -> bool {
    let foot = &point.foot;
    foot.distance_m <= HALF_WIDTH_M && foot.distance_m - foot.lateral_m.abs() < BEYOND_M
}

/// Cosine of the angle between a vehicle and a lane.
fn cos_to(state: &VehicleState, point: &LanePoint) -> f64 {
    (state.yaw_rad - point.foot.heading_rad).cos()
}
