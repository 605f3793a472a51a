//! Conditions of events.

use serde::{Deserialize, Serialize};

use super::{Spot, Who};

/// Condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// Change of its truth that counts.
    #[serde(default)]
    pub edge: Edge,
    /// Time by which its truth counts later, seconds.
    #[serde(default)]
    pub delay_s: f64,
    /// Statement.
    pub when: When,
}

/// Change of the truth of a condition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Edge {
    /// It holds.
    #[default]
    None,
    /// It begins to hold.
    Rising,
    /// It ceases to hold.
    Falling,
    /// It does one of both.
    Either,
}

/// Comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Smaller.
    Less,
    /// Smaller or equal.
    LessOrEqual,
    /// Larger.
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
    /// One of them has begun since the condition is asked.
    Begun,
    /// All of them have ended since the condition is asked.
    Ended,
    /// One of them runs.
    Runs,
    /// All of them are over for good.
    Over,
    /// None of them runs, and one can begin.
    Waits,
}

/// Statement of a condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum When {
    /// Time since the start of the episode.
    Time {
        /// Comparison.
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
        /// Comparison.
        rule: Rule,
        /// Value that it is compared with, in the unit of the measure.
        value: f64,
    },
    /// State of other events.
    Events {
        /// Indices of the events.
        events: Vec<usize>,
        /// State.
        state: State,
    },
    /// Value of a variable.
    Variable {
        /// Name.
        variable: String,
        /// Comparison.
        rule: Rule,
        /// Value.
        value: String,
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
    /// Ahead of the road user, as it heads.
    Ahead,
    /// Beside the road user, as it heads.
    Beside,
    /// Along the lanes.
    AlongLanes,
    /// Across the lanes.
    AcrossLanes,
}

/// Other end of a distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// Road user.
    Who(Who),
    /// Place.
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
        /// The other.
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
        /// Direction.
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
        /// Others.
        with: Vec<Who>,
    },
    /// Number of others in an area of lanes: of `with`, or of all if there are none.
    Near {
        /// Others.
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
