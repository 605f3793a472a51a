//! Crossings: a row of conflicts on a vehicle's path is reserved as a whole, or the vehicle waits
//! before it.
//!
//! It is granted when no other vehicle claims what conflicts with it, no vehicle with priority
//! would be hindered, and there will be room for the vehicle behind it. Room is counted without
//! any grant that a vehicle ahead still needs or that a traffic light may take back; otherwise a
//! grant is taken back for the ego and for pedestrians alone. So a
//! vehicle in a crossing leaves it, whatever those without a grant do.
//!
//! A vehicle that has waited does not give way any longer; that breaks circles such as four
//! vehicles that each have another to their right. A vehicle that has waited longer has its
//! crossing held: nothing that conflicts with it is granted to a vehicle that has waited less. It
//! is not held as long as a standing vehicle blocks it, which may wait for the same crossing.

use super::Traffic;
use super::agent::{Agent, Aside, Crossing};
use super::claims::each_cell;
use super::following::{PathPosition, each_ahead};
use super::idm::stopping_m;
use super::lane_order::Entry;
use super::outsider::Outsider;
use crate::road_graph::{Conflict, length_of};

/// Waiting time after which a vehicle no longer gives way, seconds.
const PATIENCE_S: f64 = 5.0;
/// Waiting time after which a crossing is held for a vehicle, seconds.
const WANT_S: f64 = 15.0;
/// Conflicts follow each other at less than this and a vehicle's length: they are crossed as one,
/// meters.
const BETWEEN_M: f64 = 1.5;
/// Distance of a vehicle's rear behind a crossing at which it has left, meters.
const REAR_M: f64 = 0.3;
/// Distance from a crossing at which vehicles stop that it is not granted to, meters.
pub(super) const LINE_GAP_M: f64 = 0.5;
/// The last of a gap that a vehicle closes takes too long to wait for, meters.
const CREEP_M: f64 = 0.5;
/// Short vehicles leave as much room behind a crossing as this long one, meters: more than anybody
/// drives in a step.
const LENGTH_M_MIN: f64 = 4.5;
/// Largest length of a row of conflicts that is granted as a whole, meters. A map may have lanes
/// that lie on each other all along.
const RUN_M_MAX: f64 = 150.0;
/// Distance ahead of where a vehicle could stop within which conflicts are looked for, meters.
const AHEAD_M: f64 = 100.0;
/// Braking before a crossing that is not granted, m/s^2: it is asked for when one would have to
/// begin.
const BRAKING_MPS2: f64 = 2.0;
/// Distance from the conflict within which vehicles with priority are considered, meters.
const GIVE_WAY_M: f64 = 80.0;
/// Expected acceleration of a standing vehicle, m/s^2.
const START_MPS2: f64 = 1.5;

impl Agent {
    /// Room that it needs behind a crossing, meters.
    pub(super) fn clearance_m(&self) -> f64 {
        self.size.length_m.max(LENGTH_M_MIN) + BETWEEN_M
    }

    /// Part of a queue of standing vehicles that it takes up, meters.
    fn queue_m(&self) -> f64 {
        self.size.length_m.max(LENGTH_M_MIN) + self.driver.idm.standstill_gap_m + CREEP_M
    }

    /// Way that it can drive before it needs the grant of a crossing, meters.
    fn free_way_m(&self) -> f64 {
        let sign_m = self.sign.map_or(f64::INFINITY, |sign| {
            sign.hold_m - LINE_GAP_M - CREEP_M - self.front_m()
        });
        let free_m = self.crossing.map_or(f64::INFINITY, |crossing| {
            // A light may take the grant back as long as its line is ahead.
            let line_m = self.light.map_or(f64::INFINITY, |light| light.line_m);
            if crossing.granted && line_m < crossing.to_m {
                line_m - LINE_GAP_M - CREEP_M - self.front_m()
            } else if crossing.granted {
                crossing.to_m + self.clearance_m() - self.front_m()
            } else {
                crossing.from_m - LINE_GAP_M - CREEP_M - self.front_m()
            }
        });
        free_m.min(sign_m)
    }
}

impl Traffic {
    /// Keeps every agent's crossing, and grants those that can be.
    pub(super) fn cross(&mut self, dt_s: f64) {
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.clear();
        for number in 0..self.agents.len() {
            if !self.agents[number].is_here() {
                continue;
            }
            self.find_crossing(number);
            self.give_back(number);
            let light = self.next_light(&self.agents[number]);
            let mut sign = self.next_stop_sign(&self.agents[number]);
            let agent = &mut self.agents[number];
            if let Some(at) = sign.filter(|sign| sign.is_stood_at(agent)) {
                agent.stood_at = Some(at.sign);
                sign = None;
            }
            agent.light = light;
            agent.sign = sign;
            agent.held_up = false;
            let Some(crossing) = agent.crossing else {
                continue;
            };
            let speed_mps = agent.speed_mps;
            let asks_m = speed_mps * speed_mps / (2.0 * BRAKING_MPS2)
                + speed_mps
                + agent.driver.idm.standstill_gap_m
                + 3.0;
            // Granted, but the vehicle could still stop before it: the grant is checked again.
            let open = !crossing.granted || agent.stop_m() < crossing.from_m - 0.01;
            if open && crossing.from_m - agent.front_m() < asks_m {
                waiting.push(number as u32);
            }
        }
        let agents = &self.agents;
        waiting.sort_unstable_by(|&a, &b| {
            let waited = |number: u32| agents[number as usize].waited_s;
            waited(b).total_cmp(&waited(a)).then(a.cmp(&b))
        });
        for &number in &waiting {
            self.ask(number as usize, dt_s);
        }
        self.waiting = waiting;
    }

    /// The next row of conflicts on an agent's path, where it has none or has left the last.
    pub(super) fn find_crossing(&mut self, number: usize) {
        let agent = &self.agents[number];
        let stop_m = agent.stop_m();
        match agent.crossing {
            Some(crossing) if !crossing.granted || stop_m < crossing.to_m => return,
            None if agent.clear_m > stop_m + AHEAD_M => return,
            _ => {}
        }
        let (crossing, clear_m) = self.next_crossing(agent, stop_m);
        let agent = &mut self.agents[number];
        (agent.crossing, agent.clear_m) = (crossing, clear_m);
    }

    /// Releases the part of a crossing that is ahead of an agent which stands in it, where the ego
    /// or a pedestrian is in its way.
    ///
    /// No vehicles come to wait for each other by that. A vehicle that is granted a crossing
    /// meanwhile meets no box of those who gave theirs back, so that the last one to get a grant
    /// can leave, and after it the one before.
    fn give_back(&mut self, number: usize) {
        let agent = &self.agents[number];
        let Some(crossing) = agent.crossing.filter(|crossing| crossing.granted) else {
            return;
        };
        let stands_in = agent.speed_mps == 0.0 && agent.front_m() > crossing.from_m;
        if stands_in && self.outsider_crosses(agent, &crossing) {
            let (rest, clear_m) = self.next_crossing(agent, agent.stop_m());
            let agent = &mut self.agents[number];
            (agent.crossing, agent.clear_m) = (rest, clear_m);
        }
    }

    /// Conflicts nearer to each other than this are crossed as one, meters. It is the same for all
    /// vehicles, so that where one waits within a crossing all do.
    pub(super) fn between_m(&self) -> f64 {
        self.graph.vehicle().length_m + BETWEEN_M
    }

    /// The first row of conflicts that ends beyond `after_m` on an agent's path, and up to where
    /// there are none if there is no such row.
    pub(super) fn next_crossing(&self, agent: &Agent, after_m: f64) -> (Option<Crossing>, f64) {
        let (mut found, mut at, mut start_m): (Option<Crossing>, usize, f64) =
            (None, agent.here, 0.0);
        let mut is_whole = true;
        while at > 0 && after_m < start_m {
            at -= 1;
            start_m -= length_of(self.graph.lanes(), agent.path[at]);
        }
        for &lane in &agent.path[at..] {
            for stretch in self.graph.cells().stretches(lane) {
                let (from_m, to_m) = (stretch.from_m + start_m, stretch.to_m + start_m);
                if to_m <= after_m {
                    continue;
                }
                match &mut found {
                    None => {
                        found = Some(Crossing {
                            from_m: from_m.max(after_m),
                            to_m,
                            granted: false,
                        });
                    }
                    Some(run)
                        if from_m - run.to_m < self.between_m()
                            && to_m - run.from_m < RUN_M_MAX =>
                    {
                        run.to_m = to_m;
                    }
                    Some(_) => return (found, f64::INFINITY),
                }
            }
            start_m += length_of(self.graph.lanes(), lane);
            if start_m > found.map_or(after_m + 1.5 * AHEAD_M, |run| run.to_m + self.between_m()) {
                is_whole = false;
                break;
            }
        }
        let last = self.graph.road(agent.path[agent.path.len() - 1]);
        // Beyond the end of the lanes nothing is driven.
        let ends = found.is_some() || is_whole && last.successors.is_empty();
        (found, if ends { f64::INFINITY } else { start_m })
    }

    /// Grants an agent its crossing, or makes it wait.
    fn ask(&mut self, number: usize, dt_s: f64) {
        let agent = &self.agents[number];
        let Some(crossing) = agent.crossing else {
            return;
        };
        let patient = agent.waited_s < PATIENCE_S;
        let is_blocked = self.outsider_crosses(agent, &crossing);
        let held = agent.hold_m().is_some_and(|hold_m| hold_m < crossing.to_m);
        let can_leave = self.can_leave(agent, &crossing);
        // A grant is taken back for the ego, pedestrians and lights alone: others rely on it.
        let granted = can_leave
            && !held
            && !is_blocked
            && (crossing.granted
                || self.is_free(agent, &crossing)
                    && !(patient && self.gives_way(agent, &crossing)));
        if granted && !crossing.granted {
            self.claims
                .claim_between(&self.graph, agent, agent.rear_m(), crossing.to_m - 0.01);
        }
        if !granted
            && !held
            && !is_blocked
            && agent.waited_s > WANT_S
            && can_leave
            && !self.waits_for_standing(&self.agents[number])
        {
            let (graph, agent) = (&self.graph, &self.agents[number]);
            let claims = &mut self.claims;
            each_cell(
                graph,
                agent,
                crossing.from_m,
                crossing.to_m - 0.01,
                |cell| {
                    claims.want(cell);
                    true
                },
            );
        }
        let agent = &mut self.agents[number];
        agent.crossing = Some(Crossing {
            granted,
            ..crossing
        });
        agent.held_up = !granted;
        if granted || held {
            agent.waited_s = 0.0;
        } else if agent.speed_mps < 2.0 {
            agent.waited_s += dt_s;
        }
    }

    /// Grants a crossing at the start, where no vehicle has the right of way yet; false if it
    /// cannot be granted.
    pub(super) fn grant_at_start(&mut self, number: usize) -> bool {
        let agent = &self.agents[number];
        let Some(crossing) = agent.crossing.filter(|crossing| !crossing.granted) else {
            return true;
        };
        let free = self.can_leave(agent, &crossing) && self.is_free(agent, &crossing);
        if free {
            self.claims
                .claim_between(&self.graph, agent, agent.rear_m(), crossing.to_m - 0.01);
            self.agents[number].crossing = Some(Crossing {
                granted: true,
                ..crossing
            });
        }
        free
    }

    /// True if no vehicle ahead can keep an agent from leaving a crossing: the ego, where the
    /// crossing is granted already.
    fn can_leave(&self, agent: &Agent, crossing: &Crossing) -> bool {
        let out_m = crossing.to_m + agent.clearance_m();
        if agent.wall_m(&self.graph).is_some_and(|end_m| end_m < out_m) {
            return false;
        }
        // Behind a swerve it would have to wait in the crossing.
        let blocked = || self.blocks_ahead(agent).any(|at_m| at_m < out_m);
        if !crossing.granted && (blocked() || !self.can_leave_lane(agent)) {
            return false;
        }
        // Room for this vehicle, and for those ahead that are not out yet.
        let mut room_m = crossing.to_m + REAR_M + agent.queue_m();
        let (mut can_leave, mut counted) = (true, Vec::new());
        each_ahead(
            &self.graph,
            &self.order,
            agent.path_position(),
            GIVE_WAY_M + room_m - agent.arc_m,
            |seen| {
                if seen.stop_rear_m >= room_m {
                    return !seen.same_way;
                }
                let Some(other) = self.agents.get(seen.agent as usize) else {
                    can_leave = false;
                    return false;
                };
                if crossing.granted || counted.contains(&seen.agent) {
                    return true;
                }
                let granted = other.crossing.is_some_and(|crossing| crossing.granted);
                can_leave = seen.stop_rear_m > crossing.from_m
                    && seen.rear_m + other.free_way_m() >= room_m
                    && (seen.same_way || granted || seen.speed_mps > 1.0);
                if seen.same_way {
                    room_m += other.queue_m();
                    counted.push(seen.agent);
                }
                can_leave
            },
        );
        can_leave
    }

    /// True if an agent that changes lanes will not have to wait for a vehicle on the lane that it
    /// is leaving. That vehicle may wait for the same crossing.
    fn can_leave_lane(&self, agent: &Agent) -> bool {
        let Some((from, from_arc_m)) = agent.left_lane() else {
            return true;
        };
        let position = PathPosition {
            agent: agent.number,
            path: &[from],
            here: 0,
            arc_m: from_arc_m,
        };
        let gap_m = agent.driver.idm.standstill_gap_m + CREEP_M;
        let front_m = from_arc_m + agent.half_m;
        let horizon_m = agent.half_m + agent.aside.as_ref().map_or(0.0, Aside::rest_m) + gap_m;
        let mut free = true;
        each_ahead(&self.graph, &self.order, position, horizon_m, |seen| {
            free &= seen.stop_rear_m > front_m + self.leaving_m(agent, seen) + gap_m;
            free
        });
        free
    }

    /// True if no other agent has reserved a cell that conflicts with a crossing.
    fn is_free(&self, agent: &Agent, crossing: &Crossing) -> bool {
        let free = |cell| {
            !self.claims.conflict(&self.graph, cell, agent.number)
                && !self.claims.is_wanted(&self.graph, cell)
        };
        each_cell(
            &self.graph,
            agent,
            crossing.from_m,
            crossing.to_m - 0.01,
            free,
        )
    }

    /// True if a vehicle that stands keeps an agent from its crossing. To hold the crossing for the
    /// agent would be of no use, and might be what the other waits for.
    fn waits_for_standing(&self, agent: &Agent) -> bool {
        agent.crossing.is_some_and(|crossing| {
            !each_cell(
                &self.graph,
                agent,
                crossing.from_m,
                crossing.to_m - 0.01,
                |cell| !self.claims.is_stood_on(&self.graph, cell, agent.number),
            )
        })
    }

    /// True if a pedestrian, or an ego other than behind the agent, is in a crossing or approaches
    /// it.
    fn outsider_crosses(&self, agent: &Agent, crossing: &Crossing) -> bool {
        let follows = |entry: &Entry| {
            let lane = agent.path[..=agent.here]
                .iter()
                .position(|&lane| lane == entry.lane as usize);
            lane.is_some_and(|lane| lane < agent.here || entry.middle_m < agent.arc_m)
        };
        let egos = self.outsiders.egos.iter();
        let minded: Vec<&Outsider> = egos
            .filter(|ego| !ego.entries.iter().any(follows))
            .collect();
        let ego_on = |cell: usize| minded.iter().any(|ego| ego.will_be_on(cell));
        let free = |cell| !(ego_on(cell) || self.claims.pedestrian_on(cell));
        (!minded.is_empty() || !self.outsiders.pedestrians.is_empty())
            && !each_cell(
                &self.graph,
                agent,
                crossing.from_m,
                crossing.to_m - 0.01,
                free,
            )
    }

    /// True if a vehicle with priority arrives before the agent has cleared its path.
    fn gives_way(&self, agent: &Agent, crossing: &Crossing) -> bool {
        let mut start_m = 0.0;
        for &lane in &agent.path[agent.here..] {
            if start_m >= crossing.to_m {
                break;
            }
            for conflict in &self.graph.road(lane).conflicts {
                let (from_m, to_m) = (conflict.from_m + start_m, conflict.to_m + start_m);
                if self.has_to_give_way(lane, conflict)
                    && to_m > crossing.from_m
                    && from_m < crossing.to_m
                {
                    let out_s = seconds_for(
                        to_m - agent.rear_m(),
                        agent.speed_mps,
                        agent.driver.idm.acceleration_mps2,
                    );
                    if self.somebody_comes(agent, conflict, out_s + agent.driver.gap_s) {
                        return true;
                    }
                }
            }
            start_m += length_of(self.graph.lanes(), lane);
        }
        false
    }

    /// True if a vehicle on the other lane of a conflict, or on its way to it, arrives within
    /// `within_s`.
    fn somebody_comes(&self, agent: &Agent, conflict: &Conflict, within_s: f64) -> bool {
        let mut open = vec![(conflict.other, None, 0.0_f64)];
        while let Some((lane, onward, start_m)) = open.pop() {
            let entries = self.order.on(lane);
            let last =
                entries.partition_point(|entry| entry.middle_m + start_m < conflict.other_to_m);
            let comes = |number: u32| {
                let other = self.agents.get(number as usize);
                other.is_none_or(|other| {
                    other.path[other.here..]
                        .iter()
                        .take(8)
                        .any(|&lane| lane == conflict.other)
                })
            };
            // Vehicles before a red light do not come.
            let red_m = self
                .red_line(lane, onward)
                .filter(|red_m| red_m + start_m < conflict.other_to_m);
            let others = entries[..last].iter().rev().filter(|entry| {
                entry.agent as usize != agent.number
                    && red_m.is_none_or(|red_m| entry.front_m > red_m)
            });
            if let Some(entry) = others.clone().find(|entry| comes(entry.agent)) {
                let distance_m = conflict.other_from_m - entry.front_m - start_m;
                // A vehicle in the conflict has reserved it: that is checked elsewhere.
                let granted = self
                    .agents
                    .get(entry.agent as usize)
                    .and_then(|other| other.crossing)
                    .is_some_and(|run| run.granted);
                if !granted && distance_m > -stopping_m(entry.speed_mps) {
                    if seconds_for(distance_m.max(0.0), entry.speed_mps, START_MPS2) < within_s {
                        return true;
                    }
                    continue;
                }
            }
            if red_m.is_none() && conflict.other_from_m - start_m < GIVE_WAY_M && open.len() < 16 {
                let before = &self.graph.road(lane).predecessors;
                open.extend(before.iter().map(|&before| {
                    let length_m = length_of(self.graph.lanes(), before);
                    (before, Some(lane), start_m - length_m)
                }));
            }
        }
        false
    }
}

/// Duration of a distance from a speed at a constant acceleration, seconds.
fn seconds_for(distance_m: f64, speed_mps: f64, acceleration_mps2: f64) -> f64 {
    ((speed_mps * speed_mps + 2.0 * acceleration_mps2 * distance_m).sqrt() - speed_mps)
        / acceleration_mps2
}
