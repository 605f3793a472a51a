//! Lanes as actors follow them: of any kind, in either direction.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use crate::lane_index::LaneIndex;
use crate::polyline::{Foot, Polyline, wrapped};
use crate::route::{LaneSpot, lanes_between};

/// Distance from the middle of a lane within which an actor is on it, meters.
const ON_LANE_M: f64 = 2.5;
/// Distance across lanes within which places are compared along them, meters.
const ACROSS_M: f64 = 15.0;
/// Way along lanes within which places are compared, meters, and lanes at most.
const ALONG_M: f64 = 2000.0;
const LANES_MAX: usize = 1000;
/// Way before and after a place over which the turn of its lane is measured, meters.
const TURN_M: f64 = 2.0;
/// Distance between the middles of lanes that count as one place, meters, and way over which the
/// turns of such lanes are compared, meters.
const SAME_LINE_M: f64 = 0.02;
const AHEAD_M: f64 = 10.0;
/// Steps along the reference line of a road, meters, and most of them.
const ROAD_STEP_M: f64 = 2.0;
const ROAD_STEPS_MAX: f64 = 500.0;
/// A foot is beside its lane, not beyond its end, if it is off by no more, meters.
const BESIDE_M: f64 = 0.5;

/// Place on a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OnLane {
    pub lane: usize,
    /// Position along the lane, meters.
    pub at_m: f64,
    /// Offset to the left of the lane's direction, meters.
    pub left_m: f64,
    /// True if it goes against the direction of the lane.
    pub is_against: bool,
}

impl OnLane {
    /// 1 along the lane, -1 against it.
    pub(super) fn sign(&self) -> f64 {
        if self.is_against { -1.0 } else { 1.0 }
    }
}

/// Lanes of a map.
#[derive(Clone, Debug)]
pub(super) struct Roads {
    map: LaneMap,
    index: LaneIndex,
    /// Lanes beside each other, by what their ids have before their own number.
    sections: HashMap<String, Vec<usize>>,
    /// Left and right borders of the lanes beside a reference line, by lane.
    first_borders: Vec<Option<[Option<Polyline>; 2]>>,
}

/// Part of an id before its last `/`, and the number after it.
fn parts(id: &str) -> Option<(&str, i64)> {
    let (section, number) = id.rsplit_once('/')?;
    Some((section, number.parse().ok()?))
}

impl Roads {
    pub(super) fn new(map: &LaneMap) -> Self {
        let mut sections: HashMap<String, Vec<usize>> = HashMap::new();
        for (lane, listed) in map.lanes.iter().enumerate() {
            if let Some((section, _)) = parts(&listed.id) {
                sections.entry(section.to_owned()).or_default().push(lane);
            }
        }
        let line = |border: &[DVec3]| Polyline::new(border.iter().copied());
        let is_first = |lane: &&Lane| parts(&lane.id).is_some_and(|(_, id)| id.abs() == 1);
        let borders = |lane: &Lane| [line(&lane.left), line(&lane.right)];
        let lanes = map.lanes.iter();
        Self {
            map: map.clone(),
            index: LaneIndex::new(map),
            sections,
            first_borders: lanes
                .map(|lane| Some(lane).filter(is_first).map(borders))
                .collect(),
        }
    }

    pub(super) fn find(&self, id: &str) -> Option<usize> {
        let lane = self.map.lanes.iter().position(|lane| lane.id == id)?;
        self.index.line(lane).map(|_| lane)
    }

    pub(super) fn line(&self, lane: usize) -> Option<&Polyline> {
        self.index.line(lane)
    }

    fn length_m(&self, lane: usize) -> f64 {
        self.line(lane).map_or(0.0, Polyline::length_m)
    }

    /// Point and heading of a place.
    pub(super) fn pose(&self, place: &OnLane) -> (DVec2, f64) {
        let Some(line) = self.line(place.lane) else {
            return (DVec2::ZERO, 0.0);
        };
        let heading_rad = line.heading_at(place.at_m);
        let left = DVec2::from_angle(heading_rad).perp();
        let point_m = line.at(place.at_m).truncate() + place.left_m * left;
        let back_rad = if place.is_against {
            std::f64::consts::PI
        } else {
            0.0
        };
        (point_m, heading_rad + back_rad)
    }

    /// The place of a point on a lane, driving with `heading_rad`.
    pub(super) fn on(&self, lane: usize, point_m: DVec2, heading_rad: f64) -> Option<OnLane> {
        let foot = self.line(lane)?.project(point_m);
        Some(OnLane {
            lane,
            at_m: foot.arc_m,
            left_m: foot.lateral_m,
            is_against: wrapped(foot.heading_rad - heading_rad).abs() > std::f64::consts::FRAC_PI_2,
        })
    }

    /// The place of a point on the nearest lane: of those that lead its way if there is one, then
    /// of those where vehicles drive, then of those that begin at one place, as at a junction, the
    /// one that turns least. `None` off the road.
    pub(super) fn at(&self, point_m: DVec2, heading_rad: f64) -> Option<OnLane> {
        let near = self.index.lanes_near(point_m, ON_LANE_M);
        let rank = |lane: usize, foot_rad: f64| {
            let is_against = wrapped(foot_rad - heading_rad).abs() > std::f64::consts::FRAC_PI_2;
            let is_driven = self.map.lanes[lane].kind == LaneKind::Driving;
            (u8::from(is_against), u8::from(!is_driven))
        };
        let turn_rad = |lane: usize, foot: &Foot| {
            let is_against = rank(lane, foot.heading_rad).0 == 1;
            let (ahead_m, back_rad) = match is_against {
                true => (-AHEAD_M, std::f64::consts::PI),
                false => (AHEAD_M, 0.0),
            };
            self.line(lane).map_or(f64::INFINITY, |line| {
                let later_rad = line.heading_at(foot.arc_m + ahead_m) + back_rad;
                wrapped(later_rad - heading_rad).abs()
            })
        };
        let best = near.into_iter().min_by(|a, b| {
            let apart_m = (a.foot.distance_m - b.foot.distance_m).abs();
            let nearer = match apart_m < SAME_LINE_M {
                true => turn_rad(a.lane, &a.foot).total_cmp(&turn_rad(b.lane, &b.foot)),
                false => a.foot.distance_m.total_cmp(&b.foot.distance_m),
            };
            let is_same = apart_m < 0.5;
            let by_rank = rank(a.lane, a.foot.heading_rad).cmp(&rank(b.lane, b.foot.heading_rad));
            if is_same {
                by_rank.then(nearer)
            } else {
                nearer
            }
        })?;
        self.on(best.lane, point_m, heading_rad)
    }

    /// True if a point is on no lane.
    pub(super) fn is_off(&self, point_m: DVec2) -> bool {
        self.index.lanes_near(point_m, ON_LANE_M).is_empty()
    }

    /// The lane after one, or before it: one of `route` if there is one, otherwise the one that
    /// turns least.
    fn next(&self, lane: usize, is_back: bool, route: &[usize]) -> Option<usize> {
        let listed = &self.map.lanes[lane];
        let next = if is_back {
            &listed.predecessors
        } else {
            &listed.successors
        };
        let lines = |next: usize| Some((self.line(lane)?, self.line(next)?));
        let turn_rad = |next: usize| {
            lines(next).map_or(f64::INFINITY, |(own, other)| {
                let (from_m, to_m) = if is_back {
                    (0.0, 0.0)
                } else {
                    (own.length_m(), other.length_m())
                };
                wrapped(other.heading_at(to_m) - own.heading_at(from_m)).abs()
            })
        };
        let by_turn = |a: &&usize, b: &&usize| turn_rad(**a).total_cmp(&turn_rad(**b));
        next.iter()
            .filter(|next| route.contains(next))
            .min_by(by_turn)
            .or_else(|| next.iter().min_by(by_turn))
            .copied()
            .filter(|&next| self.line(next).is_some())
    }

    /// True for a place at the end of its lanes.
    pub(super) fn ends_at(&self, place: &OnLane) -> bool {
        let left_m = if place.is_against {
            place.at_m
        } else {
            self.length_m(place.lane) - place.at_m
        };
        left_m < BESIDE_M && self.next(place.lane, place.is_against, &[]).is_none()
    }

    /// Moves a place by `ahead_m` the way it goes. Returns false at the end of the lanes.
    pub(super) fn advance(&self, place: &mut OnLane, ahead_m: f64, route: &[usize]) -> bool {
        place.at_m += place.sign() * ahead_m;
        for _ in 0..LANES_MAX {
            let length_m = self.length_m(place.lane);
            let is_back = place.at_m < 0.0;
            if !is_back && place.at_m <= length_m {
                return true;
            }
            let Some(next) = self.next(place.lane, is_back, route) else {
                place.at_m = place.at_m.clamp(0.0, length_m);
                return false;
            };
            place.at_m = if is_back {
                place.at_m + self.length_m(next)
            } else {
                place.at_m - length_m
            };
            place.lane = next;
        }
        true
    }

    /// Way along the middle of a lane beside a way of `way_m`: longer on the inside of a bend,
    /// shorter on the outside.
    pub(super) fn along_middle_m(&self, place: &OnLane, way_m: f64) -> f64 {
        let Some(line) = self.line(place.lane).filter(|_| place.left_m != 0.0) else {
            return way_m;
        };
        let heading_rad = |ahead_m: f64| line.heading_at(place.at_m + ahead_m);
        let turn_rad = wrapped(heading_rad(TURN_M) - heading_rad(-TURN_M));
        let share = 1.0 - turn_rad / (2.0 * TURN_M) * place.left_m;
        // Nearer to the middle of a bend than its lines tell.
        way_m / share.max(0.1)
    }

    /// Moves a place by `ahead_m` along the reference line of its road, the way it goes. Returns
    /// false at the end of the lanes.
    pub(super) fn advance_on_road(&self, place: &mut OnLane, ahead_m: f64) -> bool {
        let parts = (ahead_m.abs() / ROAD_STEP_M)
            .ceil()
            .clamp(1.0, ROAD_STEPS_MAX);
        for _ in 0..parts as u32 {
            let reference = OnLane {
                left_m: self.reference_left_m(place),
                ..*place
            };
            let middle_m = self.along_middle_m(&reference, ahead_m / parts);
            if !self.advance(place, middle_m, &[]) {
                return false;
            }
        }
        true
    }

    /// 1 for a place that goes the way of its road's reference line, otherwise -1: ids of lanes
    /// grow to the left of that line. On a road of one lane, traffic keeps to the right.
    pub(super) fn road_sign(&self, place: &OnLane) -> f64 {
        let own = parts(&self.map.lanes[place.lane].id);
        let Some(((_, id), (lanes, at))) = own.zip(self.across(place)) else {
            return 1.0;
        };
        let id_of = |at: usize| parts(&self.map.lanes[lanes[at].1].id).map(|(_, id)| id);
        let grows = match (at.checked_sub(1).and_then(id_of), lanes.get(at + 1)) {
            (Some(right), _) => id > right,
            (None, Some(_)) => id_of(at + 1).is_some_and(|left| left > id),
            (None, None) => (id < 0) != place.is_against,
        };
        if grows { 1.0 } else { -1.0 }
    }

    /// Offset of the reference line of a road to the left of the middle of a lane, meters: that is
    /// the border between the lanes of both directions. 0 where there are no such lanes.
    fn reference_left_m(&self, place: &OnLane) -> f64 {
        let along = OnLane {
            is_against: false,
            ..*place
        };
        let own = parts(&self.map.lanes[place.lane].id);
        let is_along = self.road_sign(&along) > 0.0;
        let keeps_right = own.is_none_or(|(_, id)| (id < 0) == is_along);
        let first = |id: i64| {
            let borders = self.first_borders[self.by_number(place, id)?].as_ref()?;
            borders[usize::from(!keeps_right)].as_ref()
        };
        let Some(line) = first(-1).or_else(|| first(1)) else {
            return 0.0;
        };
        let (point_m, heading_rad) = self.pose(&OnLane {
            left_m: 0.0,
            ..along
        });
        let foot_m = line.project(point_m).point.truncate();
        DVec2::from_angle(heading_rad).perp_dot(foot_m - point_m)
    }

    /// Lanes beside a place, by how far their middles are to the left of the way it goes, the
    /// rightmost first, with its own place among them.
    fn across(&self, place: &OnLane) -> Option<(Vec<(f64, usize)>, usize)> {
        let (section, _) = parts(&self.map.lanes[place.lane].id)?;
        let (point_m, _) = self.pose(&OnLane {
            left_m: 0.0,
            ..*place
        });
        let ahead = DVec2::from_angle(self.pose(place).1);
        let mut lanes: Vec<(f64, usize)> = self
            .sections
            .get(section)?
            .iter()
            .copied()
            .filter_map(|lane| {
                let foot = self.line(lane)?.project(point_m);
                Some((ahead.perp_dot(foot.point.truncate() - point_m), lane))
            })
            .collect();
        lanes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let own = lanes.iter().position(|(_, lane)| *lane == place.lane)?;
        Some((lanes, own))
    }

    /// The lane `lanes` to the left of a place.
    pub(super) fn beside(&self, place: &OnLane, lanes: i64) -> Option<usize> {
        if let Some((across, own)) = self.across(place) {
            let wanted = usize::try_from(i64::try_from(own).ok()?.checked_add(lanes)?).ok()?;
            return across.get(wanted).map(|(_, lane)| *lane);
        }
        let is_left = (lanes > 0) != place.is_against;
        let mut lane = place.lane;
        for _ in 0..lanes.unsigned_abs().min(64) {
            let listed = &self.map.lanes[lane];
            lane = if is_left {
                listed.left_neighbor
            } else {
                listed.right_neighbor
            }?;
        }
        self.line(lane).map(|_| lane)
    }

    /// Lanes that a point is to the left of a place.
    pub(super) fn lanes_to(&self, place: &OnLane, left_m: f64) -> Option<i64> {
        let (across, own) = self.across(place)?;
        let apart_m = |at: &(usize, &(f64, usize))| (at.1.0 - left_m).abs();
        let nearest = across.iter().enumerate();
        let (at, _) = nearest.min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)))?;
        Some(at as i64 - own as i64)
    }

    /// The lane with the number `id` beside a place.
    pub(super) fn by_number(&self, place: &OnLane, id: i64) -> Option<usize> {
        let (section, _) = parts(&self.map.lanes[place.lane].id)?;
        let mut lanes = self.sections.get(section)?.iter().copied();
        let is_wanted =
            |&lane: &usize| parts(&self.map.lanes[lane].id).map(|part| part.1) == Some(id);
        lanes
            .find(is_wanted)
            .filter(|&lane| self.line(lane).is_some())
    }

    /// Way along the lanes from a place to a point, and how far the point is to the left, meters;
    /// the way is below zero behind. `None` if the point is on no lane that leads there.
    pub(super) fn along(&self, place: &OnLane, point_m: DVec2, route: &[usize]) -> Option<DVec2> {
        let seen = |lane: usize| {
            let foot = self.line(lane)?.project(point_m);
            let is_beside = foot.distance_m - foot.lateral_m.abs() < BESIDE_M;
            (is_beside && foot.lateral_m.abs() < ACROSS_M).then_some((foot.arc_m, foot.lateral_m))
        };
        let sign = place.sign();
        if let Some((arc_m, lateral_m)) = seen(place.lane) {
            return Some(sign * DVec2::new(arc_m - place.at_m, lateral_m));
        }
        let mut best: Option<DVec2> = None;
        for is_back in [false, true] {
            let length_m = self.length_m(place.lane);
            let mut way_m = if is_back {
                place.at_m
            } else {
                length_m - place.at_m
            };
            let mut lane = place.lane;
            for _ in 0..LANES_MAX {
                let Some(next) = self.next(lane, is_back, route) else {
                    break;
                };
                lane = next;
                let length_m = self.length_m(lane);
                if let Some((arc_m, lateral_m)) = seen(lane) {
                    let along_m = match is_back {
                        true => -(way_m + length_m - arc_m),
                        false => way_m + arc_m,
                    };
                    if best.is_none_or(|best| along_m.abs() < best.x.abs()) {
                        best = Some(sign * DVec2::new(along_m, lateral_m));
                    }
                    break;
                }
                way_m += length_m;
                if way_m > ALONG_M {
                    break;
                }
            }
        }
        best
    }

    /// Lanes from a place through points, as far as ways lead there.
    pub(super) fn route(&self, place: &OnLane, points_m: &[DVec2]) -> Vec<usize> {
        let mut lanes = vec![place.lane];
        let mut from = LaneSpot {
            lane: place.lane,
            at_m: place.at_m,
        };
        for &point_m in points_m {
            let near = self.index.lanes_near(point_m, ON_LANE_M);
            let onward = near.into_iter().find_map(|near| {
                let to = LaneSpot {
                    lane: near.lane,
                    at_m: near.foot.arc_m,
                };
                lanes_between(&self.map, from, to).map(|lanes| (lanes, to))
            });
            if let Some((onward, to)) = onward {
                lanes.extend(onward);
                from = to;
            }
        }
        lanes
    }
}
