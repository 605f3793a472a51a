//! Start of the traffic: agents are placed on their lanes; impossible ones are refused.

use std::sync::Arc;

use decouplegs_scene::scenario::{Drivers, TrafficAgent};
use decouplegs_scene::{Invalid, VehicleSize, VehicleState};

use super::Traffic;
use super::agent::{Agent, Phase};
use super::claims::{Claims, each_cell};
use super::driver::Driver;
use super::following::{GAP_M, each_ahead};
use super::idm::stopping_m;
use super::lane_order::LaneOrder;
use super::outsider::Outsiders;
use super::watch::Watch;
use crate::oriented_box::OrientedBox;
use crate::polyline::wrapped;
use crate::road_graph::{RoadGraph, length_of};

/// Largest number of rounds in which speeds at the start are raised: a queue of that many vehicles.
const ROUNDS_MAX: usize = 200;

/// Reason why traffic cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrafficError {
    /// The map has no such lane.
    #[error("agent {agent}: lane {lane} is not a driving lane of the map")]
    UnknownLane {
        /// Name of the agent.
        agent: String,
        /// The lane's id.
        lane: String,
    },
    /// A position lies beyond the end of its lane.
    #[error("agent {agent}: {at_m} m along lane {lane}; expected 0 to {length_m:.2}")]
    BeyondLane {
        /// Name of the agent.
        agent: String,
        /// The lane's id.
        lane: String,
        /// Start position.
        at_m: f64,
        /// Length of the lane.
        length_m: f64,
    },
    /// A number is none, or no vehicle's.
    #[error("agent {agent}: {what} of {value}; expected {expected}")]
    NotAVehicle {
        /// Name of the agent.
        agent: String,
        /// Name of the number.
        what: &'static str,
        /// Value that was found.
        value: f64,
        /// Allowed range.
        expected: &'static str,
    },
    /// Two are in each other's way from the start.
    #[error(
        "agents {first} and {second} overlap at the start, or one could not drive without touching the other; move one of them"
    )]
    Overlap {
        /// Name of one agent.
        first: String,
        /// Name of the other agent.
        second: String,
    },
    /// The vehicles are too large for the lanes.
    #[error("{0}")]
    Roads(Invalid),
}

impl Traffic {
    /// Traffic of `agents` on the lanes of `graph`, in the scenario's order. `seed` decides their
    /// ways at crossings.
    ///
    /// A vehicle that could not stop behind the one ahead, or before a crossing that is not free,
    /// starts slower than it asks.
    ///
    /// # Errors
    /// An unknown lane, a position beyond it, a number that is no vehicle's, agents that overlap.
    pub fn new(
        graph: Arc<RoadGraph>,
        agents: &[TrafficAgent],
        seed: u64,
    ) -> Result<Self, TrafficError> {
        agents.iter().try_for_each(check)?;
        let graph = roads_for(graph, agents)?;
        let mut placed = Vec::with_capacity(agents.len());
        for (number, agent) in agents.iter().enumerate() {
            placed.push(place(&graph, number, agent, seed)?);
        }
        let claims = Claims::new(graph.cells().count());
        let mut traffic = Self {
            states: placed
                .iter()
                .map(|agent| Some(agent.state(&graph)))
                .collect(),
            behaviors: agents.iter().map(|agent| agent.behaviors.clone()).collect(),
            graph,
            agents: placed,
            order: LaneOrder::default(),
            claims,
            obstacles: Arc::default(),
            lights: Arc::default(),
            signs: Arc::default(),
            waiting: Vec::new(),
            accelerations: Vec::new(),
            outsiders: Outsiders::default(),
            egos: Vec::new(),
            pedestrians: Vec::new(),
            stage: None,
            tracked: None,
            drivers: Drivers::Kinds,
            classes: Arc::default(),
            bodies: Vec::new(),
            limited: Vec::new(),
            time_s: 0.0,
            steps: 0,
            seed,
        };
        let none = Outsiders::default();
        traffic.order.build(&traffic.graph, &traffic.agents, &none);
        traffic.claims.build(&traffic.graph, &traffic.agents, &none);
        if let Some((first, second)) = traffic.first_overlap() {
            return Err(TrafficError::Overlap {
                first: agents[first].name.clone(),
                second: agents[second].name.clone(),
            });
        }
        if let Some((first, second)) = traffic.first_caught() {
            return Err(TrafficError::Overlap {
                first: agents[first].name.clone(),
                second: agents[second].name.clone(),
            });
        }
        traffic.raise_speeds(agents);
        for agent in &mut traffic.agents {
            agent.free_mps = agent.driver.idm.speed_mps;
            traffic.states[agent.number] = Some(agent.state(&traffic.graph));
        }
        Ok(traffic)
    }

    /// Two agents that stand too near to each other, where all stand.
    fn first_overlap(&self) -> Option<(usize, usize)> {
        for agent in &self.agents {
            let mut other = None;
            each_ahead(
                &self.graph,
                &self.order,
                agent.path_position(),
                60.0,
                |seen| {
                    if seen.rear_m - agent.front_m() < GAP_M {
                        other = Some(seen.agent as usize);
                    }
                    other.is_none()
                },
            );
            each_cell(
                &self.graph,
                agent,
                agent.rear_m(),
                agent.front_m(),
                |cell| {
                    if self.claims.conflict(&self.graph, cell, agent.number) {
                        other = other.or_else(|| self.nearest(agent.number));
                    }
                    other.is_none()
                },
            );
            other = other
                .or_else(|| self.beside_on_fork(agent))
                .or_else(|| self.touching(agent.number));
            if let Some(other) = other {
                return Some((agent.number.min(other), agent.number.max(other)));
            }
        }
        None
    }

    /// Reserves crossings for the agents that stand in them. Returns the first that could not leave
    /// its own, and the agent nearest to it.
    fn first_caught(&mut self) -> Option<(usize, usize)> {
        for number in 0..self.agents.len() {
            let agent = &self.agents[number];
            let found = self.next_crossing(agent, agent.rear_m() - self.between_m());
            let agent = &mut self.agents[number];
            (agent.crossing, agent.clear_m) = found;
        }
        for number in 0..self.agents.len() {
            let agent = &self.agents[number];
            let stands_in = agent.crossing.is_some_and(|crossing| {
                crossing.from_m < agent.front_m() && crossing.to_m > agent.rear_m()
            });
            if stands_in && !self.grant_at_start(number) {
                let other = self.nearest(number).unwrap_or(number);
                return Some((number.min(other), number.max(other)));
            }
        }
        for number in 0..self.agents.len() {
            let agent = &self.agents[number];
            if agent.crossing.is_none_or(|crossing| !crossing.granted) {
                let found = self.next_crossing(agent, agent.stop_m());
                let agent = &mut self.agents[number];
                (agent.crossing, agent.clear_m) = found;
            }
        }
        None
    }

    /// Vehicle on another lane of a fork that is neither ahead of an agent nor behind it.
    fn beside_on_fork(&self, agent: &Agent) -> Option<usize> {
        self.graph
            .road(agent.lane())
            .forks
            .iter()
            .filter(|fork| agent.rear_m() < fork.to_m)
            .find_map(|fork| {
                let back = self
                    .graph
                    .road(fork.other)
                    .forks
                    .iter()
                    .find(|back| back.other == agent.lane())?;
                let beside = |other: &&Agent| {
                    let apart_m = (other.arc_m - agent.arc_m).abs() - other.half_m - agent.half_m;
                    other.lane() == fork.other
                        && other.rear_m() < back.to_m
                        && apart_m < fork.lead_m.max(back.lead_m) + GAP_M
                };
                self.agents.iter().find(beside).map(|other| other.number)
            })
    }

    /// Vehicle whose box overlaps an agent's.
    fn touching(&self, number: usize) -> Option<usize> {
        let at_m = self.state_at_start(number).position_m;
        let outline = |number: usize| {
            OrientedBox::for_vehicle(&self.state_at_start(number), &self.agents[number].size)
        };
        let near_m =
            |other: usize| self.agents[number].size.length_m + self.agents[other].size.length_m;
        let near = |&other: &usize| {
            other != number && self.state_at_start(other).position_m.distance(at_m) < near_m(other)
        };
        (0..self.agents.len())
            .filter(near)
            .find(|&other| outline(number).distance_m(&outline(other)) < 0.1)
    }

    /// State of an agent before the first step.
    fn state_at_start(&self, number: usize) -> VehicleState {
        self.agents[number].state(&self.graph)
    }

    /// The agent whose box is nearest to another's.
    fn nearest(&self, number: usize) -> Option<usize> {
        let outline = |number: usize| {
            OrientedBox::for_vehicle(&self.state_at_start(number), &self.agents[number].size)
        };
        let own = outline(number);
        let others = (0..self.agents.len()).filter(|&other| other != number);
        others
            .map(|other| (own.distance_m(&outline(other)), other))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|found| found.1)
    }

    /// Raises each agent's speed to its requested one, or to the fastest that is safe behind slow
    /// leaders. In every round no agent is slower than before, so safe states stay safe.
    fn raise_speeds(&mut self, asked: &[TrafficAgent]) {
        let none = Outsiders::default();
        for _ in 0..ROUNDS_MAX {
            let mut raised = false;
            for (number, asked) in asked.iter().enumerate() {
                self.find_crossing(number);
                let crossed_m = self.agents[number]
                    .crossing
                    .map_or(f64::INFINITY, |crossing| crossing.from_m);
                let wants_m = self.agents[number].front_m() + stopping_m(asked.speed_mps);
                if wants_m > crossed_m - 1.0 {
                    self.grant_at_start(number);
                }
                let agent = &self.agents[number];
                let speed_mps = asked.speed_mps.min(self.safe_speed_mps(agent));
                if speed_mps > agent.speed_mps + 1e-3 {
                    self.agents[number].speed_mps = speed_mps;
                    raised = true;
                }
            }
            self.order.build(&self.graph, &self.agents, &none);
            self.claims.build(&self.graph, &self.agents, &none);
            if !raised {
                break;
            }
        }
    }
}

fn check(agent: &TrafficAgent) -> Result<(), TrafficError> {
    let numbers = [
        ("a length", agent.size.length_m, 0.5..=25.0, "0.5 to 25 m"),
        ("a width", agent.size.width_m, 0.3..=4.0, "0.3 to 4 m"),
        ("a height", agent.size.height_m, 0.1..=10.0, "0.1 to 10 m"),
        ("a speed", agent.speed_mps, 0.0..=70.0, "0 to 70 m/s"),
    ];
    for (what, value, range, expected) in numbers {
        if !range.contains(&value) {
            return Err(TrafficError::NotAVehicle {
                agent: agent.name.clone(),
                what,
                value,
                expected,
            });
        }
    }
    Ok(())
}

/// The graph, or one for larger vehicles where some are.
fn roads_for(
    graph: Arc<RoadGraph>,
    agents: &[TrafficAgent],
) -> Result<Arc<RoadGraph>, TrafficError> {
    let mut largest = graph.vehicle();
    for VehicleSize {
        length_m, width_m, ..
    } in agents.iter().map(|agent| agent.size)
    {
        (largest.length_m, largest.width_m) =
            (largest.length_m.max(length_m), largest.width_m.max(width_m));
    }
    if largest == graph.vehicle() {
        return Ok(graph);
    }
    let graph = Arc::try_unwrap(graph).unwrap_or_else(|graph| (*graph).clone());
    graph
        .for_vehicle(largest)
        .map(Arc::new)
        .map_err(TrafficError::Roads)
}

/// An agent on its lane, standing, its path known.
fn place(
    graph: &RoadGraph,
    number: usize,
    agent: &TrafficAgent,
    seed: u64,
) -> Result<Agent, TrafficError> {
    let unknown = || TrafficError::UnknownLane {
        agent: agent.name.clone(),
        lane: agent.lane.clone(),
    };
    let lane = graph.find(&agent.lane).ok_or_else(unknown)?;
    let length_m = length_of(graph.lanes(), lane);
    if !(0.0..=length_m).contains(&agent.at_m) {
        let (name, lane) = (agent.name.clone(), agent.lane.clone());
        return Err(TrafficError::BeyondLane {
            agent: name,
            lane,
            at_m: agent.at_m,
            length_m,
        });
    }
    let mut placed = Agent::new(
        number,
        agent.size,
        Driver::new(agent.kind, agent.driver),
        lane,
        agent.at_m,
    );
    placed.changes_lanes = agent.changes_lanes;
    placed.cruise_mps = agent.cruise_mps;
    placed.phases = vec![Phase::Waiting(Watch::default()); agent.behaviors.len()];
    // Its rear may be on the lane before: the one that bends least.
    let mut behind_m = agent.at_m;
    while behind_m < placed.half_m + 2.0 {
        let road = graph.road(placed.path[0]);
        let bend = |&lane: &usize| {
            let line = &graph.road(lane).line;
            wrapped(line.heading_at(line.length_m()) - road.line.heading_at(0.0)).abs()
        };
        let Some(&before) = road
            .predecessors
            .iter()
            .min_by(|a, b| bend(a).total_cmp(&bend(b)))
        else {
            break;
        };
        placed.path.insert(0, before);
        placed.here += 1;
        behind_m += length_of(graph.lanes(), before);
        if placed.here > 32 {
            break;
        }
    }
    placed.extend_path(graph, seed);
    Ok(placed)
}
