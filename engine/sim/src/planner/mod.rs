//! Planners of the ego: they receive images and return trajectories.
//!
//! A planner sees what it asks for in [`Planner::sees`], and the episode's log keeps what that was.
//! All of them are told what any vehicle knows of itself (speed, steering) and what a navigation
//! system says. States of others and the map are [privileged](Privileged): no camera shows them.

pub mod agents;
mod cadence;
mod choice;
mod constant_velocity;
mod external;
mod lane_follow;
mod learned;
mod replay;
mod vision;

pub use cadence::plan_through;
pub use choice::PlannerChoice;
pub use constant_velocity::ConstantVelocity;
pub use external::{External, ExternalAgents, Timeouts, Transport, observation_json};
pub use lane_follow::{DrivingStyle, LaneFollow};
pub use learned::Learned;
pub use replay::Replay;
pub use vision::{Perception, Vision};

use decouplegs_scene::LightColor;
use decouplegs_scene::episode::StopLineRecord;
use decouplegs_scene::plan::Plan;
use decouplegs_scene::{
    LidarSweep, Pose, RigCamera, RoadUser, Sensor, SignKind, VehicleSize, VehicleState,
};
use glam::{DVec2, DVec3};

/// Inputs that a planner requests.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ObservationRequest {
    /// Requested images.
    pub cameras: Cameras,
    /// True if it requests the sweeps of all LiDARs.
    pub lidars: bool,
    /// True if it requests [`Localization`].
    pub localization: bool,
    /// True if it requests [`Privileged`] state.
    pub privileged: bool,
}

/// Cameras of a rig that a planner requests.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Cameras {
    /// No camera: nothing has to be drawn for the planner.
    #[default]
    None,
    /// Camera that looks ahead: named `front`, otherwise the first.
    Front,
    /// Cameras with these names, in this order.
    Named(Vec<String>),
    /// All cameras of the rig.
    All,
}

/// An image as a planner sees it.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Camera: its projection and its pose on the ego (x forward, y left, z up from the middle of
    /// its box).
    pub camera: &'a RigCamera,
    /// Row by row from the top, four bytes per pixel, display-referred; the fourth is alpha.
    pub rgba: &'a [u8],
}

/// Output of a sensor at a step.
#[derive(Clone, Copy, Debug)]
pub enum Reading<'a> {
    /// Image of a camera.
    Image(Frame<'a>),
    /// Sweep of a LiDAR that ends at the moment of the step.
    Sweep(&'a LidarSweep),
}

impl<'a> Reading<'a> {
    /// The image `rgba` of `camera`.
    #[must_use]
    pub const fn image(camera: &'a RigCamera, rgba: &'a [u8]) -> Self {
        Self::Image(Frame { camera, rgba })
    }
}

/// The images among `readings`, in order.
pub fn images<'a>(readings: &[Reading<'a>]) -> impl Iterator<Item = Frame<'a>> {
    readings.iter().filter_map(|reading| match reading {
        Reading::Image(frame) => Some(*frame),
        Reading::Sweep(_) => None,
    })
}

/// The sweeps among `readings`, in order.
pub fn sweeps<'a>(readings: &[Reading<'a>]) -> impl Iterator<Item = &'a LidarSweep> {
    readings.iter().filter_map(|reading| match reading {
        Reading::Image(_) => None,
        Reading::Sweep(sweep) => Some(*sweep),
    })
}

/// Direction at the next crossing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turn {
    /// Straight on, or no crossing ahead.
    #[default]
    Straight,
    /// Turn to the left.
    Left,
    /// Turn to the right.
    Right,
}

impl Turn {
    /// The name it has in the protocol.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// Navigation instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Navigation {
    /// The next turn of the route.
    pub turn: Turn,
    /// Distance to the start of that turn, meters along the route; below zero within it, and the
    /// rest of the route where none is ahead.
    pub distance_m: f64,
    /// Change of heading in that turn, radians, positive to the left.
    pub angle_rad: f64,
    /// Length, meters along the route.
    pub length_m: f64,
    /// Cruise speed on a free road.
    pub cruise_mps: f64,
}

/// Ego motion as the vehicle knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EgoMotion {
    /// Speed along the heading, m/s.
    pub speed_mps: f64,
    /// Rate of the speed, m/s^2.
    pub acceleration_mps2: f64,
    /// Angle of its front wheels, to the left where above zero.
    pub steer_rad: f64,
    /// Rate of the heading, radians per second.
    pub yaw_rate_radps: f64,
}

/// Pose and motion of the ego at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocatedEgo {
    /// Time since the episode's start, seconds.
    pub time_s: f64,
    /// Middle of the ego's box, world coordinates, meters.
    pub pose: Pose,
    /// Pose on the plane. Positions of a plan are in its frame.
    pub state: VehicleState,
    /// Motion of the ego.
    pub motion: EgoMotion,
}

/// Pose of the ego and the route ahead, as the localization and the navigation of a vehicle know
/// them.
#[derive(Clone, Debug, PartialEq)]
pub struct Localization {
    /// The ego after each sub-step since the observation before, at least one; the last is now.
    pub path: Vec<LocatedEgo>,
    /// Points of the route from beside the ego on, [`Localization::SPACING_M`] apart, world
    /// coordinates, meters: [`Localization::WAYPOINTS`], and fewer near the end of the route.
    pub route_m: Vec<DVec3>,
}

impl Localization {
    /// Most points of the route.
    pub const WAYPOINTS: usize = 20;
    /// Distance from point to point along the route, meters.
    pub const SPACING_M: f64 = 4.0;

    /// The ego now.
    ///
    /// # Panics
    /// Panics if the path is empty.
    #[must_use]
    pub fn now(&self) -> &LocatedEgo {
        self.path.last().expect("a path ends now")
    }
}

/// Agent on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownAgent {
    /// Kind of the road user.
    pub kind: RoadUser,
    /// State of its box.
    pub state: VehicleState,
    /// Size of its box.
    pub size: VehicleSize,
}

/// Privileged state, which no camera shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Privileged {
    /// State of the ego.
    pub ego: VehicleState,
    /// Size of the ego.
    pub ego_size: VehicleSize,
    /// Route from start to end, world coordinates, meters.
    pub route_m: Vec<DVec2>,
    /// All agents on the map.
    pub agents: Vec<KnownAgent>,
    /// Stop lines of all traffic lights, with the color that each shows.
    pub stop_lines: Vec<(StopLineRecord, LightColor)>,
    /// Lines of all stop and yield signs.
    pub signs: Vec<(StopLineRecord, SignKind)>,
}

/// Inputs of a planner at a step.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Number of the step, from 0.
    pub step: u32,
    /// Time since the episode's start, seconds.
    pub time_s: f64,
    /// Readings of the sensors it asked for; none at a step that is not drawn.
    pub readings: &'a [Reading<'a>],
    /// Motion of the ego.
    pub ego: EgoMotion,
    /// Navigation instructions.
    pub guidance: Navigation,
    /// Localization, if requested.
    pub localization: Option<&'a Localization>,
    /// Privileged state, if requested.
    pub privileged: Option<&'a Privileged>,
}

/// Inputs of a planner before an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeInfo {
    /// The scenario's name.
    pub scenario: String,
    /// The scenario's seed.
    pub seed: u64,
    /// Interval between plans, seconds.
    pub step_s: f64,
    /// The ego's box.
    pub ego_size: VehicleSize,
    /// Distance from the rear axle to the middle of the ego's box, meters.
    pub rear_axle_to_middle_m: f64,
    /// The sensors it asked for.
    pub sensors: Vec<Sensor>,
}

/// Reason why a planner has no plan: a sentence. It ends the episode, not the run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct PlannerError(pub String);

/// Planner that drives the ego.
pub trait Planner: Send {
    /// Name in logs and reports.
    fn name(&self) -> String;

    /// Requested inputs; the same for all episodes.
    fn sees(&self) -> ObservationRequest;

    /// Prepares for a new episode. Nothing of the episode before may be kept.
    ///
    /// # Errors
    /// Returns an error if the planner cannot drive.
    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError>;

    /// Plans the path from the ego's present pose.
    ///
    /// # Errors
    /// Returns an error if the planner has no answer, or none in time.
    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError>;

    /// False if it never uses [`Observation::readings`]. It is given none then, and the device
    /// draws while the next step is driven.
    fn uses_readings(&self) -> bool {
        true
    }

    /// True if the last plan was not the planner's own: it has not seen enough to plan yet, and the
    /// ego was kept on its route. The log and the score say so.
    fn is_warming_up(&self) -> bool {
        false
    }

    /// Other plans that the planner considered beside the last one, for people to look at.
    fn alternatives(&self) -> &[Plan] {
        &[]
    }
}

/// Privileged state for the planner `who`, or an error if it is absent.
fn state_needed<'a>(
    observation: &Observation<'a>,
    who: &str,
) -> Result<&'a Privileged, PlannerError> {
    observation.privileged.ok_or_else(|| {
        PlannerError(format!(
            "{who} was not told where the ego is; expected privileged state"
        ))
    })
}
