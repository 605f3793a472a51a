//! Stories: agents that follow a script instead of a driver model, as the entities of OpenSCENARIO
//! do.
//!
//! An actor keeps its lane and its speed until an action of an event changes one of them. It does
//! not react to others. Events begin when their conditions are met; these ask for times, for values
//! of the ego and of actors, and for other events.

mod action;
mod condition;
mod tracks;

use serde::{Deserialize, Serialize};

pub use action::{Action, Change, Dynamics, Extent, Shape, Side, Speed, Spot, TargetLane};
pub use condition::{Condition, Direction, Edge, End, Measure, Rule, State, When};
pub use tracks::{Handover, TrackedAgent, Tracks};

use crate::road_user::RoadUser;
use crate::vehicle::VehicleSize;

/// Road user of a story: 0 is the ego, `n` the actor `n - 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Who(pub usize);

impl Who {
    /// Ego vehicle.
    pub const EGO: Self = Self(0);
}

/// Actors and what they do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Story {
    /// Way from the ego's rear axle to the middle of its box, meters: distances count from rear
    /// axles.
    #[serde(default)]
    pub ego_center_m: f64,
    /// Variables and their values at the start.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variables: Vec<(String, String)>,
    /// Road users with a script.
    #[serde(default, rename = "actor", skip_serializing_if = "Vec::is_empty")]
    pub actors: Vec<Actor>,
    /// Acts, which events belong to.
    #[serde(default, rename = "act", skip_serializing_if = "Vec::is_empty")]
    pub acts: Vec<Act>,
    /// Events in the order in which they are asked.
    #[serde(default, rename = "event", skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<Event>,
    /// Road users that follow recorded tracks. Wherever agents have an index, theirs follow those
    /// of the actors.
    #[serde(default, skip_serializing_if = "Tracks::is_default")]
    pub tracks: Tracks,
}

impl Story {
    /// True if it has neither actors nor recorded road users.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.actors.is_empty() && self.tracks.agents.is_empty()
    }
}

/// Road user with a script, and its state at the start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actor {
    /// Unique among the agents of the scenario.
    pub name: String,
    /// Kind of road user.
    #[serde(with = "kind_by_name")]
    pub kind: RoadUser,
    /// Index among the assets of its kind; indices beyond the last start over.
    pub asset: usize,
    /// Length, width and height of the box, meters.
    pub size_m: [f64; 3],
    /// Way from its reference point, the rear axle, to the middle of its box, meters.
    pub center_m: f64,
    /// Reference point, world coordinates, meters.
    pub point_m: [f64; 2],
    /// Heading, radians from x towards y.
    pub heading_rad: f64,
    /// Lane that it follows, by id; none: it goes straight on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lane: Option<String>,
    /// Speed, m/s; below zero: backwards.
    pub speed_mps: f64,
    /// True if it is hidden until an action shows it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_hidden: bool,
    /// Limits of its changes of speed.
    #[serde(default)]
    pub limits: Limits,
}

impl Actor {
    /// Size of the box.
    #[must_use]
    pub fn size(&self) -> VehicleSize {
        VehicleSize::from_array(self.size_m)
    }
}

/// Limits of changes of speed; what is missing has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest speed, m/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<f64>,
    /// Largest acceleration, m/s^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_mps2: Option<f64>,
    /// Largest deceleration, m/s^2, above zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deceleration_mps2: Option<f64>,
}

/// Conditions in groups: all of one group have to hold. Without groups they hold at once.
pub type Trigger = Vec<Vec<Condition>>;

/// Act: its events wait until it begins, and are over when it stops.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Act {
    /// Conditions of its begin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub start: Trigger,
    /// Conditions of its end; it stops for none if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stop: Trigger,
}

/// Event: actions that begin together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Name in the file.
    pub name: String,
    /// Index of its act.
    pub act: usize,
    /// Number of its maneuver: priorities count among its events.
    pub maneuver: usize,
    /// Treatment of the other events of its maneuver.
    #[serde(default)]
    pub priority: Priority,
    /// Number of times that it can happen.
    #[serde(default = "once")]
    pub executions: u32,
    /// Conditions of its begin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub start: Trigger,
    /// Actions that begin with it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub actions: Vec<Task>,
}

fn once() -> u32 {
    1
}

/// Treatment of running events of the same maneuver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// Ends those that run.
    #[default]
    Override,
    /// Does not begin while one runs.
    Skip,
    /// Runs beside them.
    Parallel,
}

/// Action of an actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Actor; the ego for actions that only take their time.
    pub of: Who,
    /// Action that is done.
    pub action: Action,
}

/// Kinds of road users by the names that they have in files.
mod kind_by_name {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    use crate::road_user::RoadUser;

    pub(super) fn serialize<S: Serializer>(kind: &RoadUser, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(kind.name())
    }

    pub(super) fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<RoadUser, D::Error> {
        let name = String::deserialize(from)?;
        RoadUser::by_name(&name).ok_or_else(|| {
            let names = RoadUser::ALL.map(RoadUser::name).join(", ");
            D::Error::custom(format!("'{name}' is unknown; there are {names}"))
        })
    }
}
