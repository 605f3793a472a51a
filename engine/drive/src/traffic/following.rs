//! Leaders and followers on an agent's path, and its car-following response.

use super::Traffic;
use super::agent::{Agent, wall_on};
use super::idm::{BRAKING_MPS2, IdmParameters, Leader, safe_acceleration};
use super::junction::LINE_GAP_M;
use super::lane_order::{DEAD_END, LaneOrder, NO_LANE, PEDESTRIAN, behind_fork};
use super::signals::STANDING_MPS;
use crate::road_graph::{RoadGraph, length_of, speed_before};

/// Agents never come nearer to each other than this, meters: what the positions of boxes along
/// curves, and rounding, are off by at most.
pub(super) const GAP_M: f64 = 0.5;
/// Look-ahead distance beyond which leaders are ignored: meters, and seconds at the own speed.
const HORIZON_M: f64 = 50.0;
const HORIZON_S: f64 = 4.0;
/// The end of a lane is seen from farther away: braking for it is to be gentle.
const END_M: f64 = 50.0;
/// Distance from the end of its lane at which a vehicle waits that found no room to merge, meters:
/// a change of lanes takes as much.
pub(super) const MERGE_ROOM_M: f64 = 30.0;
/// A driver loses speed that is too much for the road in about this time, seconds.
const SLOWING_S: f64 = 0.5;
/// Change of acceleration in normal driving, m/s^3: what passengers bear.
const JERK_MPS3: f64 = 10.0;
/// Braking beyond which a driver minds comfort no longer, m/s^2.
const EMERGENCY_MPS2: f64 = 4.0;
/// Acceleration across the lane in lane changes and swerves, m/s^2.
pub(super) const ASIDE_MPS2: f64 = 2.0;
/// Short of a line that one must not cross, meters.
pub(super) const LINE_M: f64 = 0.02;

/// Leader; positions are meters from the start of one's own lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub agent: u32,
    pub rear_m: f64,
    /// Earliest rear position after full braking.
    pub stop_rear_m: f64,
    pub speed_mps: f64,
    /// True if it follows the same path, so that its own leader need not be considered.
    pub same_way: bool,
}

impl Seen {
    /// True for a pedestrian beside a vehicle whose front is there: one who does not walk into its
    /// side, and whom it passes.
    fn is_beside(&self, front_m: f64) -> bool {
        self.agent == PEDESTRIAN && self.rear_m < front_m
    }
}

/// A position of an agent on a path.
#[derive(Clone, Copy)]
pub(super) struct PathPosition<'a> {
    /// Index of the agent, which does not see itself.
    pub agent: usize,
    /// Lanes of the path.
    pub path: &'a [usize],
    /// Index in `path` of the lane on which the agent is.
    pub here: usize,
    /// Position on that lane, meters from its start.
    pub arc_m: f64,
}

/// Visits all vehicles ahead of a position on a path, the nearest first, until `see` has seen
/// enough. Who is on several lanes is seen on each.
pub(super) fn each_ahead(
    graph: &RoadGraph,
    order: &LaneOrder,
    position: PathPosition<'_>,
    horizon_m: f64,
    mut see: impl FnMut(&Seen) -> bool,
) {
    let PathPosition {
        agent,
        path,
        here,
        arc_m,
    } = position;
    let (mut at, mut start_m) = (here, 0.0);
    while at < path.len() && start_m <= arc_m + horizon_m {
        let length_m = length_of(graph.lanes(), path[at]);
        let next = path.get(at + 1).map_or(DEAD_END, |&next| next as u32);
        let entries = order.on(path[at]);
        let first = entries.partition_point(|entry| entry.middle_m + start_m <= arc_m);
        for entry in entries[first..]
            .iter()
            .filter(|entry| entry.agent as usize != agent)
        {
            let parts = entry.next < DEAD_END && entry.next != next && entry.stop_rear_m > length_m;
            let stop_rear_m = if parts {
                let forks = &graph.road(entry.next as usize).forks;
                let lead_m = forks
                    .iter()
                    .find(|fork| fork.other as u32 == next)
                    .map_or(f64::INFINITY, |fork| fork.lead_m);
                length_m + behind_fork(entry.stop_rear_m - length_m, lead_m)
            } else {
                entry.stop_rear_m
            };
            let same_way = entry.next == next && entry.is_vehicle();
            let more = see(&Seen {
                agent: entry.agent,
                rear_m: entry.rear_m + start_m,
                stop_rear_m: stop_rear_m + start_m,
                speed_mps: entry.speed_mps,
                same_way,
            });
            if !more {
                return;
            }
        }
        start_m += length_m;
        at += 1;
    }
}

/// Follower of a position on a lane; meters from the start of that lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Behind {
    pub agent: u32,
    pub front_m: f64,
    pub speed_mps: f64,
}

/// Followers of a position on a lane, back to the first agent that is wholly on it, over the lanes
/// before it where there is none.
pub(super) fn behind(
    graph: &RoadGraph,
    order: &LaneOrder,
    agent: usize,
    lane: usize,
    arc_m: f64,
    horizon_m: f64,
) -> Vec<Behind> {
    let (mut found, mut open) = (Vec::new(), vec![(lane, 0.0_f64)]);
    while let Some((at, start_m)) = open.pop() {
        let entries = order.on(at);
        let last = entries.partition_point(|entry| entry.middle_m + start_m <= arc_m);
        let mut ends = false;
        for entry in entries[..last]
            .iter()
            .rev()
            .filter(|entry| entry.agent as usize != agent)
        {
            let front_m = entry.front_m + start_m;
            found.push(Behind {
                agent: entry.agent,
                front_m,
                speed_mps: entry.speed_mps,
            });
            ends = entry.is_vehicle() && entry.next != NO_LANE;
            if ends {
                break;
            }
        }
        if !ends && start_m > arc_m - horizon_m && open.len() < 16 {
            let road = graph.road(at);
            open.extend(
                road.predecessors
                    .iter()
                    .map(|&before| (before, start_m - length_of(graph.lanes(), before))),
            );
        }
    }
    found
}

/// The acceleration nearest to `wished_mps2` that normal driving allows after the last one, and the
/// hardest braking from which the vehicle comes to a stand gently: the acceleration changes by at
/// most [`JERK_MPS3`].
fn comfortable(agent: &Agent, wished_mps2: f64, dt_s: f64) -> (f64, f64) {
    let step_mps2 = JERK_MPS3 * dt_s;
    // Braking that ends step by step: v = dt step (1 + 2 + ... + count). A count between two whole
    // ones is rounded up, and all steps are a little less.
    let count = 0.5 * ((1.0 + 8.0 * agent.speed_mps / (dt_s * step_mps2)).sqrt() - 1.0);
    let count = (count - 1e-9).ceil().max(1.0);
    let to_stand_mps2 = agent.speed_mps / (dt_s * count) + 0.5 * step_mps2 * (count - 1.0);
    let last_mps2 = agent.acceleration_mps2;
    let comfortable_mps2 = wished_mps2
        .max(-to_stand_mps2)
        .clamp(last_mps2 - step_mps2, last_mps2 + step_mps2);
    (comfortable_mps2, to_stand_mps2)
}

/// Limits of an agent's motion.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    acceleration_mps2: f64,
    /// Distance by which the stopping position may advance.
    room_m: f64,
}

impl Bounds {
    fn follow(&mut self, idm: &IdmParameters, speed_mps: f64, gap_m: f64, leader_mps: f64) {
        let leader = Leader {
            gap_m,
            speed_mps: leader_mps,
        };
        self.acceleration_mps2 = self
            .acceleration_mps2
            .min(idm.acceleration(speed_mps, Some(leader)));
    }

    fn stop_within(&mut self, room_m: f64) {
        self.room_m = self.room_m.min(room_m);
    }
}

impl Traffic {
    /// Desired speed of an agent: the limit of its lane and of the curves ahead, scaled by its
    /// driver.
    pub(super) fn free_speed(&self, agent: &Agent) -> f64 {
        // Drivers in a hurry exceed limits, not what bends allow.
        let share = agent.driver.speed_share;
        let at = |lane: usize, arc_m: f64| {
            let curve_mps = self.curve_mps(lane, arc_m);
            if let Some(cruise_mps) = agent.cruise_mps {
                return cruise_mps.min(curve_mps * share.min(1.0));
            }
            let limit_mps = self.limit_mps(lane);
            if curve_mps < limit_mps {
                curve_mps * share.min(1.0)
            } else {
                agent.accepted.free_speed(limit_mps * share)
            }
        };
        let mut speed_mps = at(agent.lane(), agent.arc_m);
        let mut start_m = length_of(self.graph.lanes(), agent.lane());
        for &lane in &agent.path[agent.here + 1..] {
            let distance_m = start_m - agent.arc_m;
            if distance_m > HORIZON_M + HORIZON_S * agent.speed_mps {
                break;
            }
            speed_mps = speed_mps.min(speed_before(at(lane, 0.0), distance_m));
            start_m += length_of(self.graph.lanes(), lane);
        }
        let aside_mps = agent
            .aside
            .as_ref()
            .map_or(f64::INFINITY, |aside| aside.speed_mps_max(ASIDE_MPS2));
        speed_mps.min(aside_mps).min(agent.driver.speed_mps_max)
    }

    /// Acceleration by the model alone, along a path: leaders and where the lanes end.
    pub(super) fn following(&self, agent: &Agent, path: &[usize], here: usize, arc_m: f64) -> f64 {
        let mut bounds = Bounds {
            acceleration_mps2: agent.idm().free_acceleration(agent.speed_mps),
            room_m: f64::INFINITY,
        };
        self.follow_path(agent, (path, here, arc_m), &mut bounds);
        bounds.acceleration_mps2
    }

    fn follow_path(
        &self,
        agent: &Agent,
        (path, here, arc_m): (&[usize], usize, f64),
        bounds: &mut Bounds,
    ) {
        let idm = agent.idm();
        let (front_m, stop_m) = (arc_m + agent.half_m, agent.stop_m() - agent.arc_m + arc_m);
        let horizon_m = HORIZON_M + HORIZON_S * agent.speed_mps;
        each_ahead(
            &self.graph,
            &self.order,
            PathPosition {
                agent: agent.number,
                path,
                here,
                arc_m,
            },
            horizon_m,
            |seen| {
                if seen.is_beside(front_m) {
                    return true;
                }
                bounds.follow(&idm, agent.speed_mps, seen.rear_m - front_m, seen.speed_mps);
                bounds.stop_within(seen.stop_rear_m - GAP_M - stop_m);
                !seen.same_way
            },
        );
        if let Some(end_m) = wall_on(&self.graph, &path[here..]) {
            bounds.stop_within(end_m - LINE_M - stop_m);
            let merge_m = end_m - MERGE_ROOM_M;
            if merge_m - front_m < horizon_m + END_M {
                bounds.follow(&idm, agent.speed_mps, merge_m - front_m, 0.0);
            }
        }
    }

    /// Acceleration of an agent in a step, and true if it brakes harder than in normal driving: the
    /// car-following model within the limits of comfort, unless it would not be safe.
    pub(super) fn acceleration(&self, agent: &Agent, dt_s: f64) -> (f64, bool) {
        let idm = agent.idm();
        let mut bounds = Bounds {
            acceleration_mps2: idm.free_acceleration(agent.speed_mps),
            room_m: f64::INFINITY,
        };
        self.follow_path(agent, (&agent.path, agent.here, agent.arc_m), &mut bounds);
        if let Some((from, from_arc_m)) = agent.left_lane() {
            self.follow_left_lane(agent, from, from_arc_m, &mut bounds);
        }
        let stop_m = agent.stop_m();
        bounds.stop_within(agent.clear_m - LINE_M - stop_m);
        let to_line = IdmParameters {
            standstill_gap_m: LINE_GAP_M,
            ..idm
        };
        if let Some(crossing) = agent.crossing {
            if crossing.granted {
                // What follows the crossing is looked for when it is left behind.
                bounds.stop_within(crossing.to_m + agent.clearance_m() - LINE_M - stop_m);
            } else {
                bounds.stop_within(crossing.from_m - LINE_M - stop_m);
            }
            if agent.held_up {
                bounds.follow(
                    &to_line,
                    agent.speed_mps,
                    crossing.from_m - agent.front_m(),
                    0.0,
                );
            }
        }
        if let Some(hold_m) = agent.hold_m() {
            bounds.follow(&to_line, agent.speed_mps, hold_m - agent.front_m(), 0.0);
            bounds.stop_within(hold_m - LINE_M - stop_m);
        }
        for at_m in self.blocks_ahead(agent) {
            bounds.follow(&idm, agent.speed_mps, at_m - agent.front_m(), 0.0);
            bounds.stop_within(at_m - LINE_M - stop_m);
        }
        // The model alone would be late for bends: it hardly brakes where it is little too fast.
        let too_fast_mps = agent.speed_mps - agent.free_mps;
        if too_fast_mps > 0.0 {
            let slows_mps2 = (too_fast_mps / SLOWING_S).min(idm.braking_mps2);
            bounds.acceleration_mps2 = bounds.acceleration_mps2.min(-slows_mps2);
        }
        let starts_mps2 = agent.driver.start_share * idm.acceleration_mps2;
        if agent.speed_mps < STANDING_MPS && bounds.acceleration_mps2 < starts_mps2 {
            bounds.acceleration_mps2 = bounds.acceleration_mps2.min(0.0);
        }
        let (comfortable_mps2, to_stand_mps2) = comfortable(agent, bounds.acceleration_mps2, dt_s);
        let mut urgent_mps2 = safe_acceleration(agent.speed_mps, bounds.room_m, dt_s);
        if bounds.acceleration_mps2 < -EMERGENCY_MPS2 {
            urgent_mps2 = urgent_mps2.min(bounds.acceleration_mps2);
        }
        if let Some((braking_mps2, _)) = agent.brake {
            // It ends as gently as other braking does.
            urgent_mps2 = urgent_mps2.min(-braking_mps2.min(to_stand_mps2));
        }
        let acceleration_mps2 = comfortable_mps2.min(urgent_mps2).max(-BRAKING_MPS2);
        let emergency = urgent_mps2 < comfortable_mps2 || acceleration_mps2 < -to_stand_mps2;
        (acceleration_mps2, emergency)
    }

    /// Adds the leaders on the lane that an agent is leaving, but for those whom it passes.
    fn follow_left_lane(&self, agent: &Agent, from: usize, from_arc_m: f64, bounds: &mut Bounds) {
        let idm = agent.idm();
        let (front_m, stop_m) = (
            from_arc_m + agent.half_m,
            from_arc_m + agent.stop_m() - agent.arc_m,
        );
        let horizon_m = HORIZON_M + HORIZON_S * agent.speed_mps;
        each_ahead(
            &self.graph,
            &self.order,
            PathPosition {
                agent: agent.number,
                path: &[from],
                here: 0,
                arc_m: from_arc_m,
            },
            horizon_m,
            |seen| {
                if seen.is_beside(front_m) {
                    return true;
                }
                // Its rear comes no nearer, whatever it does: the change passes beside it.
                if seen.rear_m > front_m + self.leaving_m(agent, seen) + GAP_M {
                    return true;
                }
                bounds.follow(&idm, agent.speed_mps, seen.rear_m - front_m, seen.speed_mps);
                bounds.stop_within(seen.stop_rear_m - GAP_M - stop_m);
                !seen.same_way
            },
        );
    }

    /// Positions at which a swerve of another agent blocks the path, meters from the start of its
    /// lane.
    pub(super) fn blocks_ahead(&self, agent: &Agent) -> impl Iterator<Item = f64> {
        let others = self
            .claims
            .blocks
            .iter()
            .filter(|block| block.agent != agent.number);
        others.filter_map(|block| {
            let mut start_m = 0.0;
            for &lane in &agent.path[agent.here..] {
                if lane == block.lane && start_m + block.to_m > agent.front_m() {
                    return Some(start_m + block.from_m);
                }
                start_m += length_of(self.graph.lanes(), lane);
                if start_m > agent.stop_m() + HORIZON_M {
                    break;
                }
            }
            None
        })
    }
}
