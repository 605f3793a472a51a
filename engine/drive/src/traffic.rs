//! Traffic: agents that follow, change lanes, give way and now and then misbehave, on the driving
//! lanes of a map.
//!
//! What keeps agents apart is built in, not repaired. Each knows where its front would be if it
//! braked as hard as tires allow ([`idm::BRAKING_MPS2`]). Behind another on its path, that
//! position never passes the one where the other's rear could come to a stand. It never passes a
//! conflict with another lane unless the conflict is its own (`claims`, `junction`). A vehicle that
//! brakes as hard as that keeps all of it true, so there is always a way to go on. The models (IDM,
//! MOBIL) drive within these bounds.
//!
//! All agents see the egos, but none is kept from one: an agent that cannot stop for it hits it.
//!
//! Everything follows from the agents, the seed and the ego's motion, bit by bit.

mod agent;
mod behavior;
pub mod body;
mod boundary;
mod claims;
mod drawn;
pub mod driver;
mod drivers;
mod following;
mod free_speed;
pub mod idm;
mod junction;
mod lane_change;
mod lane_order;
pub mod mobil;
mod on_tracks;
mod outsider;
mod pedestrian;
mod random;
mod relaxation;
mod signals;
mod start;
mod steered;
mod teleport;
mod tracked;
mod watch;
mod way_ahead;

use std::sync::Arc;

use decouplegs_scene::episode::LightChangeRecord;
use decouplegs_scene::scenario::{Behavior, Drivers, Scenario};
use decouplegs_scene::{Egos, Invalid, LaneMap, Pedestrian, Story, VehicleSize, VehicleState};
use glam::DVec2;

use crate::lights::TrafficLights;
use crate::obstacles::Obstacles;
use crate::oriented_box::OrientedBox;
use crate::road_graph::RoadGraph;
use crate::signs::TrafficSigns;
use crate::story::Stage;
use agent::{Agent, AsideKind};
use claims::Claims;
use free_speed::LaneClass;
use lane_order::LaneOrder;
use outsider::{Outsider, Outsiders};
use pedestrian::{Vehicle, Walker};
use steered::Steered;
use tracked::Followers;

pub use start::TrafficError;
pub use steered::{DrivenBy, SteerableAgent};
pub use way_ahead::AgentLeader;

/// Position of an agent on the lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LanePosition {
    /// Place in the map's list of lanes. A vehicle that changes lanes counts on the target lane
    /// from the start of the maneuver.
    pub lane: usize,
    /// Position along the lane, meters.
    pub arc_m: f64,
    /// Offset from the middle of the lane, meters, positive to the left.
    pub lateral_m: f64,
}

/// State and size of an ego; `None` while it is not on the road.
pub type EgoBox = Option<(VehicleState, VehicleSize)>;

/// All agents of an episode.
#[derive(Clone, Debug)]
pub struct Traffic {
    graph: Arc<RoadGraph>,
    agents: Vec<Agent>,
    behaviors: Vec<Vec<Behavior>>,
    states: Vec<Option<VehicleState>>,
    order: LaneOrder,
    claims: Claims,
    obstacles: Arc<Obstacles>,
    lights: Arc<TrafficLights>,
    signs: Arc<TrafficSigns>,
    /// Waiting times at crossings, and accelerations of all agents: scratch buffers.
    waiting: Vec<u32>,
    accelerations: Vec<(f64, bool)>,
    outsiders: Outsiders,
    /// States of the egos, for triggers.
    egos: Vec<VehicleState>,
    pedestrians: Vec<Walker>,
    /// Actors, if there are any.
    stage: Option<Stage>,
    /// Road users on recorded tracks, if there are any.
    tracked: Option<Followers>,
    drivers: Drivers,
    /// Classes of lanes; empty where limits alone count.
    classes: Arc<Vec<LaneClass>>,
    /// Agents on lanes that another program drives; empty where none does.
    bodies: Vec<Option<Steered>>,
    /// Agents with commands that were more than a vehicle can do, not yet collected.
    limited: Vec<usize>,
    time_s: f64,
    steps: u64,
    seed: u64,
}

impl Traffic {
    /// Adds static obstacles, into which no vehicle swerves.
    #[must_use]
    pub fn among(mut self, obstacles: Arc<Obstacles>) -> Self {
        self.obstacles = obstacles;
        self
    }

    /// Adds traffic lights, which agents obey, before the story that directs them. Their lanes are
    /// those of the traffic's graph.
    #[must_use]
    pub fn with_lights(mut self, lights: Arc<TrafficLights>) -> Self {
        self.lights = lights;
        self
    }

    /// Traffic lights as they are now.
    #[must_use]
    pub fn lights(&self) -> &TrafficLights {
        &self.lights
    }

    /// Takes the changes of traffic lights since this was asked last.
    pub fn take_light_changes(&mut self) -> Vec<LightChangeRecord> {
        let stage = self.stage.as_mut();
        stage.map_or_else(Vec::new, Stage::take_light_changes)
    }

    /// True once the conditions of the story's end have held.
    #[must_use]
    pub fn story_is_over(&self) -> bool {
        self.stage.as_ref().is_some_and(Stage::is_over)
    }

    /// Adds stop and yield signs, which agents obey. Their lanes are those of the traffic's graph.
    #[must_use]
    pub fn with_signs(mut self, signs: Arc<TrafficSigns>) -> Self {
        self.signs = signs;
        self
    }

    /// Adds pedestrians, whose states follow those of the vehicles.
    ///
    /// # Errors
    /// Returns an error if a path has no length.
    pub fn with_pedestrians(mut self, pedestrians: &[Pedestrian]) -> Result<Self, Invalid> {
        for pedestrian in pedestrians {
            let walker = Walker::new(&self.graph, pedestrian).ok_or_else(|| {
                Invalid::new(format!(
                    "pedestrian {}: the path has no length; expected two points apart",
                    pedestrian.name
                ))
            })?;
            self.states.push(Some(walker.state()));
            self.pedestrians.push(walker);
        }
        Ok(self)
    }

    /// Adds the actors of a story, whose states follow those of the pedestrians, and those on
    /// recorded tracks after them. `map` holds its lanes.
    ///
    /// # Errors
    /// Returns an error if an actor's lane is not on the map.
    pub fn with_story(mut self, story: &Story, map: &LaneMap) -> Result<Self, Invalid> {
        if story.directs() {
            let stage = Stage::new(story, map, &self.lights)?;
            self.states.extend(stage.states());
            self.stage = Some(stage);
        }
        if !story.tracks.agents.is_empty() {
            story
                .tracks
                .agents
                .iter()
                .try_for_each(|agent| agent.check())?;
            let mut tracked = Followers::new(&story.tracks, map);
            if self.drivers == Drivers::Drawn {
                tracked = tracked.with_drawn_drivers(self.seed);
            }
            self.states.extend(tracked.states());
            self.tracked = Some(tracked);
        }
        Ok(self)
    }

    /// One step of `dt_s` seconds, above 0 and at most [`Scenario::SUBSTEP_S_MAX`]; `ego` is where
    /// the ego is at its beginning.
    ///
    /// # Panics
    /// Panics if `dt_s` is not in that range.
    pub fn step(&mut self, dt_s: f64, ego: Option<(&VehicleState, &VehicleSize)>) {
        self.step_among(dt_s, &[ego.map(|(state, size)| (*state, *size))]);
    }

    /// One step like [`Self::step`], among several egos, each at its own place of the list. The
    /// story sees the first alone; triggers and cut-ins are about the nearest.
    ///
    /// # Panics
    /// Panics if `dt_s` is not in that range, or there are more than [`Egos::MAX`] egos.
    pub fn step_among(&mut self, dt_s: f64, egos: &[EgoBox]) {
        assert!(egos.len() <= Egos::MAX, "{} egos", egos.len());
        assert!(
            dt_s > 0.0 && dt_s <= Scenario::SUBSTEP_S_MAX + 1e-9,
            "a step of {dt_s} s"
        );
        let here = || egos.iter().flatten();
        self.egos = here().map(|(state, _)| *state).collect();
        let walks_mps = self.decide_walks(dt_s, egos);
        let seen_from_tracks = self.seen_from_tracks(egos);
        let walkers = self.pedestrians.iter();
        let walkers = walkers.filter_map(|walker| walker.seen(&self.graph));
        let actors = self.scripted();
        let actors = actors.filter_map(|(state, size)| Outsider::actor(&self.graph, &state, &size));
        self.outsiders = Outsiders {
            egos: (egos.iter().enumerate())
                .filter_map(|(number, ego)| Outsider::ego(&self.graph, number, ego.as_ref()?))
                .collect(),
            pedestrians: walkers.chain(actors).collect(),
        };
        let freely = self.body_boxes();
        let freely = freely.filter_map(|(state, size)| Outsider::actor(&self.graph, &state, &size));
        let freely: Vec<Outsider> = freely.collect();
        self.outsiders.pedestrians.extend(freely);
        let decided = self.decide_bodies(egos);
        self.order.build(&self.graph, &self.agents, &self.outsiders);
        self.claims
            .build(&self.graph, &self.agents, &self.outsiders);
        self.enter();
        self.behave();
        self.change_lanes(dt_s);
        self.cross(dt_s);
        for number in 0..self.agents.len() {
            self.agents[number].free_mps = self.free_speed(&self.agents[number]);
        }
        let mut accelerations = std::mem::take(&mut self.accelerations);
        accelerations.clear();
        accelerations.extend(self.agents.iter().map(|agent| match agent.away_until_s {
            None => self.acceleration(agent, dt_s),
            Some(_) => (0.0, false),
        }));
        for (number, &(acceleration_mps2, emergency)) in accelerations.iter().enumerate() {
            let agent = &mut self.agents[number];
            if agent.is_here() {
                agent.emergency = emergency;
                agent.advance(&self.graph, self.seed, acceleration_mps2, dt_s);
                let state = agent.state(&self.graph);
                self.states[number] = Some(state);
                self.follow_on_left_lane(number, state.position_m);
            }
        }
        self.accelerations = accelerations;
        self.step_bodies(&decided, dt_s);
        let walker_states = &mut self.states[self.agents.len()..];
        for ((walker, speed_mps), state) in self
            .pedestrians
            .iter_mut()
            .zip(walks_mps)
            .zip(walker_states)
        {
            walker.advance(speed_mps, dt_s);
            *state = Some(walker.state());
        }
        if let Some(stage) = &mut self.stage {
            let first = egos.first().and_then(Option::as_ref);
            stage.step(self.time_s, dt_s, first.map(|(state, size)| (state, size)));
            self.lights = Arc::clone(stage.lights());
            let first = self.agents.len() + self.pedestrians.len();
            for (state, moved) in self.states[first..].iter_mut().zip(stage.states()) {
                *state = moved;
            }
        }
        self.step_tracked(dt_s, &seen_from_tracks);
        self.time_s += dt_s;
        self.leave(dt_s);
        self.steps += 1;
    }

    /// Speeds of all pedestrians after a step.
    fn decide_walks(&mut self, dt_s: f64, egos: &[EgoBox]) -> Vec<f64> {
        if self.pedestrians.is_empty() {
            return Vec::new();
        }
        let vehicle = |state: &VehicleState, size: &VehicleSize| Vehicle {
            outline: OrientedBox::for_vehicle(state, size),
            speed_mps: state.speed_mps,
        };
        let agents = self.agents.iter().zip(&self.states);
        let here = agents.filter_map(|(agent, state)| Some(vehicle(state.as_ref()?, &agent.size)));
        let actors = self.scripted();
        let vehicles: Vec<Vehicle> = here
            .chain(actors.map(|(state, size)| vehicle(&state, &size)))
            .chain(
                egos.iter()
                    .flatten()
                    .map(|(state, size)| vehicle(state, size)),
            )
            .collect();
        let walkers = self.pedestrians.iter_mut();
        walkers
            .map(|walker| walker.decide((self.time_s, dt_s), &self.egos, &vehicles))
            .collect()
    }

    /// States of all agents, in the order of the scenario: after vehicles pedestrians, actors and
    /// those on tracks; `None` while one is off the map or hidden.
    #[must_use]
    pub fn states(&self) -> &[Option<VehicleState>] {
        &self.states
    }

    /// Lane positions of all vehicles, in the order of the scenario; `None` while one is off the
    /// map.
    pub fn lane_positions(&self) -> impl Iterator<Item = Option<LanePosition>> {
        self.agents.iter().enumerate().map(|(number, agent)| {
            let is_free = matches!(self.bodies.get(number), Some(Some(_)));
            (agent.is_here() || is_free).then(|| LanePosition {
                lane: agent.lane(),
                arc_m: agent.arc_m,
                lateral_m: self.bodies.get(number).copied().flatten().map_or_else(
                    || agent.lateral_m(&self.graph),
                    |steered| self.lateral_m(number, &steered.body.state),
                ),
            })
        })
    }

    /// Vehicles that brake harder than in normal driving, in the order of the scenario.
    pub fn emergencies(&self) -> impl Iterator<Item = bool> {
        self.agents.iter().map(|agent| agent.emergency)
    }

    /// The lanes that it drives on.
    #[must_use]
    pub fn graph(&self) -> &RoadGraph {
        &self.graph
    }

    /// Updates the position of an agent on the lane that it is leaving.
    fn follow_on_left_lane(&mut self, number: usize, position_m: DVec2) {
        if let Some(AsideKind::Change {
            from, from_arc_m, ..
        }) = self.agents[number]
            .aside
            .as_mut()
            .map(|aside| &mut aside.kind)
        {
            let foot = self.graph.road(*from).line.project_within(
                position_m,
                *from_arc_m,
                *from_arc_m + 10.0,
            );
            *from_arc_m = foot.arc_m;
        }
    }
}
