//! Values of entities that conditions are about.

use decouplegs_scene::story::Direction;

use super::positions::Position;

/// Other end of a distance.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// An entity, by name.
    Entity(String),
    /// A place.
    Place(Position),
}

/// A value of an entity.
#[derive(Clone, Debug, PartialEq)]
pub enum Measure {
    /// Speed, m/s.
    Speed,
    /// Acceleration, m/s^2.
    Acceleration,
    /// Speed minus that of another, m/s.
    RelativeSpeed {
        /// Name of the other.
        to: String,
    },
    /// Way since the start, meters.
    Traveled,
    /// Time for which it stands, seconds.
    Standing,
    /// Time for which it is at the end of the road, seconds.
    AtEnd,
    /// Time for which it is off the road, seconds.
    OffRoad,
    /// Distance, meters.
    Distance {
        /// Other end.
        to: Target,
        /// Direction in which it is measured.
        direction: Direction,
        /// True if it is measured between boxes, not reference points.
        between_boxes: bool,
    },
    /// Distance ahead over its speed, seconds.
    Headway {
        /// Name of the one ahead.
        to: String,
        /// Direction in which the distance is measured.
        direction: Direction,
        /// True if the distance is measured between boxes.
        between_boxes: bool,
    },
    /// Distance over the speed at which it shrinks, seconds.
    TimeToCollision {
        /// Entity or place that it would collide with.
        to: Target,
        /// Direction in which the distance is measured.
        direction: Direction,
        /// True if the distance is measured between boxes.
        between_boxes: bool,
    },
    /// Number of others that it touches: of those named, or of all.
    Touched {
        /// Names of the others.
        with: Vec<String>,
    },
    /// Number of others in an area of lanes: of those named, or of all.
    Near {
        /// Names of the others.
        with: Vec<String>,
        /// Way ahead, meters.
        ahead_m: f64,
        /// Way behind, meters.
        behind_m: f64,
        /// First and last lane to the left of its own.
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
