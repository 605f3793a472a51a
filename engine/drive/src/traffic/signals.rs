//! Traffic lights and stop signs as agents obey them.

use super::Traffic;
use super::agent::Agent;
use super::following::LINE_M;
use crate::road_graph::{Conflict, length_of};
use decouplegs_scene::{LightColor, SignKind};

/// An agent stops at yellow where it can with this braking, m/s^2. At 15 m/s it then passes the
/// line within a yellow of 3 seconds or stops.
const BRAKING_MPS2: f64 = 2.5;
/// Stop lines are seen from this distance at least, meters, and this many seconds away.
const SEEN_M: f64 = 60.0;
const SEEN_S: f64 = 6.0;

/// Upper limits of the speed, m/s, and of the distance to the line, meters, of a stopped vehicle.
pub(super) const STANDING_MPS: f64 = 0.1;
const AT_LINE_M: f64 = 3.0;

/// Next stop line with a traffic light on an agent's path. Positions are meters from the start of
/// the agent's lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct NextLight {
    /// The nearest line, of whatever color.
    pub line_m: f64,
    /// Place before which the agent stops because a light is not green.
    pub hold_m: Option<f64>,
}

/// Stop sign ahead, meters from the start of the agent's lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct NextSign {
    /// Index of the sign in the scenario.
    pub sign: usize,
    /// Place before which the agent stops.
    pub hold_m: f64,
}

impl NextSign {
    /// True if a vehicle has stopped at the sign.
    pub(super) fn is_stood_at(&self, agent: &Agent) -> bool {
        agent.speed_mps < STANDING_MPS && self.hold_m - agent.front_m() < AT_LINE_M
    }
}

impl Traffic {
    /// The next stop line with a light on an agent's path.
    pub(super) fn next_light(&self, agent: &Agent) -> Option<NextLight> {
        if self.lights.is_empty() {
            return None;
        }
        let (front_m, stop_m) = (agent.front_m(), agent.stop_m());
        let comfortable_m = front_m + agent.speed_mps * agent.speed_mps / (2.0 * BRAKING_MPS2);
        let was_held = agent.light.is_some_and(|light| light.hold_m.is_some());
        let seen_m = front_m + SEEN_M + SEEN_S * agent.speed_mps;
        let mut next: Option<NextLight> = None;
        let mut start_m = 0.0;
        for (at, &lane) in agent.path.iter().enumerate().skip(agent.here) {
            let onward = agent.path.get(at + 1).copied();
            for line in self.lights.on(lane) {
                let line_m = start_m + line.at_m;
                if self.waits_over(agent, line_m, line.record.index) && line.binds(onward) {
                    let hold_m = Some(front_m + LINE_M);
                    return Some(NextLight { line_m, hold_m });
                }
                if line_m < front_m || !line.binds(onward) {
                    continue;
                }
                let next = next.get_or_insert(NextLight {
                    line_m,
                    hold_m: None,
                });
                let color = self.lights.color_at(line.record.index, self.time_s);
                let stops = |place_m: f64| match color {
                    LightColor::Green => false,
                    LightColor::Yellow if !was_held => comfortable_m <= place_m - LINE_M,
                    LightColor::Yellow | LightColor::Red => stop_m <= place_m - LINE_M,
                };
                let places_m = [self.before_crossing(agent, line_m), line_m];
                next.hold_m = places_m.into_iter().find(|&place_m| stops(place_m));
                if next.hold_m.is_some() {
                    return Some(*next);
                }
            }
            start_m += length_of(self.graph.lanes(), lane);
            if start_m > seen_m {
                break;
            }
        }
        next
    }

    /// True if an agent has stood over a line since the start and waits there for its light.
    fn waits_over(&self, agent: &Agent, line_m: f64, light: usize) -> bool {
        agent.stands_since_start
            && (agent.rear_m()..agent.front_m()).contains(&line_m)
            && self.lights.color_at(light, self.time_s) != LightColor::Green
    }

    /// The next stop sign on an agent's path before which the agent has not stood yet.
    pub(super) fn next_stop_sign(&self, agent: &Agent) -> Option<NextSign> {
        let (front_m, stop_m) = (agent.front_m(), agent.stop_m());
        let seen_m = front_m + SEEN_M + SEEN_S * agent.speed_mps;
        let mut start_m = 0.0;
        for &lane in &agent.path[agent.here..] {
            for line in self.signs.on(lane) {
                let (sign, line_m) = (line.record.index, start_m + line.at_m);
                let is_due = self.signs.kind(sign) == SignKind::Stop
                    && line_m >= front_m
                    && agent.stood_at != Some(sign);
                let places_m = [self.before_crossing(agent, line_m), line_m];
                let mut places_m = places_m.into_iter().filter(|_| is_due);
                // One too near to stop before is passed: the agent started there.
                if let Some(hold_m) = places_m.find(|&place_m| stop_m <= place_m - LINE_M) {
                    return Some(NextSign { sign, hold_m });
                }
            }
            start_m += length_of(self.graph.lanes(), lane);
            if start_m > seen_m {
                break;
            }
        }
        None
    }

    /// True if an agent on a lane gives way at a conflict, by signs or else by the map.
    pub(super) fn has_to_give_way(&self, lane: usize, conflict: &Conflict) -> bool {
        match (
            self.signs.is_minor(lane),
            self.signs.is_minor(conflict.other),
        ) {
            (true, false) => true,
            (false, true) => false,
            _ => !conflict.goes_first,
        }
    }

    /// The position to stop for a line: before the crossing, if the line is in it or so near behind
    /// it that the vehicle would stand in it.
    fn before_crossing(&self, agent: &Agent, line_m: f64) -> f64 {
        match agent.crossing {
            Some(crossing)
                if crossing.from_m < line_m && line_m < crossing.to_m + agent.clearance_m() =>
            {
                crossing.from_m
            }
            _ => line_m,
        }
    }

    /// The last stop line on a lane whose light is red for vehicles that go on to `onward`, meters
    /// along the lane.
    pub(super) fn red_line(&self, lane: usize, onward: Option<usize>) -> Option<f64> {
        let mut lines = self.lights.on(lane).iter().rev();
        let red = lines.find(|line| {
            line.binds(onward)
                && self.lights.color_at(line.record.index, self.time_s) == LightColor::Red
        });
        red.map(|line| line.at_m)
    }
}
