//! Conditions of events.

use serde::{Deserialize, Serialize};

use super::{Spot, Who};
use crate::traffic_light::LightColor;

/// Condition of a trigger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// Change of its truth that counts.
    #[serde(default)]
    pub edge: Edge,
    /// Time by which its truth counts later, seconds.
    #[serde(default)]
    pub delay_s: f64,
    /// Statement that holds or not.
    pub when: When,
}

/// Change of the truth of a condition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Edge {
    /// Truth without a change.
    #[default]
    None,
    /// Begin of its truth.
    Rising,
    /// End of its truth.
    Falling,
    /// Begin or end of its truth.
    Either,
}

/// Comparison of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Smaller than the value.
    Less,
    /// Smaller or equal.
    LessOrEqual,
    /// Larger than the value.
    Greater,
    /// Larger or equal.
    GreaterOrEqual,
    /// Equal, or passing it.
    Equal,
    /// Not equal.
    NotEqual,
}

/// State of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// One of them has begun, since the own event ended if it happens again.
    Begun,
    /// All of them have ended, since the own event ended if it happens again.
    Ended,
    /// One of them runs.
    Runs,
    /// All of them are over for good.
    Over,
    /// None of them runs, and one can begin.
    Waits,
    /// The act of one of them has begun.
    ActBegun,
    /// The act of one of them has begun, and not all of them are over.
    ActRuns,
    /// No act of them has begun.
    ActWaits,
}

/// Statement of a condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum When {
    /// Time since the start of the episode.
    Time {
        /// Comparison with the value.
        rule: Rule,
        /// Time, seconds.
        value_s: f64,
    },
    /// Value of road users.
    Value {
        /// Road users.
        of: Vec<Who>,
        /// True if it is to hold for all of them, otherwise for one.
        all: bool,
        /// Measured value.
        measure: Measure,
        /// Comparison with the value.
        rule: Rule,
        /// Value that it is compared with, in the unit of the measure.
        value: f64,
    },
    /// State of other events.
    Events {
        /// Indices of the events.
        events: Vec<usize>,
        /// State that they are to have.
        state: State,
    },
    /// Value of a variable.
    Variable {
        /// Name of the variable.
        variable: String,
        /// Comparison with the value.
        rule: Rule,
        /// Value that it is compared with.
        value: String,
    },
    /// Color of a traffic light.
    Light {
        /// Name of the light.
        light: String,
        /// Color that it is to have.
        color: LightColor,
    },
    /// Phase of a controller of traffic lights.
    Phase {
        /// Name of the controller.
        controller: String,
        /// Name of the phase that it is to be in.
        phase: String,
    },
    /// Statement that is always true, or never.
    Always {
        /// True if it holds.
        holds: bool,
    },
}

/// Direction of a distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Straight line.
    #[default]
    Straight,
    /// Direction in which the road user heads.
    Ahead,
    /// Direction across that in which the road user heads.
    Beside,
    /// Way along the lanes.
    AlongLanes,
    /// Way across the lanes.
    AcrossLanes,
}

/// Other end of a distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// Road user.
    Who(Who),
    /// Place of the map.
    At(Spot),
}

/// Value of a road user.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Measure {
    /// Speed, m/s.
    Speed,
    /// Acceleration, m/s^2.
    Acceleration,
    /// Speed minus that of another, m/s.
    RelativeSpeed {
        /// Road user whose speed is taken off.
        to: Who,
    },
    /// Way since the start, meters.
    Traveled,
    /// Time for which it stands, seconds.
    Standing,
    /// Time for which it is at the end of its lanes, seconds.
    AtEnd,
    /// Time for which it is on no lane, seconds.
    OffRoad,
    /// Distance, meters, never below zero.
    Distance {
        /// Other end.
        to: End,
        /// Direction of the distance.
        direction: Direction,
        /// True if it is between boxes.
        between_boxes: bool,
    },
    /// Distance ahead over its speed, seconds.
    Headway {
        /// Road user ahead.
        to: Who,
        /// Direction of the distance.
        direction: Direction,
        /// True if it is between boxes.
        between_boxes: bool,
    },
    /// Distance over the speed at which it shrinks, seconds.
    TimeToCollision {
        /// Other end.
        to: End,
        /// Direction of the distance.
        direction: Direction,
        /// True if it is between boxes.
        between_boxes: bool,
    },
    /// Number of others that its box touches: of `with`, or of all if there are none.
    Touched {
        /// Others that count.
        with: Vec<Who>,
    },
    /// Number of others in an area of lanes: of `with`, or of all if there are none.
    Near {
        /// Others that count.
        with: Vec<Who>,
        /// Way ahead, meters.
        ahead_m: f64,
        /// Way behind, meters.
        behind_m: f64,
        /// First and last lane, to the left of its own, its own being 0.
        lanes: [i64; 2],
        /// True if the distance is between boxes.
        between_boxes: bool,
    },
    /// Angle between its heading and one, radians, without sign.
    Turn {
        /// Heading, radians.
        heading_rad: f64,
        /// True if it counts from the direction of the lane.
        is_relative: bool,
    },
}
