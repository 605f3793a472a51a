//! Lane changes: the wish for one, whether it is safe, and its start. The rest is a vehicle beside
//! the middle of its lane (see `agent`), which counts as present on both lanes until it is over.

use decouplegs_scene::scenario::LaneSide;
use glam::DVec2;

use super::Traffic;
use super::agent::{Agent, Aside, AsideKind, LeavingRoom};
use super::following::{GAP_M, PathPosition, Seen, behind, each_ahead};
use super::idm::{IdmParameters, Leader, stopping_m};
use super::lane_order::is_ego;
use super::mobil::{Change, Concerned, Side};
use crate::polyline::wrapped;
use crate::road_graph::length_of;

/// Duration of a change, seconds, and its least length: meters, and lengths of the vehicle. Shorter
/// ones would turn its nose out of the two lanes.
const DURATION_S: f64 = 4.0;
const HASTY_DURATION_S: f64 = 3.0;
const LENGTH_M_MIN: f64 = 20.0;
const LENGTHS_MIN: f64 = 5.0;
/// Interval at which drivers consider a change, seconds, and time after a change in which they do
/// not.
const PERIOD_S: f64 = 1.0;
const COOL_DOWN_S: f64 = 2.0;
/// Least speed of a voluntary lane change, m/s.
const SPEED_MPS_MIN: f64 = 1.5;
/// Range of the distance between the middles of two lanes, meters.
const ASIDE_M: std::ops::Range<f64> = 1.5..6.0;
/// Largest difference of two lanes in heading, and largest turn of each of them meanwhile, radians:
/// else their lengths differ.
const PARALLEL_RAD: f64 = 0.1;
const TURN_RAD: f64 = 0.3;
/// Distance within which followers are considered, meters: the fastest can stop within it.
const BEHIND_M: f64 = 120.0;
/// Distance from the part of a lane that vehicles take up within which the ego is still in the
/// middle of it, meters.
const KEEPS_LANE_M: f64 = 0.1;
/// Part of a queue that a vehicle takes up, meters.
const QUEUE_M: f64 = 7.5;
/// Time for which a driver who changes lanes expects those on his own lane to go on, seconds.
const LEADER_S: f64 = 2.5;
/// Bonus for a lane that goes on where the own lane ends within `MERGE_S`, m/s^2: only what is not
/// safe keeps a vehicle from it.
const MERGE_MPS2: f64 = 100.0;
/// Time and distance before the end of its lane from where a vehicle has to merge: seconds at its
/// speed, and meters.
const MERGE_S: f64 = 10.0;
const MERGE_M: f64 = 150.0;

/// Position of an agent on another lane.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub lane: usize,
    pub arc_m: f64,
    /// Length of the change, meters.
    pub length_m: f64,
}

impl Traffic {
    /// Lets those change lanes whose turn it is to think of it.
    pub(super) fn change_lanes(&mut self, dt_s: f64) {
        // Each agent once per period, spread evenly over its steps.
        let steps = (PERIOD_S / dt_s).round().max(1.0) as u64;
        let first = (self.steps % steps) as usize;
        for number in (first..self.agents.len()).step_by(steps as usize) {
            let agent = &self.agents[number];
            let wishes =
                agent.changes_lanes && agent.cool_down_s == 0.0 && agent.speed_mps >= SPEED_MPS_MIN;
            let ready = agent.is_here() && (wishes || self.has_to_merge(agent));
            if ready && agent.brake.is_none() {
                self.consider_change(number);
            }
        }
    }

    fn consider_change(&mut self, number: usize) {
        let agent = &self.agents[number];
        let road = self.graph.road(agent.lane());
        let mut best: Option<(f64, Target)> = None;
        for (lane, side) in [(road.left, Side::Left), (road.right, Side::Right)] {
            let Some(target) = lane.and_then(|lane| self.target(agent, lane, DURATION_S)) else {
                continue;
            };
            let Some(incentive) = self.incentive(agent, &target, side) else {
                continue;
            };
            if incentive > best.as_ref().map_or(0.0, |best| best.0)
                && self.is_safe(agent, &target, true)
                && (self.comes_in(agent, &target) || self.has_to_merge(agent))
            {
                best = Some((incentive, target));
            }
        }
        if let Some((_, target)) = best {
            self.begin_change(number, &target);
        }
    }

    /// Changes into the lane beside that the nearest ego is on, whatever the gap to it. `None`
    /// where it is on none of them, else whether the change began.
    pub(super) fn cut_in(&mut self, number: usize) -> Option<bool> {
        let agent = &self.agents[number];
        let at_m = agent.state(&self.graph).position_m;
        let ego = self.outsiders.nearest_ego(at_m)?;
        let road = self.graph.road(agent.lane());
        let on_it = |lane: usize| {
            // The ego may still be on the lane before, or already on the next.
            let near = self.graph.road(lane);
            let mut lanes = near
                .predecessors
                .iter()
                .chain(&near.successors)
                .chain([&lane]);
            lanes.any(|&lane| ego.entries.iter().any(|entry| entry.lane as usize == lane))
        };
        let own = ego
            .entries
            .iter()
            .any(|entry| entry.lane as usize == agent.lane());
        let lane = [road.left, road.right]
            .into_iter()
            .flatten()
            .find(|&lane| on_it(lane) && !own)?;
        if agent.aside.is_some() {
            return Some(false);
        }
        let target = self
            .target(agent, lane, HASTY_DURATION_S)
            .filter(|target| self.is_safe(agent, target, false))
            .filter(|target| !self.ego_leads(agent, target));
        if let Some(target) = &target {
            self.begin_change(number, target);
        }
        Some(target.is_some())
    }

    /// True if an ego is ahead on the new lane, but not by a gap: an agent would stop beside it.
    fn ego_leads(&self, agent: &Agent, target: &Target) -> bool {
        let mut entries = self.order.on(target.lane).iter();
        entries.any(|entry| {
            is_ego(entry.agent)
                && entry.middle_m > target.arc_m
                && entry.rear_m < target.arc_m + agent.half_m + GAP_M
        })
    }

    /// The position beside an agent on another lane, where both lanes run side by side, and no lane
    /// crosses them, for as long as a change takes.
    fn target(&self, agent: &Agent, lane: usize, duration_s: f64) -> Option<Target> {
        if agent.aside.is_some() {
            return None;
        }
        let (own, other) = (self.graph.road(agent.lane()), self.graph.road(lane));
        let least_m = LENGTH_M_MIN.max(LENGTHS_MIN * agent.size.length_m);
        let length_m = (duration_s * agent.speed_mps).max(least_m);
        let at = own.line.at(agent.arc_m).truncate();
        let foot = other.line.project(at);
        // A bend on the other lane that it is too fast for is not for a change of lanes.
        let curve_mps = self.curve_mps(lane, foot.arc_m);
        let limit_mps = agent.cruise_mps.unwrap_or_else(|| self.limit_mps(lane));
        let allowed_mps = curve_mps.min(limit_mps);
        if allowed_mps * agent.driver.speed_share.max(1.0) + 0.5 < agent.speed_mps {
            return None;
        }
        let needed_m = length_m + agent.half_m + 2.0;
        let within = |arc_m: f64, lane: usize| {
            arc_m > agent.half_m + 1.0 && arc_m + needed_m < length_of(self.graph.lanes(), lane)
        };
        if !within(agent.arc_m, agent.lane())
            || !within(foot.arc_m, lane)
            || !ASIDE_M.contains(&foot.distance_m)
        {
            return None;
        }
        let turns = |line: &crate::Polyline, arc_m: f64| {
            wrapped(line.heading_at(arc_m + needed_m) - line.heading_at(arc_m)).abs()
        };
        let apart = wrapped(foot.heading_rad - own.line.heading_at(agent.arc_m)).abs();
        if apart > PARALLEL_RAD
            || turns(&other.line, foot.arc_m) > TURN_RAD
            || turns(&own.line, agent.arc_m) > TURN_RAD
        {
            return None;
        }
        let crossed = |lane: usize, arc_m: f64| {
            let (from_m, to_m) = (arc_m - agent.half_m, arc_m + needed_m);
            let stretches = self.graph.cells().stretches(lane).iter();
            let forks = &self.graph.road(lane).forks;
            let blocks = self.claims.blocks.iter().filter(|block| block.lane == lane);
            stretches
                .clone()
                .any(|stretch| stretch.from_m < to_m && stretch.to_m > from_m)
                || forks.iter().any(|fork| fork.to_m > from_m)
                || blocks
                    .clone()
                    .any(|block| block.from_m < to_m && block.to_m > from_m)
        };
        let clear = !crossed(agent.lane(), agent.arc_m) && !crossed(lane, foot.arc_m);
        clear.then_some(Target {
            lane,
            arc_m: foot.arc_m,
            length_m,
        })
    }

    /// Gain of a change by MOBIL; `None` if it violates the safety criterion.
    fn incentive(&self, agent: &Agent, target: &Target, side: Side) -> Option<f64> {
        let old = self.neighbors(agent, agent.lane(), &agent.path[agent.here..], agent.arc_m);
        let new = self.neighbors(agent, target.lane, &[target.lane], target.arc_m);
        let oneself = Change {
            before_mps2: self.following(agent, &agent.path, agent.here, agent.arc_m),
            after_mps2: self.following(agent, &self.path_on(agent, target.lane), 0, target.arc_m),
        };
        let own_rear = |arc_m: f64| Some((arc_m - agent.half_m, agent.speed_mps));
        let concerned = Concerned {
            oneself,
            new_follower: new.of_follower(new.leader, own_rear(target.arc_m)),
            old_follower: old.of_follower(own_rear(agent.arc_m), old.leader),
        };
        let (own, other) = (self.graph.road(agent.lane()), self.graph.road(target.lane));
        let leads_on = other.onward_m - target.arc_m > own.onward_m - agent.arc_m + 100.0;
        let urgent = if leads_on && self.has_to_merge(agent) {
            MERGE_MPS2
        } else {
            0.0
        };
        Some(agent.driver.mobil.incentive(&concerned, side)? + urgent)
    }

    /// True if the lane of an agent ends within the map, and soon.
    fn has_to_merge(&self, agent: &Agent) -> bool {
        let near_m = MERGE_M.max(MERGE_S * agent.speed_mps);
        let wall_m = agent.wall_m(&self.graph);
        wall_m.is_some_and(|wall_m| wall_m - agent.front_m() < near_m)
    }

    /// A path that begins on another lane, as far as one looks.
    fn path_on(&self, agent: &Agent, lane: usize) -> Vec<usize> {
        let mut probe = Agent::new(agent.number, agent.size, agent.driver, lane, 0.0);
        probe.extend_path(&self.graph, self.seed);
        probe.path
    }

    /// Leader and follower of an agent on a lane.
    fn neighbors(&self, agent: &Agent, lane: usize, path: &[usize], arc_m: f64) -> Neighbors {
        let mut found = Neighbors::default();
        each_ahead(
            &self.graph,
            &self.order,
            PathPosition {
                agent: agent.number,
                path,
                here: 0,
                arc_m,
            },
            BEHIND_M,
            |seen| {
                found.leader = Some((seen.rear_m, seen.speed_mps));
                false
            },
        );
        let behind = behind(
            &self.graph,
            &self.order,
            agent.number,
            lane,
            arc_m,
            BEHIND_M,
        );
        let nearest = behind.iter().max_by(|a, b| a.front_m.total_cmp(&b.front_m));
        found.follower = nearest.map(|follower| {
            let idm = self
                .agents
                .get(follower.agent as usize)
                .map_or_else(IdmParameters::default, Agent::idm);
            (idm, follower.front_m, follower.speed_mps)
        });
        found
    }

    /// True if every vehicle on the new lane can stop behind its leader after the change, and none
    /// is beside.
    pub(super) fn is_safe(&self, agent: &Agent, target: &Target, mind_ego: bool) -> bool {
        let (front_m, rear_m) = (target.arc_m + agent.half_m, target.arc_m - agent.half_m);
        let own_stopping_m = stopping_m(agent.speed_mps);
        let stop_m = front_m + own_stopping_m;
        if self
            .claims
            .is_kept(agent.number, target.lane, rear_m, stop_m)
        {
            return false;
        }
        let counts = |number: u32| mind_ego || !is_ego(number);
        let mut safe = self.comes_out(agent, target);
        self.each_before(agent, target, |seen| {
            let room = seen.rear_m - front_m >= GAP_M
                && seen.stop_rear_m - front_m - own_stopping_m >= GAP_M;
            safe &= room || !counts(seen.agent);
            safe && !seen.same_way
        });
        let behind = behind(
            &self.graph,
            &self.order,
            agent.number,
            target.lane,
            target.arc_m,
            BEHIND_M,
        );
        safe && behind
            .iter()
            .filter(|other| counts(other.agent))
            .all(|other| {
                let stop_m = other.front_m + stopping_m(other.speed_mps);
                rear_m - other.front_m >= GAP_M && rear_m + own_stopping_m - stop_m >= GAP_M
            })
    }

    /// True if an agent comes past all vehicles on its own lane in a change of lanes, even if they
    /// soon stand: else it might stand across two lanes for as long as they do. Those before a
    /// vehicle that stands will stand behind it.
    fn comes_out(&self, agent: &Agent, target: &Target) -> bool {
        let swerves = |kind: &AsideKind| matches!(kind, AsideKind::Swerve { .. });
        if self.meets_aside(agent.number, target.length_m, swerves) {
            return false;
        }
        let room = self.change(agent, target).1;
        let (mut comes_out, mut queue_m) = (true, 0.0);
        each_ahead(
            &self.graph,
            &self.order,
            agent.path_position(),
            BEHIND_M,
            |seen| {
                let way_m = match self.keeps_lane(seen, agent.lane()) {
                    true => room.passes_m,
                    false => target.length_m,
                };
                let needed_m = agent.front_m() + way_m + GAP_M;
                let goes_m = LEADER_S * seen.speed_mps;
                comes_out &= seen.rear_m + goes_m > needed_m;
                if seen.speed_mps < SPEED_MPS_MIN {
                    comes_out &= seen.rear_m - queue_m > needed_m;
                    return false;
                }
                queue_m += QUEUE_M;
                comes_out
            },
        );
        comes_out
    }

    /// True if a vehicle is in the middle of its lane: then a change of lanes may pass it.
    fn keeps_lane(&self, seen: &Seen, lane: usize) -> bool {
        if let Some(other) = self.agents.get(seen.agent as usize) {
            return other.aside.is_none();
        }
        let mut egos = self.outsiders.egos.iter();
        let ego = egos.find(|ego| ego.entries.iter().any(|entry| entry.agent == seen.agent));
        ego.is_some_and(|ego| {
            let line = &self.graph.road(lane).line;
            let mut corners = ego.outline.corners().into_iter();
            let within_m = 0.5 * self.graph.vehicle().width_m + KEEPS_LANE_M;
            corners.all(|corner| line.project(corner).distance_m < within_m)
        })
    }

    /// Distance before its front beyond which an agent's lane change does not touch a vehicle on
    /// the lane that it is leaving, meters.
    pub(super) fn leaving_m(&self, agent: &Agent, seen: &Seen) -> f64 {
        match &agent.aside {
            Some(Aside {
                kind: AsideKind::Change { from, .. },
                ..
            }) if self.keeps_lane(seen, *from) => agent.leaving_m(),
            Some(aside) => aside.rest_m(),
            None => 0.0,
        }
    }

    /// Calls `see` for those ahead of `target` on its lane, nearest first, until it returns false.
    fn each_before(&self, agent: &Agent, target: &Target, see: impl FnMut(&Seen) -> bool) {
        let position = PathPosition {
            agent: agent.number,
            path: &[target.lane],
            here: 0,
            arc_m: target.arc_m,
        };
        each_ahead(&self.graph, &self.order, position, BEHIND_M, see);
    }

    /// True if an agent will be off its own lane before it comes near the vehicle ahead on the new
    /// one, which keeps its speed.
    fn comes_in(&self, agent: &Agent, target: &Target) -> bool {
        let front_m = target.arc_m + agent.half_m;
        let needed_m =
            front_m + self.change(agent, target).1.leaves_m + agent.driver.idm.standstill_gap_m;
        let duration_s = target.length_m / agent.speed_mps.max(1.0);
        let mut comes_in = true;
        self.each_before(agent, target, |seen| {
            comes_in = seen.rear_m + seen.speed_mps * duration_s > needed_m;
            false
        });
        comes_in
    }

    /// Changes into the neighboring lane on a side if that is safe. `None` if there is no such
    /// lane, otherwise true if the change began.
    pub(super) fn change_to(&mut self, number: usize, side: LaneSide) -> Option<bool> {
        let agent = &self.agents[number];
        let road = self.graph.road(agent.lane());
        let lane = match side {
            LaneSide::Left => road.left,
            LaneSide::Right => road.right,
        }?;
        let target = self
            .target(agent, lane, HASTY_DURATION_S)
            .filter(|target| self.is_safe(agent, target, true));
        if let Some(target) = &target {
            self.begin_change(number, target);
        }
        Some(target.is_some())
    }

    /// Offset of an agent from a position on another lane, and the room that the change needs.
    fn change(&self, agent: &Agent, target: &Target) -> (DVec2, LeavingRoom) {
        let graph = &self.graph;
        let beside = Agent::new(
            agent.number,
            agent.size,
            agent.driver,
            target.lane,
            target.arc_m,
        );
        let (position_m, _) = agent.pose_at(graph, 0.0, None);
        let (on_lane_m, yaw_rad) = beside.pose_at(graph, 0.0, None);
        let offset_m = DVec2::from_angle(-yaw_rad).rotate(position_m - on_lane_m);
        let room = LeavingRoom::new(
            offset_m.y,
            target.length_m,
            &agent.size,
            graph.vehicle().width_m,
        );
        (offset_m, room)
    }

    fn begin_change(&mut self, number: usize, target: &Target) {
        let (offset_m, room) = self.change(&self.agents[number], target);
        let (graph, agent) = (&self.graph, &mut self.agents[number]);
        let (from, from_arc_m) = (agent.lane(), agent.arc_m);
        (agent.path, agent.here, agent.arc_m) = (vec![target.lane], 0, target.arc_m);
        agent.extend_path(graph, self.seed);
        let kind = AsideKind::Change {
            from,
            from_arc_m,
            offset_m,
            room,
        };
        agent.aside = Some(Aside {
            traveled_m: 0.0,
            length_m: target.length_m,
            kind,
        });
        (agent.crossing, agent.clear_m, agent.held_up, agent.waited_s) =
            (None, f64::NEG_INFINITY, false, 0.0);
        agent.cool_down_s = target.length_m / agent.speed_mps.max(1.0) + COOL_DOWN_S;
        self.order.build(graph, &self.agents, &self.outsiders);
        self.claims.claim(graph, &self.agents[number]);
    }
}

/// Leader and follower of a position on a lane.
#[derive(Clone, Debug, Default)]
struct Neighbors {
    /// Rear position and speed.
    leader: Option<(f64, f64)>,
    /// Driver model, front position and speed.
    follower: Option<(IdmParameters, f64, f64)>,
}

impl Neighbors {
    /// Change of the follower's acceleration when its leader's rear and speed change.
    fn of_follower(&self, before: Option<(f64, f64)>, after: Option<(f64, f64)>) -> Change {
        let Some((idm, front_m, speed_mps)) = &self.follower else {
            return Change::default();
        };
        let behind = |leader: Option<(f64, f64)>| {
            let leader = leader.map(|(rear_m, speed_mps)| Leader {
                gap_m: rear_m - front_m,
                speed_mps,
            });
            idm.acceleration(*speed_mps, leader)
        };
        Change {
            before_mps2: behind(before),
            after_mps2: behind(after),
        }
    }
}
