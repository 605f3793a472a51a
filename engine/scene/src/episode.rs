//! Episodes: what happened, as a log keeps it and a score is made of.

use glam::DVec2;

use crate::camera::Intrinsics;
use crate::invalid::Invalid;
use crate::obstacle::Obstacle;
use crate::plan::Plan;
use crate::scenario::Scenario;
use crate::traffic_light::LightChange;
use crate::vehicle::{VehicleSize, VehicleState};

/// Planner of an episode, and its privileges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlannerRecord {
    /// Name on the command line.
    pub name: String,
    /// Cameras whose images it got, by name.
    pub cameras: Vec<String>,
    /// LiDARs whose sweeps it got, by name.
    pub lidars: Vec<String>,
    /// True if it received its pose and the points of its route.
    pub localization: bool,
    /// True if it received states of others and the map, which no camera shows.
    pub privileged: bool,
}

/// Renderer of an episode's images. Images of another device or size have other hashes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawnBy {
    /// Device and driver.
    pub device: String,
    /// Width of every image, pixels; 0 without images.
    pub width_px: u32,
    /// Height of every image, pixels; 0 without images.
    pub height_px: u32,
    /// Rendering interval in steps; step 0 is rendered.
    pub every: u32,
    /// True if cameras were drawn with [`Intrinsics::through_f_theta`].
    pub f_theta: bool,
}

impl DrawnBy {
    /// Intrinsics of the images, from the `own` ones of their camera.
    #[must_use]
    pub fn intrinsics(&self, own: &Intrinsics) -> Intrinsics {
        let resized = own.resized(self.width_px, self.height_px);
        let fitted = self.f_theta.then(|| resized.through_f_theta());
        fitted.flatten().unwrap_or(resized)
    }
}

/// Version of logs that this program writes.
pub const LOG_VERSION: u32 = 4;
/// First version of logs that can be replayed. Vehicles of earlier ones moved, or were on the road,
/// by other rules.
pub const REPLAY_VERSION: u32 = 3;
/// First version of logs with the ego's position on its lane.
pub const ROAD_VERSION: u32 = 4;

/// Line of a traffic light or sign on the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopLineRecord {
    /// Index of the light or sign in the scenario.
    pub index: usize,
    /// Right and left end in driving direction, world coordinates, meters.
    pub ends_m: [DVec2; 2],
}

impl StopLineRecord {
    /// Middle of the line.
    #[must_use]
    pub fn middle_m(&self) -> DVec2 {
        0.5 * (self.ends_m[0] + self.ends_m[1])
    }

    /// Unit vector of the driving direction.
    #[must_use]
    pub fn ahead(&self) -> DVec2 {
        -(self.ends_m[1] - self.ends_m[0]).perp().normalize_or_zero()
    }

    /// Distance from the line in driving direction, negative before it, and true where a point is
    /// between the ends, sideways.
    #[must_use]
    pub fn locate(&self, at_m: DVec2) -> (f64, bool) {
        let along = self.ends_m[1] - self.ends_m[0];
        let share = (at_m - self.ends_m[0]).dot(along) / along.length_squared();
        (
            (at_m - self.ends_m[0]).dot(self.ahead()),
            (0.0..=1.0).contains(&share),
        )
    }
}

/// Data of an episode that is known before it begins.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeHead {
    /// Version of the log, from 1 to [`LOG_VERSION`].
    pub log_version: u32,
    /// Version of the program.
    pub version: String,
    /// Scenario that was driven, with the changes of its traffic lights so far.
    pub scenario: Scenario,
    /// Planner that drove.
    pub planner: PlannerRecord,
    /// Renderer of the readings; `None` without readings.
    pub drawn_by: Option<DrawnBy>,
    /// The ego's route from start to end, world coordinates, meters: at least two points.
    pub route_m: Vec<DVec2>,
    /// Boxes of the agents, in the order of their states.
    pub agent_sizes: Vec<VehicleSize>,
    /// Stop lines of the scenario's traffic lights.
    pub stop_lines: Vec<StopLineRecord>,
    /// Lines of the scenario's signs.
    pub sign_lines: Vec<StopLineRecord>,
    /// Name of the program that drove agents in place of the driver model, if one did.
    pub agent_driver: Option<String>,
}

/// The bits of a sensor's reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadingRecord {
    /// The sensor's name.
    pub sensor: String,
    /// XXH3-128 of the XXH3-128s (little-endian) of its bytes, 2^20 at a time: RGBA of images,
    /// [`crate::LidarSweep::bytes`] of sweeps.
    pub hash: u128,
}

/// States of all vehicles at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeTick {
    /// Time since the episode's start, seconds.
    pub time_s: f64,
    /// The ego.
    pub ego: VehicleState,
    /// Angle of its front wheels, to the left where above zero.
    pub steer_rad: f64,
    /// True if all of its box is on the road.
    pub on_road: bool,
    /// Lanes below its middle; `None` where there are none, and in logs before version 3.
    pub lanes: Option<LaneRecord>,
    /// Position of the ego on the road; `None` in logs before version 4.
    pub road: Option<RoadRecord>,
    /// The agents, in the order of the scenario; `None` while one is off the map.
    pub agents: Vec<Option<VehicleState>>,
}

impl EpisodeTick {
    /// The moment without the position on the road where `other` does not tell it, as moments of
    /// older logs do not.
    #[must_use]
    pub fn told_like(&self, other: &Self) -> Self {
        Self {
            road: self.road.filter(|_| other.road.is_some()),
            ..self.clone()
        }
    }
}

/// Lanes below the middle of the ego at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneRecord {
    /// Speed of the ego against the lane that is most in its direction, m/s: 0 where one leads its
    /// way.
    pub against_mps: f64,
    /// Highest of the lanes' speed limits, m/s; `None` where the map tells none.
    pub limit_mps: Option<f64>,
}

/// Position of the ego on the road at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoadRecord {
    /// True where its middle is within a junction.
    pub in_junction: bool,
    /// True where it is in the way of lanes that cross, or on a crosswalk.
    pub on_crossing: bool,
    /// True at the moment at which it has come through a junction onto a lane that the lane it came
    /// from does not lead to.
    pub wrong_turn: bool,
    /// Nearest lane in its direction; `None` where there is none nearby.
    pub lane: Option<LaneOffset>,
}

/// Position of the middle of the ego across a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneOffset {
    /// Distance from the centerline, meters, positive to the left.
    pub lateral_m: f64,
    /// Distance from the centerline to the lane's edge on that side, meters.
    pub half_width_m: f64,
}

/// One step: what was seen, what was planned, what came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeStep {
    /// Number of the step, from 0.
    pub step: u32,
    /// Readings that the planner got, empty where none were drawn.
    pub readings: Vec<ReadingRecord>,
    /// Plan that it returned.
    pub plan: Plan,
    /// True if the planner had no plan yet, and the ego was kept on its route.
    pub warm_up: bool,
    /// The moments after it, one for each sub-step.
    pub instants: Vec<EpisodeTick>,
    /// Recorded agents that were handed over to the driver model in it.
    pub handovers: Vec<HandoverRecord>,
    /// Commands to agents that another program drove in it, in ascending order of agents.
    pub commands: Vec<CommandRecord>,
    /// Changes of traffic lights by events in it, in the order of their times.
    pub lights: Vec<LightChangeRecord>,
}

/// Change of a traffic light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightChangeRecord {
    /// Index of the light in the scenario.
    pub light: usize,
    /// Time and course.
    pub change: LightChange,
}

/// Command to an agent for one step, in place of the driver model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentCommand {
    /// Index of the agent in the scenario.
    pub agent: usize,
    /// Acceleration along its heading, m/s^2.
    pub acceleration_mps2: f64,
    /// Curvature of the way of its rear axle, 1/m, positive to the left; `None` keeps to its way.
    pub curvature_per_m: Option<f64>,
}

/// Command to an agent, and whether it could be carried out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandRecord {
    /// Command as the program gave it.
    pub command: AgentCommand,
    /// True if it asked for more than a vehicle can do, and less was done.
    pub is_limited: bool,
}

/// Handover of an agent from its recorded track to the driver model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandoverRecord {
    /// Index of the agent in the scenario.
    pub agent: usize,
    /// Time since the episode's start from which on the model drives it, seconds.
    pub time_s: f64,
}

/// Reason of an episode's end.
#[derive(Clone, Debug, PartialEq)]
pub enum EpisodeEnd {
    /// The ego is at the end of its route.
    RouteDone,
    /// The ego touches an agent.
    Collision {
        /// Index of the agent in the scenario.
        agent: usize,
    },
    /// The ego touches something static.
    Obstacle {
        /// Box that it touches.
        obstacle: Obstacle,
    },
    /// The ego is off the road for longer and farther than an excursion takes.
    OffRoad,
    /// The ego is farther from its route than any road user that follows it.
    OffRoute,
    /// Conditions of the scenario's story ended it.
    Story,
    /// The time is over.
    Time,
    /// The planner failed.
    Planner {
        /// Reason, a sentence.
        reason: String,
    },
}

/// A whole episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Data known before the start.
    pub head: EpisodeHead,
    /// States at the start.
    pub start: EpisodeTick,
    /// Steps, in order.
    pub steps: Vec<EpisodeStep>,
    /// Reason of the end.
    pub end: EpisodeEnd,
    /// Episodes of the other egos, each until its own end, in the order of the scenario;
    /// empty where there is one ego. Their scenario is that of the first as
    /// [`Scenario::for_ego`] has it, and they have no others.
    pub others: Vec<Episode>,
}

impl Episode {
    /// The episode as a log of `version` holds it: what such logs do not tell is left out.
    #[must_use]
    pub fn in_version(mut self, version: u32) -> Self {
        self.head.log_version = version;
        let later = self.steps.iter_mut().flat_map(|step| &mut step.instants);
        for instant in std::iter::once(&mut self.start).chain(later) {
            instant.road = instant.road.filter(|_| version >= ROAD_VERSION);
        }
        let others = std::mem::take(&mut self.others).into_iter();
        self.others = others.map(|other| other.in_version(version)).collect();
        self
    }

    /// The episode of each ego, in the order of the scenario: this one, and the others.
    pub fn egos(&self) -> impl ExactSizeIterator<Item = &Self> {
        (0..1 + self.others.len()).map(|ego| self.ego(ego))
    }

    /// The episode of ego `ego`, from 0.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn ego(&self, ego: usize) -> &Self {
        match ego {
            0 => self,
            _ => &self.others[ego - 1],
        }
    }

    /// The episode with ego `ego`, from 0, in the place of the first. Done twice, it is the episode
    /// itself.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn with_first(mut self, ego: usize) -> Self {
        if ego == 0 {
            return self;
        }
        let mut others = std::mem::take(&mut self.others);
        std::mem::swap(&mut self, &mut others[ego - 1]);
        let scenario = self.head.scenario.clone();
        for (at, other) in (1..).zip(&mut others) {
            if at != ego {
                other.swap_egos(at, ego);
                other.head.scenario = scenario.for_ego(at);
            }
        }
        self.others = others;
        self
    }

    /// Swaps the places of two egos, counted from 1, among the agents.
    fn swap_egos(&mut self, a: usize, b: usize) {
        let first = self.head.agent_sizes.len() - self.head.scenario.egos.others.len();
        let (a, b) = (first + a - 1, first + b - 1);
        self.head.agent_sizes.swap(a, b);
        let later = self.steps.iter_mut().flat_map(|step| &mut step.instants);
        for instant in std::iter::once(&mut self.start).chain(later) {
            instant.agents.swap(a, b);
        }
        if let EpisodeEnd::Collision { agent } = &mut self.end {
            *agent = match *agent {
                agent if agent == a => b,
                agent if agent == b => a,
                agent => agent,
            };
        }
    }

    /// The episode with the ego called `name` in the place of the first.
    ///
    /// # Errors
    /// A sentence with the names that there are.
    pub fn with_first_named(self, name: &str) -> Result<Self, Invalid> {
        let names = self
            .egos()
            .map(|ego| ego.head.scenario.egos.own.name.as_str());
        let names: Vec<&str> = names.collect();
        match names.iter().position(|own| *own == name) {
            Some(ego) => Ok(self.with_first(ego)),
            None => Err(Invalid::new(format!(
                "the log has no ego {name:?}; it has {}",
                names.join(", ")
            ))),
        }
    }

    /// Plans of all egos at step `step`, in the order of the scenario; `None` for those that had
    /// ended.
    #[must_use]
    pub fn plans_at(&self, step: u32) -> Vec<Option<&Plan>> {
        let steps = self.egos().map(|ego| ego.steps.get(step as usize));
        steps.map(|step| step.map(|step| &step.plan)).collect()
    }

    /// The episode of ego `ego`, from 0, to be changed.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    pub fn ego_mut(&mut self, ego: usize) -> &mut Self {
        match ego {
            0 => self,
            _ => &mut self.others[ego - 1],
        }
    }

    /// Adds a step. The lights of the scenario change as it says, which scores count by.
    pub fn push(&mut self, step: EpisodeStep) {
        for record in &step.lights {
            if let Some(light) = self.head.scenario.lights.get_mut(record.light) {
                light.changes.push(record.change);
            }
        }
        self.steps.push(step);
    }

    /// All moments in time, the start included.
    pub fn instants(&self) -> impl Iterator<Item = &EpisodeTick> {
        std::iter::once(&self.start).chain(self.steps.iter().flat_map(|step| &step.instants))
    }
}

impl EpisodeTick {
    /// State of ego `ego` of `count` at this moment, which ego `viewer` sees; `None` where it has
    /// left.
    #[must_use]
    pub fn ego_state(&self, count: usize, viewer: usize, ego: usize) -> Option<VehicleState> {
        if ego == viewer {
            return Some(self.ego);
        }
        // The place of the viewer is that of the first ego.
        let slot = if ego == 0 { viewer } else { ego };
        let first = self.agents.len().checked_sub(count.checked_sub(1)?)?;
        *self.agents.get(first + slot.checked_sub(1)?)?
    }

    /// Agents of this moment, which ego `teller` of `count` sees, as ego `viewer` sees them.
    #[must_use]
    pub fn agents_for(
        &self,
        count: usize,
        teller: usize,
        viewer: usize,
    ) -> Vec<Option<VehicleState>> {
        let traffic = self.agents.len().saturating_sub(count - 1);
        let others = (1..count).map(|slot| {
            let ego = if slot == viewer { 0 } else { slot };
            self.ego_state(count, teller, ego)
        });
        let traffic = self.agents[..traffic].iter().copied();
        traffic.chain(others).collect()
    }
}
