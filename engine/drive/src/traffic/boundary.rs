//! Flow over the borders of the map: a vehicle leaves where its lane ends there, and enters again
//! where a lane begins, so that a place keeps the number of vehicles that its scenario names.

use super::Traffic;
use super::agent::Agent;
use super::claims::each_cell;
use super::following::{GAP_M, MERGE_ROOM_M, each_ahead};
use super::idm::BRAKING_MPS2;
use super::random;

/// A vehicle that has left stays away for a random time up to this, seconds: vehicles do not come
/// in step.
const AWAY_S_MAX: f64 = 4.0;
/// A vehicle that found no room tries another entrance after this, seconds.
const RETRY_S: f64 = 0.5;
/// Least distance from the ego at which vehicles enter, meters: nearer ones would come out of
/// nothing.
const EGO_M: f64 = 50.0;
/// Room between a vehicle that enters and the one ahead, meters.
const ROOM_M: f64 = 4.0;
/// Time before the end of its lane after which a vehicle that could not merge leaves the map,
/// seconds. It would keep all others from going on.
const MERGE_S_MAX: f64 = 25.0;

impl Traffic {
    /// Takes vehicles off the map where their lanes leave it.
    pub(super) fn leave(&mut self, dt_s: f64) {
        for number in 0..self.agents.len() {
            let leaves = self.agents[number].is_here()
                && (self.is_over_border(&self.agents[number]) || self.gives_up(number, dt_s));
            if leaves {
                self.take_off(number);
            }
        }
    }

    /// Takes a vehicle off the map for a random time.
    pub(super) fn take_off(&mut self, number: usize) {
        let agent = &mut self.agents[number];
        let share = random::unit(self.seed, number, agent.choices);
        agent.choices += 1;
        agent.away_until_s = Some(self.time_s + AWAY_S_MAX * share);
        self.states[number] = None;
    }

    pub(super) fn is_over_border(&self, agent: &Agent) -> bool {
        let road = self.graph.road(agent.lane());
        agent.here + 1 == agent.path.len() && road.leaves_map && agent.arc_m >= road.line.length_m()
    }

    /// True if a vehicle has waited too long before the end of its lane, or before a crossing
    /// behind which its lane ends.
    fn gives_up(&mut self, number: usize, dt_s: f64) -> bool {
        let agent = &self.agents[number];
        let ends_m = agent.wall_m(&self.graph).unwrap_or(f64::INFINITY);
        let blocked = ends_m - agent.front_m() < MERGE_ROOM_M + 5.0
            || agent.crossing.is_some_and(|crossing| {
                agent.held_up && crossing.to_m + agent.clearance_m() > ends_m
            });
        let agent = &mut self.agents[number];
        agent.merging_s = if blocked && agent.speed_mps < 0.1 {
            agent.merging_s + dt_s
        } else {
            0.0
        };
        agent.merging_s > MERGE_S_MAX
    }

    /// Lets vehicles that are away enter where there is room.
    pub(super) fn enter(&mut self) {
        for number in 0..self.agents.len() {
            let due = |until_s: f64| self.time_s >= until_s;
            if !self.agents[number].away_until_s.is_some_and(due) {
                continue;
            }
            if self.graph.entrances().is_empty() || !self.try_entrance(number) {
                self.agents[number].away_until_s = Some(self.time_s + RETRY_S);
            }
        }
    }

    /// Lets a vehicle enter at a random entrance; false where there is no room.
    fn try_entrance(&mut self, number: usize) -> bool {
        let entrances = self.graph.entrances();
        let away = &mut self.agents[number];
        let chosen = random::way(self.seed, number, away.choices, entrances.len());
        away.choices += 1;
        let mut entering = away.at_start_of(entrances[chosen]);
        entering.extend_path(&self.graph, self.seed);
        if !self.has_room(&entering) {
            return false;
        }
        self.agents[number] = entering;
        self.find_crossing(number);
        let agent = &self.agents[number];
        let free_mps = self.free_speed(agent);
        let speed_mps = free_mps.min(self.safe_speed_mps(agent));
        let agent = &mut self.agents[number];
        (agent.speed_mps, agent.free_mps) = (speed_mps, free_mps);
        self.states[number] = Some(agent.state(&self.graph));
        self.order.build(&self.graph, &self.agents, &self.outsiders);
        self.claims.claim(&self.graph, &self.agents[number]);
        true
    }

    /// True if a vehicle can stand where it is about to enter.
    fn has_room(&self, agent: &Agent) -> bool {
        let at_m = agent.state(&self.graph).position_m;
        let mut egos = self.outsiders.egos.iter();
        let egos_are_far = egos.all(|ego| ego.position_m.distance(at_m) > EGO_M);
        let free = |cell| {
            !self.claims.conflict(&self.graph, cell, agent.number)
                && !self.claims.ego_on(cell)
                && !self.claims.pedestrian_on(cell)
        };
        let mut on_lane = self.order.on(agent.lane()).iter();
        let mut swerves = self.claims.blocks.iter();
        egos_are_far
            && on_lane.all(|entry| entry.rear_m - agent.front_m() > ROOM_M)
            && swerves
                .all(|block| block.lane != agent.lane() || block.from_m - agent.front_m() > ROOM_M)
            && each_cell(
                &self.graph,
                agent,
                agent.rear_m(),
                agent.front_m() + GAP_M,
                free,
            )
    }

    /// Fastest speed from which an agent can stop behind those ahead, before its crossing and
    /// before the end of its lane, m/s.
    pub(super) fn safe_speed_mps(&self, agent: &Agent) -> f64 {
        let mut limit_m = agent.clear_m - 1.0;
        if let Some(crossing) = agent.crossing {
            limit_m = limit_m.min(
                if crossing.granted {
                    crossing.to_m + agent.clearance_m()
                } else {
                    crossing.from_m
                } - 0.1,
            );
        }
        limit_m = limit_m.min(agent.wall_m(&self.graph).unwrap_or(f64::INFINITY) - 0.1);
        for at_m in self.blocks_ahead(agent) {
            limit_m = limit_m.min(at_m - 0.1);
        }
        each_ahead(
            &self.graph,
            &self.order,
            agent.path_position(),
            400.0,
            |seen| {
                limit_m = limit_m.min(seen.stop_rear_m - 2.0 * GAP_M);
                !seen.same_way
            },
        );
        (2.0 * BRAKING_MPS2 * (limit_m - agent.front_m()).max(0.0)).sqrt()
    }
}
