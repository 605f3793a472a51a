//! Start and route of the ego.

use decouplegs_scene::VehicleSize;
use decouplegs_scene::scenario::EgoTask;
use glam::DVec2;

use super::random::Stream;
use super::reference;
use super::roads::{Roads, Spot};
use super::rules::LevelRequirements;
use super::{down_to_tenth, to_centimeter};
use crate::route::Route;

/// The ego's box.
pub(super) const EGO: VehicleSize = VehicleSize::CAR;
/// Range of requested route lengths, meters.
const ROUTE_M: (f64, f64) = (100.0, 180.0);
/// Bounds of a route.
struct Bounds {
    /// A route that has to be shorter than this is none, meters.
    length_m_min: f64,
    /// A route is so short that it can be driven in this time where nothing is in the way, seconds.
    free_time_s: f64,
    /// Least speed of the ego, m/s.
    cruise_mps_min: f64,
}

/// Bounds where roads are as fast as in towns: the time leaves a third of an episode to wait for
/// others, and the least speed is that of a bicycle.
const IN_TOWN: Bounds = Bounds {
    length_m_min: 60.0,
    free_time_s: 13.0,
    cruise_mps_min: 4.0,
};
/// Bounds on car parks and campuses, where the slowest lane allows no more than a walk.
const SLOW: Bounds = Bounds {
    length_m_min: 30.0,
    free_time_s: 75.0,
    cruise_mps_min: 0.8,
};
/// Least length of a route where a captured place was seen on a short stretch alone, meters.
const SEEN_ROUTE_M_MIN: f64 = 15.0;

/// Length below which no route is taken at any speed, meters; `is_limited` where routes stay where
/// the place was seen from.
pub(super) fn route_m_min(is_limited: bool) -> f64 {
    if is_limited {
        SEEN_ROUTE_M_MIN
    } else {
        SLOW.length_m_min
    }
}
/// A route is over no more lanes than this: lanes of a meter are short, shorter ones a mistake.
const LANES_MAX: usize = 300;
/// The ego is never asked to be faster than is allowed in towns.
const CRUISE_MPS_MAX: f64 = 50.0 / 3.6;
/// Share of routes that lead straight on where they can.
const STRAIGHT_SHARE: f64 = 0.65;
/// A lane that turns by less leads straight on, radians.
const STRAIGHT_RAD: f64 = 0.35;
/// Least distance of a route's end from the end of a lane that leads nowhere, meters: the ego's
/// front stays on the map, and it has somewhere to go.
const DEAD_END_M: f64 = 5.0;
/// Area in which routes may start and end: a circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Center, world coordinates, meters.
    pub center_m: DVec2,
    /// Radius, meters.
    pub radius_m: f64,
}

impl Area {
    pub(super) fn holds(&self, position_m: DVec2) -> bool {
        self.center_m.distance(position_m) <= self.radius_m
    }

    /// Distance along `route` at which it first leaves the area, or its length, meters.
    pub(super) fn along_m(&self, route: &Route) -> f64 {
        let length_m = route.length_m();
        let places_m = (0..=length_m.ceil() as usize).map(|meter| (meter as f64).min(length_m));
        let mut outside_m = places_m.filter(|&at_m| !self.holds(route.pose_at(at_m).0.truncate()));
        outside_m.next().unwrap_or(length_m)
    }
}

/// A task for the ego.
pub(super) struct EgoStart {
    /// Task of the ego; its speed is the preferred speed at the start.
    pub task: EgoTask,
    pub spot: Spot,
    /// The lanes of the route.
    pub lanes: Vec<usize>,
    pub route: Route,
    /// The first lane of the route that others cross.
    pub crossing: Option<usize>,
}

impl EgoStart {
    /// The place `ahead_m` along the route.
    pub fn along(&self, roads: &Roads, ahead_m: f64) -> Option<Spot> {
        let mut at_m = self.spot.at_m + ahead_m;
        for &lane in &self.lanes {
            let length_m = roads.length_m(lane);
            if at_m <= length_m {
                return Some(Spot { lane, at_m });
            }
            at_m -= length_m;
        }
        None
    }

    /// Distance of `spot` along the route if it is on one of the route's lanes; below zero behind
    /// the start.
    pub fn ahead_m(&self, roads: &Roads, spot: Spot) -> Option<f64> {
        let mut begin_m = -self.spot.at_m;
        for &lane in &self.lanes {
            if lane == spot.lane {
                return Some(begin_m + spot.at_m);
            }
            begin_m += roads.length_m(lane);
        }
        None
    }
}

/// Preferences of a level for a start. Maps that have none of it are driven on all the same.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wishes {
    /// A crossing ahead.
    pub crossing: bool,
    /// A lane beside the ego's to cut in from.
    pub beside: bool,
    /// A route of any speed, however long it takes.
    pub slow: bool,
}

/// A start and a route; none where the random place was none for either.
pub(super) fn choose(
    roads: &Roads,
    area: Option<Area>,
    rules: &LevelRequirements,
    random: &Stream,
    wishes: Wishes,
) -> Option<EgoStart> {
    let mut draw = random.split(0);
    let before_crossing = draw.chance(rules.crossing_share) && wishes.crossing;
    let lanes = if before_crossing {
        before_a_crossing(roads, rules, &mut draw)?
    } else {
        vec![roads.anywhere(&mut draw)?]
    };
    let spot = Spot {
        at_m: to_centimeter(lanes[0].at_m),
        ..lanes[0]
    };
    let inside = |spot: Spot| area.is_none_or(|area| area.holds(roads.position_m(spot)));
    let road = roads.graph.lane(spot.lane)?;
    let lacks_lane = wishes.beside && rules.cut_ins > 0 && road.left.or(road.right).is_none();
    if lacks_lane || !inside(spot) || !roads.has_room(spot, &EGO) {
        return None;
    }
    let led: Vec<usize> = lanes.iter().map(|spot| spot.lane).collect();
    let mut length_m = draw.between(ROUTE_M);
    let bounds = if wishes.slow { SLOW } else { IN_TOWN };
    let bounds = match roads.is_limited() {
        true => Bounds {
            length_m_min: SEEN_ROUTE_M_MIN,
            ..bounds
        },
        false => bounds,
    };
    // Each time too long is made shorter; the same turns are taken.
    for _ in 0..6 {
        let (lanes, end_m) = onward(roads, spot, &led, (length_m, &bounds), random.split(1))?;
        let end = Spot {
            lane: *lanes.last()?,
            at_m: end_m,
        };
        let start = task(roads, spot, lanes, end_m, &bounds)?;
        let time_s = reference::free_s(&start.route, start.task.cruise_mps);
        let seen_m = roads.seen_m(&start.route);
        let is_seen = start.route.length_m() <= seen_m;
        if time_s <= bounds.free_time_s && inside(end) && is_seen {
            if !roads.hold(&start.route, &EGO) {
                return None;
            }
            let share = draw.between(rules.ego_speed_share);
            let speed_mps = down_to_tenth(share * start.task.cruise_mps);
            return Some(EgoStart {
                task: EgoTask {
                    speed_mps,
                    ..start.task
                },
                ..start
            });
        }
        if !is_seen {
            length_m = seen_m;
            if length_m < bounds.length_m_min {
                return None;
            }
            continue;
        }
        let shorter = if inside(end) {
            0.97 * bounds.free_time_s / time_s
        } else {
            0.9
        };
        length_m = start.route.length_m() * shorter;
        if length_m < bounds.length_m_min {
            return None;
        }
    }
    None
}

/// Lanes that lead to a crossing, the first with the place to start.
fn before_a_crossing(
    roads: &Roads,
    rules: &LevelRequirements,
    draw: &mut Stream,
) -> Option<Vec<Spot>> {
    let crossing = *draw.pick(&roads.crossings)?;
    let mut lanes = vec![Spot {
        at_m: crossing.at_m - draw.between(rules.before_crossing_m) - 0.5 * EGO.length_m,
        ..crossing
    }];
    while lanes[0].at_m < 0.0 {
        let before = *draw.pick(&roads.graph.lane(lanes[0].lane)?.predecessors)?;
        if lanes.len() >= LANES_MAX || lanes.iter().any(|spot| spot.lane == before) {
            return None;
        }
        let at_m = lanes[0].at_m + roads.length_m(before);
        lanes[0].at_m = 0.0;
        lanes.insert(0, Spot { lane: before, at_m });
    }
    Some(lanes)
}

/// Lanes from `spot` on, first those it is `led` over, and how far along the last of them
/// `length_m` leads. Less where the lanes end.
fn onward(
    roads: &Roads,
    spot: Spot,
    led: &[usize],
    (length_m, bounds): (f64, &Bounds),
    mut random: Stream,
) -> Option<(Vec<usize>, f64)> {
    let (mut lanes, mut end_m) = (vec![spot.lane], spot.at_m + length_m);
    loop {
        let last = *lanes.last()?;
        let own_m = roads.length_m(last);
        if end_m <= own_m {
            break;
        }
        let road = roads.graph.lane(last)?;
        let onward: Vec<usize> = road
            .successors
            .iter()
            .copied()
            .filter(|next| !lanes.contains(next))
            .collect();
        let turn = |lane: usize| {
            roads
                .graph
                .lane(lane)
                .map_or(0.0, |lane| lane.turn_rad.abs())
        };
        let (straight, aside): (Vec<usize>, Vec<usize>) =
            onward.iter().partition(|&&lane| turn(lane) < STRAIGHT_RAD);
        let rather = if random.chance(STRAIGHT_SHARE) {
            [&straight, &aside]
        } else {
            [&aside, &straight]
        };
        let drawn = random.pick(if rather[0].is_empty() {
            rather[1]
        } else {
            rather[0]
        });
        let Some(&next) = led
            .get(lanes.len())
            .or(drawn)
            .filter(|_| lanes.len() < LANES_MAX)
        else {
            end_m = own_m - DEAD_END_M;
            break;
        };
        end_m -= own_m;
        lanes.push(next);
    }
    let last = *lanes.last()?;
    let leads_on = !roads.graph.lane(last)?.successors.is_empty();
    let rest_m = if leads_on { 0.01 } else { DEAD_END_M };
    let end_m = to_centimeter(end_m.min(roads.length_m(last) - rest_m));
    let driven_m: f64 = lanes.iter().map(|&lane| roads.length_m(lane)).sum::<f64>() - spot.at_m;
    let rest_m = roads.length_m(*lanes.last()?) - end_m;
    (end_m > 0.0 && driven_m - rest_m >= bounds.length_m_min).then_some((lanes, end_m))
}

fn task(
    roads: &Roads,
    spot: Spot,
    lanes: Vec<usize>,
    end_m: f64,
    bounds: &Bounds,
) -> Option<EgoStart> {
    let limit_mps = lanes
        .iter()
        .map(|&lane| roads.speed_limit_mps(lane))
        .fold(CRUISE_MPS_MAX, f64::min);
    let task = EgoTask {
        route: lanes
            .iter()
            .map(|&lane| roads.map.lanes[lane].id.clone())
            .collect(),
        start_m: spot.at_m,
        end_m,
        speed_mps: 0.0,
        cruise_mps: down_to_tenth(limit_mps),
        size: EGO,
        follows_recording: false,
        start_pose: None,
    };
    let route = Route::new(roads.map, &task)
        .ok()
        .filter(|_| task.cruise_mps >= bounds.cruise_mps_min)?;
    let crossed = |lane: &&usize| {
        roads
            .graph
            .lane(**lane)
            .is_some_and(|lane| !lane.conflicts.is_empty())
    };
    let crossing = lanes.iter().find(crossed).copied();
    Some(EgoStart {
        task,
        spot,
        lanes,
        route,
        crossing,
    })
}
