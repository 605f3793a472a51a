//! Agents that another program drives, in place of the driver model.
//!
//! From its first command on such an agent is on no lane's list any more: it moves freely, within
//! what physics allow, and all others see it as they see the ego. Nothing keeps it from touching
//! them. In steps without a command it drives along its way by the intelligent driver model.

use decouplegs_scene::episode::AgentCommand;
use decouplegs_scene::{Invalid, LightColor, VehicleSize, VehicleState};
use glam::DVec2;

use super::body::Body;
use super::idm::{IdmParameters, Leader};
use super::tracked::Followers;
use super::way_ahead::{AgentLeader, SeenUser, WayAhead};
use super::{EgoBox, Traffic};
use crate::polyline::wrapped;
use crate::road_graph::{length_of, position_on};
use crate::story::Stage;

/// Spacing of the points of a way in a message to the driver, meters, and their number.
const WAY_SPACING_M: f64 = 5.0;
const WAY_POINTS: usize = 21;
/// Half of the length over which the bend of a way is measured, meters.
const HALF_BEND_M: f64 = 4.0;
/// Braking for a yellow light, m/s^2: who would need more drives on.
const YELLOW_MPS2: f64 = 3.0;
/// Distance before a stop line at which a vehicle stands, meters.
const LINE_GAP_M: f64 = 1.0;
/// A lane beside that is nearer by this is the own one, meters.
const NEARER_M: f64 = 0.3;
/// Part of a lane within which the place of a vehicle is looked for, meters.
const SEARCH_M: f64 = 15.0;

/// Driver of an agent at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrivenBy {
    /// Driver model.
    Model,
    /// Recorded track.
    Track,
    /// Commands of another program.
    Commands,
}

impl DrivenBy {
    /// Name in the protocol.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Track => "track",
            Self::Commands => "commands",
        }
    }
}

/// Vehicle of the traffic that takes commands, as its driver sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct SteerableAgent {
    /// Index in the scenario.
    pub agent: usize,
    /// State of its box.
    pub state: VehicleState,
    /// Size of its box.
    pub size: VehicleSize,
    /// Driver up to now.
    pub driven_by: DrivenBy,
    /// Points of its way, 5 m apart, from beside its middle to 100 m ahead, world coordinates.
    pub way_m: Vec<DVec2>,
    /// Offset from its way, meters, positive to the left.
    pub offset_m: f64,
    /// Heading against that of its way, radians, positive to the left.
    pub turn_rad: f64,
    /// Speed limit of its lane, m/s; `None` where the map tells none, and on recorded tracks.
    pub limit_mps: Option<f64>,
    /// First road user on its way.
    pub leader: Option<AgentLeader>,
    /// Distance from its front to the next stop line of a light that is not green, meters; `None`
    /// without one, and on recorded tracks.
    pub stop_m: Option<f64>,
}

/// Vehicle of a lane that takes commands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steered {
    pub body: Body,
    /// Command of the present step.
    pub command: Option<AgentCommand>,
}

/// View of a vehicle on its way; `place` gives position and heading by meters ahead.
pub(super) fn steerable_agent(
    (agent, state, size, driven_by): (usize, &VehicleState, &VehicleSize, DrivenBy),
    place: impl Fn(f64) -> (DVec2, f64),
    others: &[SeenUser],
) -> SteerableAgent {
    let (own_m, yaw_rad) = place(0.0);
    let way = WayAhead::new(|ahead_m| place(ahead_m).0);
    SteerableAgent {
        agent,
        state: *state,
        size: *size,
        driven_by,
        way_m: (0..WAY_POINTS)
            .map(|at| place(WAY_SPACING_M * at as f64).0)
            .collect(),
        offset_m: DVec2::from_angle(yaw_rad).perp_dot(state.position_m - own_m),
        turn_rad: wrapped(state.yaw_rad - yaw_rad),
        limit_mps: None,
        leader: way.and_then(|way| way.leader(agent, (state, size), others)),
        stop_m: None,
    }
}

/// Curvature of a way beside its vehicle, 1/m.
pub(super) fn bend_of(place: impl Fn(f64) -> (DVec2, f64)) -> f64 {
    wrapped(place(HALF_BEND_M).1 - place(-HALF_BEND_M).1) / (2.0 * HALF_BEND_M)
}

impl Traffic {
    /// Index of the first road user on a recorded track.
    fn first_tracked(&self) -> usize {
        let actors = self.stage.iter().flat_map(Stage::states).count();
        self.agents.len() + self.pedestrians.len() + actors
    }

    /// All road users as others see them.
    fn seen_users(&self, egos: &[EgoBox]) -> Vec<SeenUser> {
        let egos = egos.iter().flatten();
        let egos = egos.map(|(state, size)| (None, *state, *size));
        let agents = self.agents.iter().map(|agent| agent.size);
        let walkers = self.pedestrians.iter().map(|walker| walker.size());
        let on_ways = self.states.iter().copied().zip(agents.chain(walkers));
        let on_ways = on_ways.map(|(state, size)| Some((state?, size)));
        let actors = self.stage.iter().flat_map(Stage::all);
        let tracked = self.tracked.iter().flat_map(Followers::all);
        let all = on_ways.chain(actors).chain(tracked).enumerate();
        let there = all.filter_map(|(at, user)| user.map(|(state, size)| (Some(at), state, size)));
        egos.chain(there).collect()
    }

    /// Vehicles that take commands now, in ascending order: those on lanes and those on recorded
    /// tracks. Pedestrians and actors of a story take none.
    #[must_use]
    pub fn steerable(&self, egos: &[EgoBox]) -> Vec<SteerableAgent> {
        let others = self.seen_users(egos);
        let on_lanes = self.agents.iter().zip(&self.states).enumerate();
        let on_lanes = on_lanes.filter_map(|(number, (agent, state))| {
            let state = (*state)?;
            let driven_by = match self.bodies.get(number) {
                Some(Some(_)) => DrivenBy::Commands,
                _ => DrivenBy::Model,
            };
            let place = |ahead_m: f64| self.place_ahead(number, ahead_m);
            let who = (number, &state, &agent.size, driven_by);
            let road = self.graph.road(agent.lane());
            Some(SteerableAgent {
                limit_mps: road.has_limit.then_some(road.speed_limit_mps),
                stop_m: self.next_stop(number).map(|(stop_m, _)| stop_m),
                ..steerable_agent(who, place, &others)
            })
        });
        let mut all: Vec<SteerableAgent> = on_lanes.collect();
        if let Some(tracked) = &self.tracked {
            all.extend(tracked.steerable(self.time_s, self.first_tracked(), &others));
        }
        all
    }

    /// Sets the commands until this is called again. Agents that had one before and have none now
    /// drive on by the model.
    ///
    /// # Errors
    /// A sentence, if an agent takes no commands now, has two, or a number is not finite. Nothing
    /// is changed then.
    pub fn steer(&mut self, commands: &[AgentCommand]) -> Result<(), Invalid> {
        self.check_commands(commands)?;
        for steered in self.bodies.iter_mut().flatten() {
            steered.command = None;
        }
        let first = self.first_tracked();
        if let Some(tracked) = &mut self.tracked {
            tracked.clear_commands();
        }
        for command in commands {
            match (command.agent.checked_sub(first), &mut self.tracked) {
                (Some(at), Some(tracked)) => tracked.steer(at, *command, self.time_s),
                _ => self.steer_on_lane(*command),
            }
        }
        Ok(())
    }

    /// Checks that agents take their commands now, have one each, and that numbers are finite.
    fn check_commands(&self, commands: &[AgentCommand]) -> Result<(), Invalid> {
        let mut has_command = vec![false; self.states.len()];
        for command in commands {
            let agent = command.agent;
            if !self.takes_commands(agent) {
                return Err(Invalid::new(format!(
                    "agent {agent} takes no commands now; expected one of the agents that were told of"
                )));
            }
            if std::mem::replace(&mut has_command[agent], true) {
                return Err(Invalid::new(format!("agent {agent} has two commands")));
            }
            let curvature_per_m = command.curvature_per_m.unwrap_or(0.0);
            if !command.acceleration_mps2.is_finite() || !curvature_per_m.is_finite() {
                return Err(Invalid::new(format!(
                    "the command to agent {agent} has a number that is not finite"
                )));
            }
        }
        Ok(())
    }

    /// True if an agent takes commands now.
    fn takes_commands(&self, agent: usize) -> bool {
        let is_there = self.states.get(agent).is_some_and(Option::is_some);
        let tracked = agent.checked_sub(self.first_tracked());
        is_there
            && match (tracked, &self.tracked) {
                (Some(at), Some(tracked)) => tracked.takes_commands(at),
                _ => agent < self.agents.len(),
            }
    }

    fn steer_on_lane(&mut self, command: AgentCommand) {
        let number = command.agent;
        self.bodies.resize(self.agents.len(), None);
        if self.bodies[number].is_none() {
            let bend_per_m = bend_of(|ahead_m| self.place_ahead(number, ahead_m));
            let Some(state) = self.states[number] else {
                return;
            };
            let agent = &mut self.agents[number];
            // On no lane's list, and with no place in a crossing.
            agent.away_until_s = Some(f64::INFINITY);
            (agent.aside, agent.crossing, agent.brake) = (None, None, None);
            agent.emergency = false;
            let body = Body::new(state, &agent.size, bend_per_m);
            self.bodies[number] = Some(Steered {
                body,
                command: None,
            });
        }
        if let Some(steered) = &mut self.bodies[number] {
            steered.command = Some(command);
        }
    }

    /// Agents with commands since this was asked last that were more than a vehicle can do, in
    /// ascending order.
    pub fn take_limited(&mut self) -> Vec<usize> {
        let mut limited = std::mem::take(&mut self.limited);
        let first = self.first_tracked();
        if let Some(tracked) = &mut self.tracked {
            limited.extend(tracked.take_limited().into_iter().map(|at| first + at));
        }
        limited.sort_unstable();
        limited.dedup();
        limited
    }

    /// Position and heading of the way of an agent on lanes, by meters ahead of it.
    fn place_ahead(&self, number: usize, ahead_m: f64) -> (DVec2, f64) {
        let agent = &self.agents[number];
        let lanes = self.graph.lanes();
        let place = position_on(lanes, &agent.path, agent.here, agent.arc_m + ahead_m);
        (place.position_m, place.yaw_rad)
    }

    /// Distance from the front of an agent on lanes to the next stop line of a light that is not
    /// green, meters, and its color.
    fn next_stop(&self, number: usize) -> Option<(f64, LightColor)> {
        let agent = &self.agents[number];
        let mut start_m = -agent.front_m();
        for (at, &lane) in agent.path.iter().enumerate().skip(agent.here) {
            let next = agent.path.get(at + 1).copied();
            for line in self.lights.on(lane) {
                let ahead_m = start_m + line.at_m;
                let color = self.lights.color_at(line.record.index, self.time_s);
                if ahead_m >= 0.0 && line.binds(next) && color != LightColor::Green {
                    return Some((ahead_m, color));
                }
            }
            start_m += length_of(self.graph.lanes(), lane);
        }
        None
    }

    /// Boxes of agents on lanes that take commands.
    pub(super) fn body_boxes(&self) -> impl Iterator<Item = (VehicleState, VehicleSize)> {
        let bodies = self.bodies.iter().zip(&self.agents);
        bodies.filter_map(|(steered, agent)| Some((steered.as_ref()?.body.state, agent.size)))
    }

    /// Accelerations of agents on lanes that take commands but have none now, by the model.
    pub(super) fn decide_bodies(&self, egos: &[EgoBox]) -> Vec<(usize, f64)> {
        let free = self.bodies.iter().enumerate();
        let free: Vec<(usize, &Steered)> = free
            .filter_map(|(number, steered)| Some((number, steered.as_ref()?)))
            .filter(|(_, steered)| steered.command.is_none())
            .collect();
        if free.is_empty() {
            return Vec::new();
        }
        let others = self.seen_users(egos);
        let decided = free.into_iter().map(|(number, steered)| {
            let agent = &self.agents[number];
            let state = &steered.body.state;
            let way = WayAhead::new(|ahead_m| self.place_ahead(number, ahead_m).0);
            let leader = way.and_then(|way| way.leader(number, (state, &agent.size), &others));
            let leader = leader.map(|leader| Leader {
                gap_m: leader.gap_m,
                speed_mps: leader.speed_mps,
            });
            let idm = IdmParameters {
                speed_mps: self.free_speed(agent),
                ..agent.idm()
            };
            let stands = |gap_m: f64| Leader {
                gap_m: gap_m - LINE_GAP_M + idm.standstill_gap_m,
                speed_mps: 0.0,
            };
            let light = self.next_stop(number).filter(|&(stop_m, color)| {
                let needed_mps2 = state.speed_mps.powi(2) / (2.0 * stop_m.max(0.01));
                color == LightColor::Red || needed_mps2 <= YELLOW_MPS2
            });
            let wall = agent.wall_m(&self.graph);
            let ends = [
                leader,
                light.map(|(stop_m, _)| stands(stop_m)),
                wall.map(|wall_m| stands(wall_m - agent.front_m())),
            ];
            let wishes = ends.map(|end| idm.acceleration(state.speed_mps, end));
            (number, wishes.into_iter().fold(f64::INFINITY, f64::min))
        });
        decided.collect()
    }

    /// Moves agents on lanes that take commands; `decided` are the accelerations of those without
    /// one.
    pub(super) fn step_bodies(&mut self, decided: &[(usize, f64)], dt_s: f64) {
        for number in 0..self.bodies.len() {
            let Some(mut steered) = self.bodies[number] else {
                continue;
            };
            let body = &mut steered.body;
            let target_m = self.place_ahead(number, body.look_ahead_m()).0;
            let keeps_per_m = body.curvature_to(target_m);
            let is_limited = match steered.command {
                Some(command) => body.obey(&command, keeps_per_m, dt_s),
                None => {
                    let decided = decided.iter().find(|(at, _)| *at == number);
                    let acceleration_mps2 = decided.map_or(0.0, |(_, found_mps2)| *found_mps2);
                    body.advance(acceleration_mps2, keeps_per_m, dt_s);
                    false
                }
            };
            if is_limited {
                self.limited.push(number);
            }
            let state = steered.body.state;
            self.bodies[number] = Some(steered);
            self.states[number] = Some(state);
            self.find_lane(number, &state);
            if self.is_over_border(&self.agents[number]) {
                self.bodies[number] = None;
                self.take_off(number);
            }
        }
    }

    /// Offset of an agent in `state` from the middle of its lane, meters, positive to the left.
    pub(super) fn lateral_m(&self, number: usize, state: &VehicleState) -> f64 {
        let (middle_m, yaw_rad) = self.place_ahead(number, 0.0);
        DVec2::from_angle(yaw_rad).perp_dot(state.position_m - middle_m)
    }

    /// Finds the place of an agent that moves freely on its way, or on a lane beside it.
    fn find_lane(&mut self, number: usize, state: &VehicleState) {
        let graph = self.graph.clone();
        let project = |lane: usize, near_m: f64| {
            let line = &graph.road(lane).line;
            line.project_within(state.position_m, near_m - SEARCH_M, near_m + SEARCH_M)
        };
        let agent = &mut self.agents[number];
        (agent.speed_mps, agent.acceleration_mps2) = (state.speed_mps, state.acceleration_mps2);
        let mut foot = project(agent.lane(), agent.arc_m);
        let road = graph.road(agent.lane());
        for beside in [road.left, road.right].into_iter().flatten() {
            let other = project(beside, foot.arc_m);
            if other.distance_m + NEARER_M < foot.distance_m {
                (agent.path, agent.here) = (vec![beside], 0);
                foot = other;
            }
        }
        agent.arc_m = foot.arc_m;
        while agent.here + 1 < agent.path.len() {
            let length_m = length_of(graph.lanes(), agent.lane());
            if agent.arc_m < length_m - 1e-9 {
                break;
            }
            agent.here += 1;
            agent.arc_m = project(agent.lane(), 0.0).arc_m;
        }
        agent.extend_path(&graph, self.seed);
    }
}
