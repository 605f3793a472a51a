//! Road layout for placement: free positions, crossings, and lanes ahead.

use std::collections::HashSet;
use std::sync::Arc;

use decouplegs_scene::{LaneMap, VehicleSize, VehicleState};
use glam::DVec2;

use super::random::Stream;
use crate::lane_index::LaneIndex;
use crate::oriented_box::OrientedBox;
use crate::polyline::Polyline;
use crate::road_graph::{RoadGraph, position_on};
use crate::road_surface::RoadSurface;
use crate::route::Route;
use crate::view_support::ViewSupport;

/// Distance between places along a route that are examined, meters.
const STRIDE_M: f64 = 0.5;
/// Left free between a vehicle and the border of its lane, meters.
const BORDER_M: f64 = 0.1;
/// Left free between a vehicle and a stretch on which others may be in the way, meters.
const STRETCH_MARGIN_M: f64 = 0.5;
/// A lane that goes on for less than this is no place to start, meters.
const ONWARD_M_MIN: f64 = 25.0;
/// Lanes that are followed when looking ahead: more are near one place only where a map is broken.
const LANES_AHEAD_MAX: usize = 400;
/// Largest number of lanes that one vehicle occupies, or that a search visits.
const LANES_UNDER_MAX: usize = 64;

/// A place on a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spot {
    /// Place in [`LaneMap::lanes`].
    pub lane: usize,
    /// Position along the lane, meters.
    pub at_m: f64,
}

/// A lane that can be reached, and how far ahead its start is: below zero where it is the own one.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaneAhead {
    pub lane: usize,
    pub begin_m: f64,
}

/// A map, made ready to be peopled.
pub(super) struct Roads<'a> {
    pub map: &'a LaneMap,
    pub graph: Arc<RoadGraph>,
    pub index: LaneIndex,
    pub surface: RoadSurface,
    /// Left and right border of each lane, where the map knows them.
    borders: Vec<[Option<Polyline>; 2]>,
    /// Stretches of each lane, from and to, on which vehicles of other lanes may be in the way.
    shared: Vec<Vec<(f64, f64)>>,
    /// Starts of stretches on each lane where another lane has priority.
    yields: Vec<Vec<f64>>,
    /// Stop lines of traffic lights on each lane.
    light_lines: Vec<Vec<f64>>,
    /// First positions at which a lane meets others, in the order of the lanes: the crossings.
    pub crossings: Vec<Spot>,
    /// True if lanes lie beside each other anywhere.
    pub has_lanes_beside: bool,
    /// Driving lanes, and how many meters of them there are up to the end of each.
    cumulative_m: Vec<(usize, f64)>,
    /// Views that the place was seen from, and the places on lanes that they support, about a
    /// meter apart. `None`: all of it may be driven in.
    seen: Option<(Arc<ViewSupport>, Vec<Spot>)>,
}

impl<'a> Roads<'a> {
    /// The roads of `map` for vehicles up to `largest`.
    pub fn new(map: &'a LaneMap, largest: VehicleSize) -> Result<Self, String> {
        let graph = Arc::new(RoadGraph::new(map)?.for_vehicle(largest)?);
        let count = map.lanes.len();
        let (mut shared, mut yields) = (vec![Vec::new(); count], vec![Vec::new(); count]);
        let (mut crossings, mut cumulative_m, mut total_m) = (Vec::new(), Vec::new(), 0.0);
        for at in 0..count {
            let Some(lane) = graph.lane(at) else { continue };
            total_m += lane.line.length_m();
            cumulative_m.push((at, total_m));
            for conflict in &lane.conflicts {
                shared[at].push((conflict.from_m, conflict.to_m));
                if !conflict.goes_first {
                    yields[at].push(conflict.from_m);
                }
            }
            for fork in &lane.forks {
                shared[at].push((0.0, fork.to_m));
            }
            let first_m = lane
                .conflicts
                .iter()
                .map(|conflict| conflict.from_m)
                .fold(f64::INFINITY, f64::min);
            if first_m.is_finite() {
                crossings.push(Spot {
                    lane: at,
                    at_m: first_m,
                });
            }
        }
        let mut light_lines = vec![Vec::new(); count];
        for line in map.lights.iter().flat_map(|light| &light.stop_lines) {
            if let Some(lane) = graph.find(&line.lane) {
                light_lines[lane].push(line.at_m);
            }
        }
        let line = |points: &[glam::DVec3]| Polyline::new(points.iter().copied());
        let borders = map
            .lanes
            .iter()
            .map(|lane| [line(&lane.left), line(&lane.right)])
            .collect();
        let has_lanes_beside = graph
            .lanes()
            .iter()
            .flatten()
            .any(|lane| lane.left.or(lane.right).is_some());
        Ok(Self {
            index: LaneIndex::new(map),
            surface: RoadSurface::new(map),
            map,
            graph,
            borders,
            shared,
            yields,
            light_lines,
            crossings,
            has_lanes_beside,
            cumulative_m,
            seen: None,
        })
    }

    /// Limits starts and routes to where the place was seen from.
    pub fn limit_to(&mut self, support: Arc<ViewSupport>) {
        let mut spots = Vec::new();
        for &(lane, _) in &self.cumulative_m {
            let meters = self.length_m(lane).floor() as u32;
            let along = (0..=meters).map(|at_m| Spot {
                lane,
                at_m: f64::from(at_m),
            });
            let is_seen = |spot: &Spot| {
                let place = position_on(self.graph.lanes(), &[lane], 0, spot.at_m);
                support.holds(place.position_m, place.yaw_rad)
            };
            spots.extend(along.filter(is_seen));
        }
        let seen_lanes: HashSet<usize> = spots.iter().map(|spot| spot.lane).collect();
        self.crossings
            .retain(|spot| seen_lanes.contains(&spot.lane));
        self.seen = Some((support, spots));
    }

    /// Support of the views that routes are limited to.
    pub fn support(&self) -> Option<Arc<ViewSupport>> {
        Some(self.seen.as_ref()?.0.clone())
    }

    /// True if routes stay where the place was seen from.
    pub fn is_limited(&self) -> bool {
        self.seen.is_some()
    }

    /// Distance along `route` up to which it leads where the place was seen from, meters; infinite
    /// where it may be driven in everywhere.
    pub fn seen_m(&self, route: &Route) -> f64 {
        match &self.seen {
            None => f64::INFINITY,
            Some((support, _)) => support.along_m(route),
        }
    }

    /// Forgets the traffic lights of the map.
    pub fn ignore_lights(&mut self) {
        self.light_lines.iter_mut().for_each(Vec::clear);
    }

    /// True if a vehicle of `size` that follows `route` stays on the road: lanes may taper off, and
    /// maps have gaps.
    pub fn hold(&self, route: &Route, size: &VehicleSize) -> bool {
        let count = (route.length_m() / STRIDE_M).ceil() as usize;
        (0..=count).all(|at| {
            let (position, yaw_rad) = route.pose_at(at as f64 * STRIDE_M);
            let state = VehicleState {
                position_m: position.truncate(),
                yaw_rad,
                speed_mps: 0.0,
                acceleration_mps2: 0.0,
            };
            let outline = OrientedBox::for_vehicle(&state, size);
            self.surface.holds_box(&outline, RoadSurface::SLACK_M)
        })
    }

    /// A place on any driving lane, all meters alike.
    pub fn anywhere(&self, random: &mut Stream) -> Option<Spot> {
        if let Some((_, spots)) = &self.seen {
            let spot = *random.pick(spots)?;
            let at_m = (spot.at_m + random.between((0.0, 1.0))).min(self.length_m(spot.lane));
            return Some(Spot { at_m, ..spot });
        }
        let total_m = self.cumulative_m.last()?.1;
        let drawn_m = random.between((0.0, total_m));
        let at = self
            .cumulative_m
            .partition_point(|&(_, end_m)| end_m <= drawn_m)
            .min(self.cumulative_m.len() - 1);
        let begin_m = at
            .checked_sub(1)
            .map_or(0.0, |before| self.cumulative_m[before].1);
        Some(Spot {
            lane: self.cumulative_m[at].0,
            at_m: drawn_m - begin_m,
        })
    }

    pub fn length_m(&self, lane: usize) -> f64 {
        self.graph
            .lane(lane)
            .map_or(0.0, |lane| lane.line.length_m())
    }

    pub fn speed_limit_mps(&self, lane: usize) -> f64 {
        self.graph
            .lane(lane)
            .map_or(0.0, |lane| lane.speed_limit_mps)
    }

    pub fn position_m(&self, spot: Spot) -> DVec2 {
        position_on(self.graph.lanes(), &[spot.lane], 0, spot.at_m).position_m
    }

    /// The outline of a vehicle of `size` at `spot`.
    pub fn outline(&self, spot: Spot, size: &VehicleSize) -> OrientedBox {
        let position = position_on(self.graph.lanes(), &[spot.lane], 0, spot.at_m);
        OrientedBox::for_vehicle(
            &VehicleState {
                position_m: position.position_m,
                yaw_rad: position.yaw_rad,
                ..VehicleState::default()
            },
            size,
        )
    }

    /// True if a vehicle of `size` may start at `spot` as far as the road is concerned: its lane is
    /// wide enough and continues, and no part of the vehicle is on a stretch that others may cross.
    pub fn has_room(&self, spot: Spot, size: &VehicleSize) -> bool {
        let Some(lane) = self.graph.lane(spot.lane) else {
            return false;
        };
        let half_m = 0.5 * size.length_m;
        let on_lane = (0.0..=lane.line.length_m()).contains(&spot.at_m)
            && lane.onward_m - spot.at_m >= ONWARD_M_MIN;
        on_lane
            && self.is_free(spot.lane, spot.at_m - half_m, spot.at_m + half_m)
            && self.is_wide(spot, size)
    }

    /// True if no other lane conflicts with `lane` between two positions. A stretch before its
    /// start or beyond its end must be free on all lanes there. False where none are.
    fn is_free(&self, lane: usize, from_m: f64, to_m: f64) -> bool {
        let (mut open, mut looked_at) = (vec![(lane, from_m, to_m, 0_i32)], 0);
        while let Some((lane, from_m, to_m, way)) = open.pop() {
            looked_at += 1;
            let Some(road) = self
                .graph
                .lane(lane)
                .filter(|_| looked_at < LANES_UNDER_MAX)
            else {
                return false;
            };
            let length_m = road.line.length_m();
            let (low_m, high_m) = (from_m - STRETCH_MARGIN_M, to_m + STRETCH_MARGIN_M);
            let (before, after) = (way <= 0 && from_m < 0.0, way >= 0 && to_m > length_m);
            if self.shared[lane]
                .iter()
                .any(|&(begin_m, end_m)| begin_m <= high_m && low_m <= end_m)
                || (before && road.predecessors.is_empty())
                || (after && road.successors.is_empty())
            {
                return false;
            }
            if before {
                open.extend(
                    road.predecessors
                        .iter()
                        .map(|&lane| (lane, self.length_m(lane) + from_m, self.length_m(lane), -1)),
                );
            }
            if after {
                open.extend(
                    road.successors
                        .iter()
                        .map(|&lane| (lane, 0.0, to_m - length_m, 1)),
                );
            }
        }
        true
    }

    /// The same place on the lane that it is on, where it is before the start of its lane or beyond
    /// its end: on those that bend least.
    pub fn on_its_lane(&self, mut spot: Spot) -> Option<Spot> {
        let turn = |lane: &&usize| {
            self.graph
                .lane(**lane)
                .map_or(0.0, |lane| lane.turn_rad.abs())
        };
        for _ in 0..LANES_UNDER_MAX {
            let (road, length_m) = (self.graph.lane(spot.lane)?, self.length_m(spot.lane));
            if spot.at_m < 0.0 {
                let before = *road
                    .predecessors
                    .iter()
                    .min_by(|a, b| turn(a).total_cmp(&turn(b)))?;
                spot = Spot {
                    lane: before,
                    at_m: spot.at_m + self.length_m(before),
                };
            } else if spot.at_m > length_m {
                let after = *road
                    .successors
                    .iter()
                    .min_by(|a, b| turn(a).total_cmp(&turn(b)))?;
                spot = Spot {
                    lane: after,
                    at_m: spot.at_m - length_m,
                };
            } else {
                return Some(spot);
            }
        }
        None
    }

    /// Distance from the middle of one vehicle to that of another ahead of it, meters along the
    /// lanes; none within `max_m`.
    pub fn between_m(&self, behind: Spot, front: Spot, max_m: f64) -> Option<f64> {
        let apart =
            |ahead: LaneAhead| (ahead.lane == front.lane).then_some(ahead.begin_m + front.at_m);
        let ahead = self.ahead(behind, max_m).into_iter().filter_map(apart);
        ahead
            .filter(|apart_m| (0.0..=max_m).contains(apart_m))
            .min_by(f64::total_cmp)
    }

    /// True if both borders are beyond a vehicle's sides, at its middle, front and rear.
    fn is_wide(&self, spot: Spot, size: &VehicleSize) -> bool {
        let least_m = 0.5 * size.width_m + BORDER_M;
        let beyond = |border: &Option<Polyline>, at_m: f64| {
            let position_m = self.position_m(Spot { at_m, ..spot });
            border
                .as_ref()
                .is_none_or(|border| border.project(position_m).distance_m >= least_m)
        };
        let half_m = 0.5 * size.length_m;
        let places = [
            spot.at_m,
            (spot.at_m - half_m).max(0.0),
            (spot.at_m + half_m).min(self.length_m(spot.lane)),
        ];
        self.borders[spot.lane]
            .iter()
            .all(|border| places.iter().all(|&at_m| beyond(border, at_m)))
    }

    /// Lanes that a vehicle at `spot` may come to within `max_m`, its own first. A lane that
    /// several ways lead to is named once, by the shortest.
    pub fn ahead(&self, spot: Spot, max_m: f64) -> Vec<LaneAhead> {
        let mut found = vec![LaneAhead {
            lane: spot.lane,
            begin_m: -spot.at_m,
        }];
        let mut next = 0;
        while let Some(&LaneAhead { lane, begin_m }) = found.get(next) {
            next += 1;
            let end_m = begin_m + self.length_m(lane);
            let Some(road) = self.graph.lane(lane).filter(|_| end_m <= max_m) else {
                continue;
            };
            for &successor in &road.successors {
                // The own lane comes again on a circle, farther ahead.
                let known = found
                    .iter()
                    .position(|ahead| ahead.lane == successor && ahead.begin_m >= 0.0);
                match known {
                    Some(at) if found[at].begin_m <= end_m => {}
                    _ if found.len() >= LANES_AHEAD_MAX => break,
                    _ => found.push(LaneAhead {
                        lane: successor,
                        begin_m: end_m,
                    }),
                }
            }
        }
        found
    }

    /// Distance from `spot` to where a vehicle may have to stop for others, or where its lane ends,
    /// meters; infinite beyond `max_m`.
    pub fn until_stop_m(&self, spot: Spot, max_m: f64) -> f64 {
        let stops = |ahead: LaneAhead| {
            let dead_end = self
                .graph
                .lane(ahead.lane)
                .is_some_and(|lane| lane.successors.is_empty());
            let end_m = dead_end.then(|| self.length_m(ahead.lane));
            self.yields[ahead.lane]
                .iter()
                .chain(&self.light_lines[ahead.lane])
                .copied()
                .chain(end_m)
                .map(move |at_m| ahead.begin_m + at_m)
        };
        self.ahead(spot, max_m)
            .into_iter()
            .flat_map(stops)
            .filter(|&at_m| at_m >= 0.0)
            .fold(f64::INFINITY, f64::min)
    }

    /// Stop lines before the crossing that `lane` leads over, one per incoming lane.
    pub fn stop_lines(&self, lane: usize) -> Vec<Spot> {
        let others = |lane: usize| {
            let conflicts = self
                .graph
                .lane(lane)
                .map_or(&[][..], |lane| &lane.conflicts);
            conflicts.iter().map(|conflict| conflict.other)
        };
        let mut crossing: Vec<usize> = others(lane).chain([lane]).collect();
        crossing.extend(crossing.clone().into_iter().flat_map(others));
        crossing.sort_unstable();
        crossing.dedup();
        let mut lines = Vec::new();
        for &lane in &crossing {
            let Some(road) = self.graph.lane(lane) else {
                continue;
            };
            let before = road
                .predecessors
                .iter()
                .filter(|lane| crossing.binary_search(lane).is_err());
            lines.extend(before.map(|&lane| {
                Spot {
                    lane,
                    at_m: self.light_lines[lane]
                        .iter()
                        .copied()
                        .fold(self.length_m(lane), f64::min),
                }
            }));
            // A long lane has its crossing somewhere along it.
            let first_m = road
                .conflicts
                .iter()
                .map(|conflict| conflict.from_m)
                .fold(f64::INFINITY, f64::min);
            if first_m.is_finite() {
                lines.push(Spot {
                    lane,
                    at_m: first_m,
                });
            }
        }
        lines.sort_by(|a, b| a.lane.cmp(&b.lane).then(a.at_m.total_cmp(&b.at_m)));
        lines.dedup();
        lines
    }
}
