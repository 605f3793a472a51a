//! Episodes: what happened, as a log keeps it and a score is made of.

use glam::DVec2;

use crate::plan::Plan;
use crate::scenario::Scenario;
use crate::vehicle::{VehicleSize, VehicleState};

/// What a planner was given.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlannerRecord {
    /// As the command line names it.
    pub name: String,
    /// Cameras whose pictures it got, by name.
    pub cameras: Vec<String>,
    /// Whether it got states of others and the map, which no camera shows.
    pub privileged: bool,
}

/// What drew the pictures of an episode. Pictures of another device or size have other hashes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawnBy {
    /// Device and driver.
    pub device: String,
    /// Of every picture, pixels.
    pub width_px: u32,
    /// Of every picture, pixels.
    pub height_px: u32,
    /// Every so manyth step is drawn, from the first on.
    pub every: u32,
}

/// What is known of an episode before it begins.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeHead {
    /// Version of the program.
    pub version: String,
    /// What is driven.
    pub scenario: Scenario,
    /// Who drives.
    pub planner: PlannerRecord,
    /// What pictures are made with; `None` where none are.
    pub drawn_by: Option<DrawnBy>,
    /// The ego's route from start to end, world coordinates, metres: at least two points.
    pub route_m: Vec<DVec2>,
    /// Boxes of the agents, in the order of their states.
    pub agent_sizes: Vec<VehicleSize>,
}

/// The bits of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageRecord {
    /// The camera's name.
    pub camera: String,
    /// XXH3-128 of the XXH3-128s (little-endian) of its RGBA bytes, 2^20 at a time.
    pub hash: u128,
}

/// Where everybody is at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Instant {
    /// Since the episode's start, seconds.
    pub time_s: f64,
    /// The ego.
    pub ego: VehicleState,
    /// Angle of its front wheels, to the left where above zero.
    pub steer_rad: f64,
    /// Whether all of its box is on the road.
    pub on_road: bool,
    /// The agents, in the order of the scenario.
    pub agents: Vec<VehicleState>,
}

/// One step: what was seen, what was planned, what came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeStep {
    /// From 0.
    pub step: u32,
    /// The pictures that the planner got, empty where none were drawn.
    pub images: Vec<ImageRecord>,
    /// What it answered.
    pub plan: Plan,
    /// The moments after it, one for each sub-step.
    pub instants: Vec<Instant>,
}

/// Why an episode ended.
#[derive(Clone, Debug, PartialEq)]
pub enum EpisodeEnd {
    /// The ego is at the end of its route.
    RouteDone,
    /// The ego touches an agent.
    Collision {
        /// Which, its place in the scenario.
        agent: usize,
    },
    /// The time is over.
    Time,
    /// The planner failed.
    Planner {
        /// How, a sentence.
        reason: String,
    },
}

/// A whole episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// What was known before.
    pub head: EpisodeHead,
    /// Where everybody stood at the start.
    pub start: Instant,
    /// What happened.
    pub steps: Vec<EpisodeStep>,
    /// Why it ended.
    pub end: EpisodeEnd,
}

impl Episode {
    /// All moments in time, the start included.
    pub fn instants(&self) -> impl Iterator<Item = &Instant> {
        std::iter::once(&self.start).chain(self.steps.iter().flat_map(|step| &step.instants))
    }
}
