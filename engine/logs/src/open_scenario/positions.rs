//! Positions of entities and waypoints.

use glam::DVec2;

use super::Skipped;
use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::Element;

/// A position, as the file gives it.
#[derive(Clone, Debug, PartialEq)]
pub enum Position {
    /// Coordinates of the map.
    World {
        /// Place from above, meters.
        at_m: DVec2,
        /// Heading, radians from x towards y.
        heading_rad: f64,
    },
    /// Position on a lane of an OpenDRIVE road.
    Lane {
        /// Id of the road.
        road: String,
        /// Id of the lane.
        lane: i64,
        /// Position along the road's reference line, meters.
        s_m: f64,
        /// Offset from the lane's middle to the left of the reference line, meters.
        offset_m: f64,
    },
    /// Position beside the reference line of an OpenDRIVE road.
    Road {
        /// Id of the road.
        road: String,
        /// Position along the road's reference line, meters.
        s_m: f64,
        /// Offset to the left of that line, meters.
        t_m: f64,
    },
    /// Relative to the lane of another entity.
    RelativeLane {
        /// Name of the other entity.
        entity: String,
        /// Lanes to its left, negative to the right.
        lanes: i64,
        /// Distance ahead of the entity along the lane, meters.
        ahead_m: f64,
    },
}

/// The position in `element`, a `<Position>`; `None` if it is of a kind that is not read.
pub(super) fn read(
    element: Element,
    skipped: &mut Skipped,
) -> Result<Option<Position>, DecodeError> {
    let Some(kind) = element.elements().next() else {
        return Err(element.fault("it is empty; expected a position"));
    };
    let lanes = |value: f64| value.clamp(-1000.0, 1000.0) as i64;
    let position = match kind.name() {
        "WorldPosition" => Position::World {
            at_m: DVec2::new(kind.number("x")?, kind.number("y")?),
            heading_rad: kind.number_or("h", 0.0)?,
        },
        "LanePosition" => Position::Lane {
            road: kind.needed_attribute("roadId")?.to_owned(),
            lane: lanes(kind.number("laneId")?),
            s_m: kind.number("s")?,
            offset_m: kind.number_or("offset", 0.0)?,
        },
        "RoadPosition" => Position::Road {
            road: kind.needed_attribute("roadId")?.to_owned(),
            s_m: kind.number("s")?,
            t_m: kind.number("t")?,
        },
        "RelativeLanePosition" => {
            // Meters along the lane since version 1.1, along the road before.
            let ahead_m = match kind.attribute("dsLane") {
                Some(_) => kind.number("dsLane")?,
                None => kind.number_or("ds", 0.0)?,
            };
            Position::RelativeLane {
                entity: kind.needed_attribute("entityRef")?.to_owned(),
                lanes: lanes(kind.number("dLane")?),
                ahead_m,
            }
        }
        _ => {
            skipped.add(kind, "positions of this kind are not read");
            return Ok(None);
        }
    };
    Ok(Some(position))
}
