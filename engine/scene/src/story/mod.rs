//! Stories: agents that follow a script instead of a driver model, as the entities of OpenSCENARIO
//! do.
//!
//! An actor keeps its lane and its speed until an action of an event changes one of them. It does
//! not react to others. Events begin when their conditions are met; these ask for times, for values
//! of the ego and of actors, and for other events.

mod action;
mod condition;
mod tracks;

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

pub use action::{Action, Change, Dynamics, Extent, Place, Shape, Side, Speed, Spot, TargetLane};
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
    /// Conditions that end the episode; none: it ends otherwise.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stop: Trigger,
    /// Road users with a script.
    #[serde(default, rename = "actor", skip_serializing_if = "Vec::is_empty")]
    pub actors: Vec<Actor>,
    /// Acts, which events belong to.
    #[serde(default, rename = "act", skip_serializing_if = "Vec::is_empty")]
    pub acts: Vec<Act>,
    /// Events in the order in which they are asked.
    #[serde(default, rename = "event", skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<Event>,
    /// Controllers of traffic lights, which conditions and actions name.
    #[serde(default, rename = "controller", skip_serializing_if = "Vec::is_empty")]
    pub controllers: Vec<LightController>,
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

    /// Actions of all events.
    pub fn tasks(&self) -> impl Iterator<Item = &Task> + Clone {
        self.events.iter().flat_map(|event| &event.actions)
    }

    /// Conditions of all acts and events, and of the end.
    pub fn conditions(&self) -> impl Iterator<Item = &Condition> + Clone {
        let acts = self.acts.iter().flat_map(|act| [&act.start, &act.stop]);
        let events = self.events.iter().map(|event| &event.start);
        let triggers = acts.chain(events).chain([&self.stop]);
        triggers.flatten().flatten()
    }

    /// Names of the traffic lights that conditions and actions name, also by their controllers.
    #[must_use]
    pub fn named_lights(&self) -> HashSet<&str> {
        let by_actions = self.tasks().filter_map(|task| match &task.action {
            Action::Light { light, .. } => Some(&**light),
            _ => None,
        });
        let by_conditions = self
            .conditions()
            .filter_map(|condition| match &condition.when {
                When::Light { light, .. } => Some(&**light),
                _ => None,
            });
        let controlled = self.controllers.iter().flat_map(|one| &one.lights);
        let controlled = controlled.map(String::as_str);
        by_actions.chain(by_conditions).chain(controlled).collect()
    }

    /// True if it directs something: actors, traffic lights or the end of the episode.
    #[must_use]
    pub fn directs(&self) -> bool {
        !self.actors.is_empty()
            || !self.stop.is_empty()
            || self
                .tasks()
                .any(|task| matches!(task.action, Action::Light { .. } | Action::Phase { .. }))
    }
}

/// Controller of traffic lights: names for the phases of their common cycle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightController {
    /// Unique among controllers.
    pub name: String,
    /// Names of the phases and their durations, seconds.
    pub phases: Vec<(String, f64)>,
    /// Position in the cycle at time 0, seconds.
    #[serde(default)]
    pub offset_s: f64,
    /// Names of its lights, whose phases together last as long as its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<String>,
}

impl LightController {
    /// Duration of a cycle, seconds.
    #[must_use]
    pub fn cycle_s(&self) -> f64 {
        self.phases.iter().map(|(_, duration_s)| duration_s).sum()
    }

    /// Name of the phase at a position in the cycle, seconds; `None` without phases.
    #[must_use]
    pub fn phase_at(&self, position_s: f64) -> Option<&str> {
        let mut rest_s = position_s.rem_euclid(self.cycle_s());
        let found = self.phases.iter().find(|(_, duration_s)| {
            rest_s -= duration_s;
            rest_s < 0.0
        });
        // Rounding at the end of the cycle.
        found.or(self.phases.last()).map(|(name, _)| name.as_str())
    }

    /// Position in the cycle at which the first phase of a name begins, seconds.
    #[must_use]
    pub fn begin_of(&self, phase: &str) -> Option<f64> {
        let at = self.phases.iter().position(|(name, _)| name == phase)?;
        Some(
            self.phases[..at]
                .iter()
                .map(|(_, duration_s)| duration_s)
                .sum(),
        )
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
    /// Largest growth of the acceleration, m/s^3; it counts where a distance to another is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_rate_mps3: Option<f64>,
    /// Largest growth of the deceleration, m/s^3; it counts where a distance to another is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deceleration_rate_mps3: Option<f64>,
}

impl Limits {
    /// True if nothing is limited.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Least time of a change of speed, seconds; 0 without a limit.
    #[must_use]
    pub fn least_s(&self, from_mps: f64, to_mps: f64) -> f64 {
        let limit = match to_mps >= from_mps {
            true => self.acceleration_mps2,
            false => self.deceleration_mps2,
        };
        let limit_mps2 = limit.unwrap_or(f64::INFINITY).max(1e-3);
        (to_mps - from_mps).abs() / limit_mps2
    }
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
