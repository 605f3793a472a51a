//! Vehicles that are put elsewhere on the map.

use glam::DVec2;

use super::Traffic;
use super::agent::Agent;
use super::claims::each_cell;
use super::following::GAP_M;
use super::lane_change::Target;
use crate::oriented_box::OrientedBox;

/// Distance from the middle of a lane within which a vehicle is put on it, meters.
const ON_LANE_M: f64 = 2.5;
/// Distance to the next crossing beyond where it can stop, meters.
const CROSSING_M: f64 = 2.0;

impl Traffic {
    /// Puts an agent onto the lane at `point_m`, at its speed, if there is room. `None` if no lane
    /// is there, otherwise true if it was put there.
    pub(super) fn teleport(&mut self, number: usize, point_m: DVec2) -> Option<bool> {
        let (lane, arc_m) = self.lane_at(point_m)?;
        let old = &self.agents[number];
        let mut placed = Agent {
            speed_mps: old.speed_mps,
            brake: old.brake,
            ..old.at_start_of(lane)
        };
        placed.arc_m = arc_m.max(placed.arc_m);
        placed.extend_path(&self.graph, self.seed);
        if !self.has_room_at(&placed) {
            return Some(false);
        }
        self.agents[number] = placed;
        self.find_crossing(number);
        let agent = &self.agents[number];
        let free_mps = self.free_speed(agent);
        let speed_mps = agent.speed_mps.min(self.safe_speed_mps(agent));
        let agent = &mut self.agents[number];
        (agent.speed_mps, agent.free_mps) = (speed_mps, free_mps);
        self.states[number] = Some(agent.state(&self.graph));
        self.order.build(&self.graph, &self.agents, &self.outsiders);
        self.claims.claim(&self.graph, &self.agents[number]);
        Some(true)
    }

    /// The lane whose middle is nearest to a point, and the position along it, meters.
    fn lane_at(&self, point_m: DVec2) -> Option<(usize, f64)> {
        let near = OrientedBox {
            center_m: point_m,
            yaw_rad: 0.0,
            half_length_m: ON_LANE_M,
            half_width_m: ON_LANE_M,
        };
        let mut cells = Vec::new();
        self.graph.cells().touched(&near, &mut cells);
        let mut lanes: Vec<usize> = cells
            .iter()
            .map(|&cell| self.graph.cells().stretch_of(cell as usize).0)
            .collect();
        lanes.sort_unstable();
        lanes.dedup();
        let feet = lanes.into_iter().map(|lane| {
            let line = &self.graph.road(lane).line;
            let arc_m = line.project(point_m).arc_m;
            (line.at(arc_m).truncate().distance(point_m), lane, arc_m)
        });
        let (apart_m, lane, arc_m) = feet.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (apart_m <= ON_LANE_M).then_some((lane, arc_m))
    }

    /// True if a vehicle that appears leaves all others the room to stop, and can stop itself
    /// before the next crossing.
    fn has_room_at(&self, agent: &Agent) -> bool {
        let (from_m, to_m) = (agent.rear_m(), agent.stop_m() + GAP_M);
        let (crossing, _) = self.next_crossing(agent, from_m);
        let free = |cell| {
            !self.claims.conflict(&self.graph, cell, agent.number)
                && !self.claims.ego_on(cell)
                && !self.claims.pedestrian_on(cell)
        };
        let mut swerves = self.claims.blocks.iter();
        let target = Target {
            lane: agent.lane(),
            arc_m: agent.arc_m,
            length_m: 0.0,
        };
        crossing.is_none_or(|crossing| crossing.from_m > to_m + CROSSING_M)
            && swerves.all(|block| {
                block.lane != agent.lane() || block.from_m > to_m || block.to_m < from_m - GAP_M
            })
            && each_cell(&self.graph, agent, from_m, to_m, free)
            && self.is_safe(agent, &target, true)
    }
}
