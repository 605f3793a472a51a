//! Scenarios: place of an episode, task of the ego, and other vehicles.

use std::path::PathBuf;

use glam::DVec2;

use crate::air::{Air, Weather};
use crate::egos::{EgoIdentity, Egos};
use crate::road_user::RoadUser;
use crate::story::{Actor, Story, TrackedAgent};
use crate::traffic_light::TrafficLight;
use crate::traffic_sign::TrafficSign;
use crate::vehicle::VehicleSize;

pub use crate::egos::EgoTask;

/// Difficulty of a scenario, as in the paper (supplement, "Definition of Evaluation Scenarios").
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// 1 to 3 agents within 50 m, a clear day, steady lane keeping.
    Easy,
    /// 4 to 8 agents, day or overcast, yielding and lane changes.
    Medium,
    /// 9 to 15 agents, dusk or overcast, congested crossings, close cut-ins.
    Hard,
    /// More than 15 agents, night or glare, hard braking and swerving.
    Extreme,
}

impl Level {
    /// All levels, from easy to extreme.
    pub const ALL: [Self; 4] = [Self::Easy, Self::Medium, Self::Hard, Self::Extreme];

    /// The name it has in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Easy => "easy",
            Self::Medium => "medium",
            Self::Hard => "hard",
            Self::Extreme => "extreme",
        }
    }

    /// The level that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|level| level.name() == name)
    }
}

/// Place of an episode.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// The synthetic street with a crossing.
    Street {
        /// The light over it.
        weather: Weather,
        /// Splats of the static part.
        background: usize,
        /// Splats of each car.
        agent_splats: usize,
        /// Houses, trees and parked cars follow from it.
        seed: u64,
    },
    /// The roads of a map, drawn as asphalt and markings under the sky of a light probe.
    Roads {
        /// Lanes, in any format that maps are read in; relative to the scenario's file.
        map: PathBuf,
        /// A lat-long .hdr or .exr that lights the place. None: an overcast sky.
        probe: Option<PathBuf>,
        /// Stops by which the probe's light is made brighter, below zero darker.
        exposure_ev: f64,
        /// Light where no probe is named, and fog.
        air: Air,
        /// File of obstacles, drawn as boxes, beside the houses that are generated.
        obstacles: Option<PathBuf>,
        /// Splats of the static part.
        background: usize,
        /// Splats of each car.
        agent_splats: usize,
    },
    /// A captured scene: a scene file, whose assets the agents show, and the map of its lanes.
    Scene {
        /// The scene file, relative to the scenario's file.
        scene: PathBuf,
        /// Map file with the lanes.
        map: PathBuf,
        /// File of obstacles. `None`: the cells beside the lanes that the scene's splats fill.
        obstacles: Option<PathBuf>,
    },
}

/// Driver type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriverKind {
    /// Slower than allowed, long gaps, hardly changes lanes.
    Calm,
    /// Treiber's defaults.
    Normal,
    /// Faster, shorter gaps, changes lanes for little.
    Hurried,
    /// Close behind others, into small gaps, no politeness.
    Aggressive,
}

impl DriverKind {
    /// All driver types, from calm to aggressive.
    pub const ALL: [Self; 4] = [Self::Calm, Self::Normal, Self::Hurried, Self::Aggressive];

    /// The name it has in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Calm => "calm",
            Self::Normal => "normal",
            Self::Hurried => "hurried",
            Self::Aggressive => "aggressive",
        }
    }

    /// The driver that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|driver| driver.name() == name)
    }
}

/// Source of the parameters of drivers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Drivers {
    /// Four types, each with one set of parameters; 50 km/h where the map tells no limit.
    #[default]
    Kinds,
    /// Each driver's own parameters, drawn from distributions by the scenario's seed and the place
    /// of the agent in it; free speeds by class of road where the map tells no limit.
    Drawn,
}

impl Drivers {
    /// Both sources.
    pub const ALL: [Self; 2] = [Self::Kinds, Self::Drawn];

    /// The name it has in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kinds => "kinds",
            Self::Drawn => "drawn",
        }
    }

    /// The source that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|drivers| drivers.name() == name)
    }
}

/// Trigger of an injected behavior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// Time after the episode's start, seconds.
    Time {
        /// Time since the start, seconds.
        time_s: f64,
    },
    /// Distance of the ego's center, first reached, meters.
    NearEgo {
        /// Distance to the ego, meters.
        distance_m: f64,
    },
    /// Comparison of a measured value, first met.
    Measured(Measured),
    /// Another behavior of the same agent, begun or over.
    After(After),
}

/// Wait for another behavior of the same agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct After {
    /// Index of that behavior among those of the agent.
    pub behavior: usize,
    /// True if it counts from the end of that behavior, false if from its begin. A behavior
    /// without room for it ends when it is given up.
    pub is_over: bool,
    /// Time from which it counts at the earliest, seconds.
    pub from_s: f64,
    /// Time that passes then, seconds.
    pub delay_s: f64,
}

/// Road user whose value is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Party {
    /// Ego vehicle.
    Ego,
    /// Agent that waits for the trigger.
    Agent,
}

impl Party {
    /// Both, by the names that they have in files.
    pub const NAMED: [(&str, Self); 2] = [("ego", Self::Ego), ("agent", Self::Agent)];
}

/// Comparison of a measured value with a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Road user whose value it is; the other one is the other end of distances.
    pub of: Party,
    /// Measured value.
    pub measure: Measure,
    /// Length that is taken off distances, so that they are between boxes, meters.
    pub less_m: f64,
    /// True if values from the limit on hold, false for those up to it.
    pub is_above: bool,
    /// Limit, in the unit of the measure.
    pub value: f64,
    /// Time from which it is compared, seconds.
    pub from_s: f64,
    /// Time that passes once it holds, seconds.
    pub delay_s: f64,
}

/// Value that a trigger measures, of one party and towards the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measure {
    /// Speed, m/s.
    Speed,
    /// Acceleration, m/s^2.
    Acceleration,
    /// Speed minus that of the other, m/s.
    RelativeSpeed,
    /// Way since the start, meters.
    Traveled,
    /// Time for which it stands, seconds.
    Standing,
    /// Distance to a point, meters.
    DistanceTo {
        /// World coordinates, meters.
        point_m: DVec2,
    },
    /// Distance of the middles of both boxes, meters.
    Distance,
    /// Part of that distance along the heading, meters, never below zero.
    Longitudinal,
    /// Part of that distance across the heading, meters, never below zero.
    Lateral,
    /// Longitudinal distance over the speed, seconds; none while the other is behind.
    Headway,
    /// Distance over the speed at which it shrinks, seconds; infinite while it grows.
    TimeToCollision,
}

impl Measure {
    /// All but the distance to a point, by the names that they have in files.
    pub const NAMED: [(&str, Self); 10] = [
        ("speed", Self::Speed),
        ("acceleration", Self::Acceleration),
        ("relative_speed", Self::RelativeSpeed),
        ("traveled", Self::Traveled),
        ("standing", Self::Standing),
        ("distance", Self::Distance),
        ("longitudinal", Self::Longitudinal),
        ("lateral", Self::Lateral),
        ("headway", Self::Headway),
        ("time_to_collision", Self::TimeToCollision),
    ];
}

/// Maneuver of an agent that a model of good driving excludes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Maneuver {
    /// Brakes hard.
    Brake {
        /// Deceleration, above zero.
        deceleration_mps2: f64,
        /// Duration, seconds.
        duration_s: f64,
    },
    /// Changes into the ego's lane whatever gap there is, as long as no other agent is in the way.
    CutIn,
    /// Leaves the middle of its lane and comes back.
    Swerve {
        /// Largest lateral offset, positive to the left.
        amplitude_m: f64,
        /// Duration, out and back.
        duration_s: f64,
    },
    /// Has another cruise speed from then on.
    Cruise {
        /// New cruise speed.
        speed_mps: f64,
    },
    /// Changes into the neighboring lane as soon as there is a safe gap.
    ChangeLane {
        /// Direction of the change.
        side: LaneSide,
    },
    /// Is put onto the lane at a point, at its speed, as soon as there is room.
    Teleport {
        /// World coordinates, meters.
        point_m: DVec2,
    },
}

/// Side of a lane, in driving direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneSide {
    /// Left of the driving direction.
    Left,
    /// Right of the driving direction.
    Right,
}

/// A maneuver and when it begins; it happens once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Behavior {
    /// Trigger condition.
    pub trigger: Trigger,
    /// Maneuver that is performed.
    pub maneuver: Maneuver,
}

/// An agent of the traffic at the episode's start.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficAgent {
    /// Unique in the scenario.
    pub name: String,
    /// Kind: a road user on lanes, so not a pedestrian.
    pub kind: RoadUser,
    /// Index of its asset among those of its kind that the place has; indices beyond the last start
    /// over.
    pub asset: usize,
    /// Size of the box.
    pub size: VehicleSize,
    /// The lane it starts on, by id.
    pub lane: String,
    /// Position of its center, meters along the lane.
    pub at_m: f64,
    /// Initial speed.
    pub speed_mps: f64,
    /// Speed on a free road instead of the speed limit. Curves still slow it down. `None`: the
    /// speed limit, as its driver type obeys it.
    pub cruise_mps: Option<f64>,
    /// Driver type.
    pub driver: DriverKind,
    /// True if it may change lanes voluntarily.
    pub changes_lanes: bool,
    /// Injected behaviors.
    pub behaviors: Vec<Behavior>,
}

/// Pedestrian with a path, which is walked once.
#[derive(Clone, Debug, PartialEq)]
pub struct Pedestrian {
    /// Unique among the agents of the scenario.
    pub name: String,
    /// Index among the pedestrians of the place; indices beyond the last start over.
    pub asset: usize,
    /// Size of the box.
    pub size: VehicleSize,
    /// Points of the walk, at least two, world coordinates, meters.
    pub path_m: Vec<DVec2>,
    /// Walking speed.
    pub speed_mps: f64,
    /// Start of the walk.
    pub start: Trigger,
    /// True if the pedestrian waits beside the road until no vehicle comes. Otherwise the
    /// pedestrian steps in front of vehicles, but does not walk into their sides.
    pub waits_for_gap: bool,
}

/// An episode before it is driven. With a planner it tells all that happens.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Names its files: letters, digits, `-` and `_`.
    pub name: String,
    /// Difficulty; `None` for scenarios written by hand.
    pub level: Option<Level>,
    /// Seed of the traffic's random choices: ways at crossings, and drivers where they are drawn.
    pub seed: u64,
    /// Source of the parameters of drivers.
    pub drivers: Drivers,
    /// Time limit, seconds.
    pub duration_s: f64,
    /// Interval between steps, seconds.
    pub step_s: f64,
    /// Place of the episode.
    pub place: Place,
    /// The ego's part.
    pub ego: EgoTask,
    /// Name and look of the ego, and the other egos, if there are any. Wherever agents have an
    /// index, those of the other egos come last.
    pub egos: Egos,
    /// Other vehicles.
    pub agents: Vec<TrafficAgent>,
    /// Pedestrians. Wherever agents have an index, theirs follow those of the vehicles.
    pub pedestrians: Vec<Pedestrian>,
    /// Traffic lights that all vehicles are to obey.
    pub lights: Vec<TrafficLight>,
    /// Stop and yield signs that all vehicles are to obey.
    pub signs: Vec<TrafficSign>,
    /// Agents with a script, and their script, and agents that follow recorded tracks. Wherever
    /// agents have an index, theirs follow those of the pedestrians.
    pub story: Story,
}

impl Scenario {
    /// The control step of nuScenes planners, seconds.
    pub const STEP_S: f64 = 0.5;
    /// The length of the paper's episodes, seconds.
    pub const DURATION_S: f64 = 20.0;
    /// Traffic and vehicles move in steps of this at most, seconds.
    pub const SUBSTEP_S_MAX: f64 = 0.1;

    /// Sub-steps of a step, and how long each is, seconds.
    #[must_use]
    pub fn substeps(&self) -> (u32, f64) {
        let count = (self.step_s / Self::SUBSTEP_S_MAX - 1e-9).ceil().max(1.0);
        (count as u32, self.step_s / count)
    }

    /// Steps until its time is over.
    #[must_use]
    pub fn steps(&self) -> u32 {
        (self.duration_s / self.step_s - 1e-9).ceil().max(1.0) as u32
    }

    /// Number of vehicles, pedestrians, actors, recorded road users and other egos.
    #[must_use]
    pub fn agent_count(&self) -> usize {
        let story = self.story.actors.len() + self.story.tracks.agents.len();
        self.agents.len() + self.pedestrians.len() + story + self.egos.others.len()
    }

    /// Boxes of vehicles, pedestrians, actors, recorded road users and other egos, in the order of
    /// their indices.
    #[must_use]
    pub fn agent_sizes(&self) -> Vec<VehicleSize> {
        let vehicles = self.agents.iter().map(|agent| agent.size);
        let pedestrians = self.pedestrians.iter().map(|walker| walker.size);
        let actors = self.story.actors.iter().map(Actor::size);
        let tracked = self.story.tracks.agents.iter().map(TrackedAgent::size);
        vehicles
            .chain(pedestrians)
            .chain(actors)
            .chain(tracked)
            .chain(self.egos.sizes())
            .collect()
    }

    /// True if no agent is a truck, bus, cyclist or pedestrian.
    #[must_use]
    pub fn has_only_cars(&self) -> bool {
        (0..self.agent_count()).all(|index| self.agent(index).1 == RoadUser::Car)
    }

    /// Name, kind and asset of a vehicle, pedestrian, actor, recorded road user or other ego.
    ///
    /// # Panics
    /// Panics if there is no such agent.
    #[must_use]
    pub fn agent(&self, index: usize) -> (&str, RoadUser, usize) {
        if let Some(agent) = self.agents.get(index) {
            return (&agent.name, agent.kind, agent.asset);
        }
        let index = index - self.agents.len();
        if let Some(walker) = self.pedestrians.get(index) {
            return (&walker.name, RoadUser::Pedestrian, walker.asset);
        }
        let index = index - self.pedestrians.len();
        if let Some(actor) = self.story.actors.get(index) {
            return (&actor.name, actor.kind, actor.asset);
        }
        let index = index - self.story.actors.len();
        if let Some(tracked) = self.story.tracks.agents.get(index) {
            return (&tracked.name, tracked.kind, tracked.asset);
        }
        let other = &self.egos.others[index - self.story.tracks.agents.len()].identity;
        (&other.name, RoadUser::Car, other.asset)
    }

    /// Task of ego `ego`, from 0, in the order of the file.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn ego_task(&self, ego: usize) -> &EgoTask {
        match ego {
            0 => &self.ego,
            _ => &self.egos.others[ego - 1].task,
        }
    }

    /// Identity of ego `ego`, from 0, in the order of the file.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn ego_identity(&self, ego: usize) -> &EgoIdentity {
        match ego {
            0 => &self.egos.own,
            _ => &self.egos.others[ego - 1].identity,
        }
    }

    /// The scenario for ego `ego`: its task is [`Scenario::ego`], and the first ego has its place
    /// among the others. Done twice, it is the scenario itself.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn for_ego(&self, ego: usize) -> Self {
        let mut scenario = self.clone();
        if ego > 0 {
            let other = &mut scenario.egos.others[ego - 1];
            std::mem::swap(&mut scenario.ego, &mut other.task);
            std::mem::swap(&mut scenario.egos.own, &mut other.identity);
        }
        scenario
    }
}
