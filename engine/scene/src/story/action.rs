//! Actions of actors.

use serde::{Deserialize, Serialize};

use super::{Limits, Who};
use crate::traffic_light::LightColor;

/// Shape of a transition from one value to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// Jump at the start.
    Step,
    /// Straight line.
    Linear,
    /// Cubic with no slope at both ends.
    Cubic,
    /// Half a wave of a cosine.
    Sinusoidal,
}

/// Extent of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Extent {
    /// Duration, seconds.
    TimeS(f64),
    /// Largest change per second, in the unit of the value.
    RatePerS(f64),
    /// Way driven meanwhile, meters.
    DistanceM(f64),
    /// Largest lateral acceleration of a change of offset, m/s^2.
    LateralMps2(f64),
}

/// Transition from one value to another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dynamics {
    /// Shape of the transition.
    pub shape: Shape,
    /// Extent of the transition.
    pub extent: Extent,
}

impl Dynamics {
    /// Change at once.
    pub const STEP: Self = Self {
        shape: Shape::Step,
        extent: Extent::TimeS(0.0),
    };
}

/// Speed that is reached.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Speed {
    /// Speed, m/s.
    Mps(f64),
    /// Speed of another, times a factor, plus a difference.
    Of {
        /// Road user whose speed counts.
        who: Who,
        /// Factor of that speed.
        factor: f64,
        /// Difference, m/s.
        plus_mps: f64,
        /// True if it follows that speed without end.
        #[serde(default)]
        continuous: bool,
    },
}

/// Lane that is changed to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum TargetLane {
    /// Id of the lane on its road.
    Id(i64),
    /// Lanes to the left of a road user, negative to the right.
    Beside {
        /// Road user from whose lane it counts.
        who: Who,
        /// Lanes to the left.
        lanes: i64,
    },
}

/// Side of a road user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Side where it is already.
    #[default]
    Any,
    /// Left, or behind.
    LeftOrBehind,
    /// Right, or ahead.
    RightOrAhead,
}

/// Place that may depend on where others are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Spot {
    /// Point of the world.
    Point {
        /// World coordinates, meters.
        at_m: [f64; 2],
        /// Heading, radians; none: that of the lane there.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        heading_rad: Option<f64>,
    },
    /// Point seen from a road user.
    From {
        /// Road user.
        who: Who,
        /// Offset, meters.
        offset_m: [f64; 2],
        /// True if the offset counts ahead and to the left; otherwise in world coordinates.
        turns: bool,
    },
    /// Place on a lane beside a road user.
    Lane {
        /// Road user.
        who: Who,
        /// Lanes to the left, negative to the right.
        lanes: i64,
        /// Way ahead along the lanes, meters.
        ahead_m: f64,
        /// True if lanes, way and offset count in the direction of the road's reference line, and
        /// the way along it: that is shorter or longer than the lanes in bends.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        on_road: bool,
        /// Offset from the middle of that lane to the left, meters; none: that of the road user.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        left_m: Option<f64>,
    },
    /// Place on the road of a road user.
    Road {
        /// Road user.
        who: Who,
        /// Way along the reference line of the road, in its direction, meters.
        along_m: f64,
        /// Way to the left of that line from the road user's own offset, meters.
        left_m: f64,
    },
}

/// Point of a line that counts from road users.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Place {
    /// A place itself.
    At(Spot),
    /// Point seen from a place.
    Beside {
        /// Place that it is seen from.
        of: Spot,
        /// Turn of what is ahead from the heading of that place, radians to the left.
        turn_rad: f64,
        /// Offset ahead and to the left, meters.
        offset_m: [f64; 2],
    },
    /// Mean of places.
    Between {
        /// The places.
        of: Vec<Spot>,
        /// Shares of them, 1 together.
        shares: Vec<f64>,
    },
}

impl Place {
    /// Places that it is made of.
    #[must_use]
    pub fn spots(&self) -> &[Spot] {
        match self {
            Self::At(spot) | Self::Beside { of: spot, .. } => std::slice::from_ref(spot),
            Self::Between { of, .. } => of,
        }
    }
}

/// Action of an actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Action {
    /// Has another speed from then on.
    Speed {
        /// New speed.
        target: Speed,
        /// Transition to it.
        dynamics: Dynamics,
    },
    /// Has one speed after the other, each reached on a straight line.
    Profile {
        /// Durations of the parts, seconds.
        times_s: Vec<f64>,
        /// Speeds at their ends, m/s.
        speeds_mps: Vec<f64>,
        /// Limits of the first part, which lasts longer where they need it.
        #[serde(default, skip_serializing_if = "Limits::is_none")]
        limits: Limits,
    },
    /// Changes lanes.
    ChangeLane {
        /// New lane.
        target: TargetLane,
        /// Offset from its middle to the left of the way that the actor goes, meters.
        offset_m: f64,
        /// Transition to it.
        dynamics: Dynamics,
    },
    /// Moves aside on its lane.
    Offset {
        /// Offset from the middle of the lane, or from `from`, to the left, meters.
        offset_m: f64,
        /// Road user that it counts from.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        from: Option<Who>,
        /// Transition to it.
        dynamics: Dynamics,
        /// True if it holds without end.
        #[serde(default)]
        continuous: bool,
    },
    /// Keeps a distance along the road.
    KeepGap {
        /// Other road user.
        to: Who,
        /// Distance, meters; or seconds at the speed of the other.
        gap: f64,
        /// True if `gap` is a time.
        is_time: bool,
        /// True if the distance is between boxes.
        between_boxes: bool,
        /// Side of the other.
        #[serde(default)]
        side: Side,
        /// True if it holds without end.
        continuous: bool,
        /// Limits of the changes of speed; without, the gap is there at once.
        #[serde(default)]
        limits: Limits,
    },
    /// Keeps a distance across the road.
    KeepBeside {
        /// Other road user.
        to: Who,
        /// Distance, meters.
        distance_m: f64,
        /// True if it is between boxes.
        between_boxes: bool,
        /// Side of the other.
        #[serde(default)]
        side: Side,
        /// True if it holds without end.
        continuous: bool,
        /// Limits of the lateral motion; without, the distance is there at once.
        #[serde(default)]
        limits: Limits,
    },
    /// Arrives at a place when another arrives at one.
    Arrive {
        /// Road user with which it arrives.
        with: Who,
        /// Place of the actor.
        at: Spot,
        /// Place of the other.
        other_at: Spot,
        /// Distance within which the actor has arrived, meters.
        tolerance_m: f64,
        /// Distance within which the other has arrived, meters.
        other_tolerance_m: f64,
        /// Speed at the arrival.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        speed: Option<Speed>,
        /// Way before the place that is driven at that speed, meters.
        #[serde(default)]
        steady_m: f64,
    },
    /// Follows a line.
    Follow {
        /// Points of the reference point's way, meters: world coordinates, or ahead and to the left
        /// of `seen_from`.
        points_m: Vec<[f64; 2]>,
        /// Road user from whose reference point they are seen when the action begins.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seen_from: Option<Who>,
        /// True if points count along the lanes of `seen_from`, and to the left of their middle.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        on_lanes: bool,
        /// Points that count from road users in other ways, instead of `points_m`, as they are when
        /// the action begins.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        places: Vec<Place>,
        /// Times at the points, seconds; empty: it keeps its own speed.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        times_s: Vec<f64>,
        /// True if times count from the start of the episode, otherwise from that of the action.
        #[serde(default)]
        is_absolute: bool,
    },
    /// Takes, again and again, the way that leads nearest to where the ego will be, without end.
    Attack {
        /// Length of a way, seconds, at most 60.
        ahead_s: f64,
        /// Time between plans, seconds, at most `ahead_s`.
        every_s: f64,
        /// Number of best ways of which it takes one, from 1.
        best: u32,
    },
    /// Goes along the lanes that lead through points.
    Route {
        /// Points, world coordinates, meters.
        points_m: Vec<[f64; 2]>,
    },
    /// Is put to a place.
    Teleport {
        /// The place.
        to: Spot,
    },
    /// Is shown or hidden.
    Show {
        /// True if it is shown.
        is_shown: bool,
    },
    /// Gives a variable a value.
    Set {
        /// Name of the variable.
        variable: String,
        /// New value.
        value: String,
        /// Arithmetic with the old value.
        #[serde(default)]
        by: Change,
    },
    /// Gives a traffic light a color, which it keeps until another action changes it.
    Light {
        /// Name of the light.
        light: String,
        /// New color.
        color: LightColor,
    },
    /// Begins a phase of a controller of traffic lights. Its lights follow their phases from there.
    Phase {
        /// Name of the controller.
        controller: String,
        /// Name of the phase.
        phase: String,
    },
    /// Takes time.
    Wait {
        /// Duration, seconds.
        duration_s: f64,
    },
}

/// Change of a variable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// The value replaces it.
    #[default]
    Set,
    /// The value is added.
    Add,
    /// The value is a factor.
    Multiply,
}
