//! Leaders and followers on an agent's path, and its car-following response.

use super::Traffic;
use super::agent::{Agent, AsideKind};
use super::idm::{BRAKING_MPS2, IdmParameters, Leader, safe_acceleration};
use super::lane_order::{DEAD_END, EGO, LaneOrder, NO_LANE, behind_fork};
use crate::road_graph::{RoadGraph, length_of, speed_before};

/// Agents never come nearer to each other than this, meters: what the places of boxes along curves,
/// and rounding, are off by at most.
pub(super) const GAP_M: f64 = 0.5;
/// Look-ahead distance beyond which leaders are ignored: meters, and seconds at the own speed.
const HORIZON_M: f64 = 50.0;
const HORIZON_S: f64 = 4.0;
/// The end of a lane is seen from farther away: braking for it is to be gentle.
const END_M: f64 = 50.0;
/// Short of a line that one must not cross, meters.
const LINE_M: f64 = 0.02;

/// Leader; places are meters from the start of one's own lane.
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

/// A place of an agent on a path.
#[derive(Clone, Copy)]
pub(super) struct PathPlace<'a> {
    /// Index of the agent, which does not see itself.
    pub agent: usize,
    /// Lanes of the path.
    pub path: &'a [usize],
    /// Index in `path` of the lane on which the agent is.
    pub here: usize,
    /// Position on that lane, meters from its start.
    pub arc_m: f64,
}

/// Visits all vehicles ahead of a place on a path, the nearest first, until `see` has seen enough.
/// Who is on several lanes is seen on each.
pub(super) fn each_ahead(
    graph: &RoadGraph,
    order: &LaneOrder,
    place: PathPlace<'_>,
    horizon_m: f64,
    mut see: impl FnMut(&Seen) -> bool,
) {
    let PathPlace {
        agent,
        path,
        here,
        arc_m,
    } = place;
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
            let same_way = entry.next == next && entry.agent != EGO;
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

/// Follower of a place on a lane; meters from the start of that lane.
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
            ends = entry.agent != EGO && entry.next != NO_LANE;
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

/// Limits of an agent's motion.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    acceleration_mps2: f64,
    /// Distance by which the stopping place may advance.
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
        let cells = self.graph.cells();
        let mut speed_mps = cells.approach_mps(agent.lane(), agent.arc_m);
        let mut start_m = length_of(self.graph.lanes(), agent.lane());
        for &lane in &agent.path[agent.here + 1..] {
            let distance_m = start_m - agent.arc_m;
            if distance_m > HORIZON_M + HORIZON_S * agent.speed_mps {
                break;
            }
            speed_mps = speed_mps.min(speed_before(cells.approach_mps(lane, 0.0), distance_m));
            start_m += length_of(self.graph.lanes(), lane);
        }
        speed_mps * agent.driver.speed_share
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
            PathPlace {
                agent: agent.number,
                path,
                here,
                arc_m,
            },
            horizon_m,
            |seen| {
                bounds.follow(&idm, agent.speed_mps, seen.rear_m - front_m, seen.speed_mps);
                bounds.stop_within(seen.stop_rear_m - GAP_M - stop_m);
                !seen.same_way
            },
        );
        if self.graph.road(path[path.len() - 1]).successors.is_empty() {
            let end_m: f64 = path[here..]
                .iter()
                .map(|&lane| length_of(self.graph.lanes(), lane))
                .sum();
            bounds.stop_within(end_m - LINE_M - stop_m);
            if end_m - front_m < horizon_m + END_M {
                bounds.follow(&idm, agent.speed_mps, end_m - front_m, 0.0);
            }
        }
    }

    /// Acceleration of an agent in a step: the car-following model within safe limits.
    pub(super) fn acceleration(&self, agent: &Agent, dt_s: f64) -> f64 {
        let idm = agent.idm();
        let mut bounds = Bounds {
            acceleration_mps2: idm.free_acceleration(agent.speed_mps),
            room_m: f64::INFINITY,
        };
        self.follow_path(agent, (&agent.path, agent.here, agent.arc_m), &mut bounds);
        if let Some(AsideKind::Change {
            from, from_arc_m, ..
        }) = agent.aside.as_ref().map(|aside| &aside.kind)
        {
            self.follow_left_lane(agent, *from, *from_arc_m, &mut bounds);
        }
        let stop_m = agent.stop_m();
        bounds.stop_within(agent.clear_m - LINE_M - stop_m);
        if let Some(crossing) = agent.crossing {
            if crossing.granted {
                // What follows the crossing is looked for when it is left behind.
                bounds.stop_within(crossing.to_m + self.clearance_m(agent) - LINE_M - stop_m);
            } else {
                bounds.stop_within(crossing.from_m - LINE_M - stop_m);
            }
            if agent.held_up {
                bounds.follow(
                    &idm,
                    agent.speed_mps,
                    crossing.from_m - agent.front_m(),
                    0.0,
                );
            }
        }
        for at_m in self.blocks_ahead(agent) {
            bounds.follow(&idm, agent.speed_mps, at_m - agent.front_m(), 0.0);
            bounds.stop_within(at_m - LINE_M - stop_m);
        }
        if let Some((braking_mps2, _)) = agent.brake {
            bounds.acceleration_mps2 = bounds.acceleration_mps2.min(-braking_mps2);
        }
        let safe_mps2 = safe_acceleration(agent.speed_mps, bounds.room_m, dt_s);
        bounds.acceleration_mps2.min(safe_mps2).max(-BRAKING_MPS2)
    }

    /// Adds the leaders on the lane that an agent is leaving.
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
            PathPlace {
                agent: agent.number,
                path: &[from],
                here: 0,
                arc_m: from_arc_m,
            },
            horizon_m,
            |seen| {
                bounds.follow(&idm, agent.speed_mps, seen.rear_m - front_m, seen.speed_mps);
                bounds.stop_within(seen.stop_rear_m - GAP_M - stop_m);
                !seen.same_way
            },
        );
    }

    /// Positions at which a swerve of another agent blocks the path, meters from the start of its
    /// lane.
    fn blocks_ahead(&self, agent: &Agent) -> impl Iterator<Item = f64> {
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
