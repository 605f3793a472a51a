//! Vehicles on each lane, sorted along it.

use decouplegs_scene::Egos;

use super::agent::Agent;
use super::idm::stopping_m;
use super::outsider::Outsiders;
use crate::road_graph::{RoadGraph, length_of};

/// Agent number of the first ego; those of others are below it.
const EGO: u32 = u32::MAX;
/// Agent number of pedestrians.
pub(super) const PEDESTRIAN: u32 = EGO - Egos::MAX as u32;
/// Lane number of an entry whose next lane is not known, or whose vehicle is on this lane only in
/// part.
pub(super) const NO_LANE: u32 = u32::MAX;
/// Lane number of an entry whose lane leads nowhere.
pub(super) const DEAD_END: u32 = u32::MAX - 1;
/// Share of the stopping distance that counts on the lane that a vehicle is leaving: it may be a
/// little longer there.
const LEAVING_SHARE: f64 = 0.9;

/// A vehicle on a lane; one on several has an entry on each. Positions are meters along the lane,
/// before and beyond it too.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub lane: u32,
    pub agent: u32,
    /// The lane that it continues in, [`NO_LANE`] or [`DEAD_END`].
    pub next: u32,
    pub middle_m: f64,
    pub rear_m: f64,
    pub front_m: f64,
    /// Rear position after full braking.
    pub stop_rear_m: f64,
    pub speed_mps: f64,
}

impl Entry {
    /// True if it is an agent on lanes, which goes on as its path does.
    pub(super) fn is_vehicle(&self) -> bool {
        self.agent < PEDESTRIAN
    }
}

/// Agent number of ego `ego`, from 0.
pub(super) const fn ego_number(ego: usize) -> u32 {
    EGO - ego as u32
}

/// True if it is the number of an ego.
pub(super) const fn is_ego(agent: u32) -> bool {
    agent > PEDESTRIAN
}

/// Entries of all lanes.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneOrder {
    entries: Vec<Entry>,
    starts: Vec<u32>,
}

impl LaneOrder {
    pub(super) fn build(&mut self, graph: &RoadGraph, agents: &[Agent], outsiders: &Outsiders) {
        self.entries.clear();
        for agent in agents.iter().filter(|agent| agent.is_here()) {
            self.add(graph, agent);
        }
        let outside = outsiders.all().flat_map(|outsider| &outsider.entries);
        self.entries.extend(outside);
        self.entries.sort_unstable_by(|a, b| {
            a.lane
                .cmp(&b.lane)
                .then(a.middle_m.total_cmp(&b.middle_m))
                .then(a.agent.cmp(&b.agent))
        });
        self.starts.clear();
        self.starts.resize(graph.lanes_in_map() + 1, 0);
        for entry in &self.entries {
            self.starts[entry.lane as usize + 1] += 1;
        }
        for lane in 0..graph.lanes_in_map() {
            self.starts[lane + 1] += self.starts[lane];
        }
    }

    /// Entries on a lane, along it.
    pub(super) fn on(&self, lane: usize) -> &[Entry] {
        &self.entries[self.starts[lane] as usize..self.starts[lane + 1] as usize]
    }

    fn add(&mut self, graph: &RoadGraph, agent: &Agent) {
        let stopping_m = stopping_m(agent.speed_mps);
        let entry = |lane: usize, next: u32, middle_m: f64, share: f64| Entry {
            lane: lane as u32,
            agent: agent.number as u32,
            next,
            middle_m,
            rear_m: middle_m - agent.half_m,
            front_m: middle_m + agent.half_m,
            stop_rear_m: middle_m - agent.half_m + share * stopping_m,
            speed_mps: agent.speed_mps,
        };
        // Back to the lane that its rear is on.
        let (mut at, mut middle_m) = (agent.here, agent.arc_m);
        while at > 0 && middle_m < agent.half_m {
            at -= 1;
            middle_m += length_of(graph.lanes(), agent.path[at]);
        }
        while at < agent.path.len() && (at <= agent.here || middle_m + agent.half_m > 0.0) {
            let lane = agent.path[at];
            let next = agent.path.get(at + 1).map_or(DEAD_END, |&next| next as u32);
            self.entries.push(entry(lane, next, middle_m, 1.0));
            for fork in &graph.road(lane).forks {
                if middle_m - agent.half_m < fork.to_m {
                    let own = entry(fork.other, NO_LANE, middle_m, 1.0);
                    let rear_m = behind_fork(own.rear_m, fork.lead_m);
                    let stop_rear_m = behind_fork(own.stop_rear_m, fork.lead_m);
                    let middle_m = rear_m + agent.half_m;
                    self.entries.push(Entry {
                        rear_m,
                        stop_rear_m,
                        middle_m,
                        front_m: rear_m + 2.0 * agent.half_m,
                        ..own
                    });
                }
            }
            middle_m -= length_of(graph.lanes(), lane);
            at += 1;
        }
        if let Some((from, from_arc_m)) = agent.left_lane() {
            self.entries
                .push(entry(from, NO_LANE, from_arc_m, LEAVING_SHARE));
        }
    }
}

/// Rear position on a lane of a vehicle on another lane of the same fork. It never falls while the
/// vehicle moves on, so a vehicle that could stop behind it still can.
pub(super) fn behind_fork(rear_m: f64, lead_m: f64) -> f64 {
    if rear_m < 0.0 {
        rear_m
    } else {
        (rear_m - lead_m).max(0.0)
    }
}
