//! Positions of entities and waypoints.

use decouplegs_asset::DecodeError;
use glam::DVec2;

use super::catalogs::Catalogs;
use super::parameters::Node;
use super::{Skipped, routes};

/// Deepest nesting of positions on routes in the waypoints of others.
const NESTING_MAX: u32 = 4;

/// A heading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Radians from x towards y, or from the direction that the place has.
    pub rad: f64,
    /// True if it counts from the direction of the road, or of the other entity.
    pub is_relative: bool,
}

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
    /// Degrees on the Earth.
    Geo {
        /// Latitude, degrees.
        latitude_deg: f64,
        /// Longitude, degrees.
        longitude_deg: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
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
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// Position beside the reference line of an OpenDRIVE road.
    Road {
        /// Id of the road.
        road: String,
        /// Position along the road's reference line, meters.
        s_m: f64,
        /// Offset to the left of that line, meters.
        t_m: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// Relative to the lane of another entity.
    RelativeLane {
        /// Name of the other entity.
        entity: String,
        /// Lanes to the left of the reference line's direction from its own, negative to the right:
        /// the difference of lane ids, lane 0 not counted.
        lanes: i64,
        /// Distance from the entity, meters.
        along: Along,
        /// Offset from the lane's middle, meters, to the left of the reference line.
        offset_m: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// Relative to the road coordinates of another entity.
    RelativeRoad {
        /// Name of the other entity.
        entity: String,
        /// Difference along the road's reference line, meters.
        ds_m: f64,
        /// Difference to the left of that line, meters.
        dt_m: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// Relative to the reference point of another entity.
    RelativeEntity {
        /// Name of the other entity.
        entity: String,
        /// Difference, meters.
        offset_m: DVec2,
        /// True if the difference counts in the frame of the entity, x ahead and y to the left;
        /// otherwise in coordinates of the map.
        is_in_its_frame: bool,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// Position along a route.
    Route {
        /// Waypoints of the route.
        waypoints: Vec<Position>,
        /// Distance from the first of them along the route, meters.
        path_m: f64,
        /// Id of the lane there; `None`: `offset_m` counts from the reference line.
        lane: Option<i64>,
        /// Offset to the left of the reference line's direction, meters.
        offset_m: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
    /// A place, and another relative to what stands there.
    After {
        /// The place.
        before: Box<Position>,
        /// A position relative to the entity itself.
        by: Box<Position>,
    },
    /// Place seen from another, whose heading counts.
    Beside {
        /// Place that it is seen from.
        of: Box<Position>,
        /// Offset ahead and to the left, meters.
        offset_m: DVec2,
    },
    /// Mean of places.
    Between {
        /// The places.
        of: Vec<Position>,
        /// Shares of them, 1 together.
        shares: Vec<f64>,
    },
    /// Position along a trajectory.
    Trajectory {
        /// Points of the trajectory.
        points: Vec<Position>,
        /// Distance along it, meters.
        path_m: f64,
        /// Offset to its left, meters.
        offset_m: f64,
        /// Heading, if the file gives one.
        heading: Option<Heading>,
    },
}

/// Distance along a road or a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Along {
    /// Meters along the road's reference line, in its direction.
    Road(f64),
    /// Meters along the middle of the lane in driving direction.
    Lane(f64),
}

impl Position {
    /// Name of the entity that it is relative to.
    #[must_use]
    pub fn other(&self) -> Option<&str> {
        match self {
            Self::RelativeLane { entity, .. }
            | Self::RelativeRoad { entity, .. }
            | Self::RelativeEntity { entity, .. } => Some(entity),
            _ => None,
        }
    }

    /// Place of the entity that an action is about, which [`Self::name_own`] names.
    pub(super) fn own() -> Self {
        Self::RelativeEntity {
            entity: String::new(),
            offset_m: DVec2::ZERO,
            is_in_its_frame: true,
            heading: None,
        }
    }

    /// Names the entity that an action is about.
    pub(super) fn name_own(&mut self, name: &str) {
        match self {
            Self::RelativeEntity { entity, .. } if entity.is_empty() => name.clone_into(entity),
            Self::Beside { of, .. } => of.name_own(name),
            _ => {}
        }
    }
}

/// An id or a difference of lanes.
pub(super) fn lanes(value: f64) -> i64 {
    value.clamp(-1000.0, 1000.0) as i64
}

fn heading(kind: Node) -> Result<Option<Heading>, DecodeError> {
    kind.first("Orientation")
        .map(|orientation| {
            Ok(Heading {
                rad: orientation.number_or("h", 0.0)?,
                is_relative: orientation.is("type", "relative")?,
            })
        })
        .transpose()
}

/// The position in `element`, a `<Position>` or `<TargetPosition>`; `None` if it is of a kind that
/// is not read.
pub(super) fn read(
    element: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Position>, DecodeError> {
    let Some(kind) = element.elements().next() else {
        return Err(element.fault("it is empty; expected a position"));
    };
    if matches!(kind.name(), "RoutePosition" | "TrajectoryPosition") {
        return on_path(kind, catalogs, skipped);
    }
    let heading = heading(kind)?;
    let entity = || kind.needed_attribute("entityRef").map(String::from);
    let position = match kind.name() {
        "WorldPosition" => Position::World {
            at_m: DVec2::new(kind.number("x")?, kind.number("y")?),
            heading_rad: kind.number_or("h", 0.0)?,
        },
        "GeoPosition" => {
            // Radians before version 1.2.
            let degrees = |degrees: &str, radians: &str| match kind.attribute(degrees)? {
                Some(_) => kind.number(degrees),
                None => kind.number(radians).map(f64::to_degrees),
            };
            Position::Geo {
                latitude_deg: degrees("latitudeDeg", "latitude")?,
                longitude_deg: degrees("longitudeDeg", "longitude")?,
                heading,
            }
        }
        "LanePosition" => Position::Lane {
            road: kind.needed_attribute("roadId")?.into(),
            lane: lanes(kind.number("laneId")?),
            s_m: kind.number("s")?,
            offset_m: kind.number_or("offset", 0.0)?,
            heading,
        },
        "RoadPosition" => Position::Road {
            road: kind.needed_attribute("roadId")?.into(),
            s_m: kind.number("s")?,
            t_m: kind.number_or("t", 0.0)?,
            heading,
        },
        "RelativeLanePosition" => Position::RelativeLane {
            entity: entity()?,
            lanes: lanes(kind.number_or("dLane", 0.0)?),
            along: match kind.attribute("dsLane")? {
                Some(_) => Along::Lane(kind.number("dsLane")?),
                None => Along::Road(kind.number_or("ds", 0.0)?),
            },
            offset_m: kind.number_or("offset", 0.0)?,
            heading,
        },
        "RelativeRoadPosition" => Position::RelativeRoad {
            entity: entity()?,
            ds_m: kind.number_or("ds", 0.0)?,
            dt_m: kind.number_or("dt", 0.0)?,
            heading,
        },
        "RelativeObjectPosition" | "RelativeWorldPosition" => Position::RelativeEntity {
            entity: entity()?,
            offset_m: DVec2::new(kind.number_or("dx", 0.0)?, kind.number_or("dy", 0.0)?),
            is_in_its_frame: kind.name() == "RelativeObjectPosition",
            heading,
        },
        _ => {
            skipped.add(kind, "positions of this kind are not read");
            return Ok(None);
        }
    };
    Ok(Some(position))
}

/// The `<RoutePosition>` or `<TrajectoryPosition>` in `kind`.
fn on_path(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Position>, DecodeError> {
    // Points of a route may be positions on other routes: the stack ends before they do.
    if skipped.nesting == NESTING_MAX {
        skipped.add(kind, "positions on routes of routes are not read");
        return Ok(None);
    }
    skipped.nesting += 1;
    let read = if kind.name() == "RoutePosition" {
        on_route(kind, catalogs, skipped)
    } else {
        on_trajectory(kind, catalogs, skipped)
    };
    skipped.nesting -= 1;
    read
}

fn on_route(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Position>, DecodeError> {
    let holder = kind.first("RouteRef").unwrap_or(kind);
    let Some(waypoints) = routes::route(holder, catalogs, skipped)? else {
        return Ok(None);
    };
    let heading = heading(kind)?;
    let place = kind.needed("InRoutePosition")?;
    // Their names before version 1.1, too.
    let first = |names: [&str; 2]| names.into_iter().find_map(|name| place.first(name));
    if let Some(lane) = first(["FromLaneCoordinates", "LanePosition"]) {
        return Ok(Some(Position::Route {
            waypoints,
            path_m: lane.number("pathS")?,
            lane: Some(lanes(lane.number("laneId")?)),
            offset_m: lane.number_or("laneOffset", 0.0)?,
            heading,
        }));
    }
    if let Some(road) = first(["FromRoadCoordinates", "RoadPosition"]) {
        return Ok(Some(Position::Route {
            waypoints,
            path_m: road.number("pathS")?,
            lane: None,
            offset_m: road.number_or("t", 0.0)?,
            heading,
        }));
    }
    skipped.add(
        place,
        "the place on a route that another entity has is not read",
    );
    Ok(None)
}

fn on_trajectory(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Position>, DecodeError> {
    let holder = kind.first("TrajectoryRef").unwrap_or(kind);
    let Some(points) = routes::trajectory(holder, catalogs, skipped)? else {
        return Ok(None);
    };
    Ok(Some(Position::Trajectory {
        points: points.into_iter().map(|(position, _)| position).collect(),
        path_m: kind.number("s")?,
        offset_m: kind.number_or("t", 0.0)?,
        heading: heading(kind)?,
    }))
}
