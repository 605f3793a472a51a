//! Routes and trajectories, in the file and in catalogs.

use decouplegs_asset::DecodeError;

use super::catalogs::Catalogs;
use super::parameters::Node;
use super::positions::{self, Position};
use super::{Skipped, curves};

/// Most points of a route or trajectory, all positions that it leads to counted.
pub(super) const POINTS_MAX: usize = 100_000;

/// Points of a trajectory and their times, seconds, where it gives them.
pub(super) type TimedPoints = Vec<(Position, Option<f64>)>;

/// Waypoints of the `<Route>` in `holder`, or of the one that its `<CatalogReference>` names;
/// `None` if they cannot be read.
pub(super) fn route(
    holder: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Vec<Position>>, DecodeError> {
    match (holder.first("Route"), holder.first("CatalogReference")) {
        (Some(route), _) => waypoints(route, catalogs, skipped),
        (None, Some(reference)) => {
            let read = catalogs.with_entry(reference, skipped, |route, skipped| {
                waypoints(route, catalogs, skipped)
            })?;
            if read.is_none() {
                skipped.add(reference, "the catalog of its route was not found");
            }
            Ok(read.flatten())
        }
        (None, None) => {
            skipped.add(holder, "it has no route");
            Ok(None)
        }
    }
}

fn waypoints(
    route: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Vec<Position>>, DecodeError> {
    if route.truth("closed")? {
        skipped.add(route, "a closed route ends at its last waypoint");
    }
    let places = route
        .all("Waypoint")
        .filter_map(|waypoint| waypoint.first("Position"));
    let read = all(places, catalogs, skipped)?;
    if read.as_ref().is_some_and(Vec::is_empty) {
        skipped.add(route, "it has no positions that are read");
        return Ok(None);
    }
    Ok(read)
}

/// Points of the `<Trajectory>` in `holder`, or of the one that its `<CatalogReference>` names, and
/// their times, seconds; `None` if they cannot be read.
pub(super) fn trajectory(
    holder: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<TimedPoints>, DecodeError> {
    match (holder.first("Trajectory"), holder.first("CatalogReference")) {
        (Some(trajectory), _) => points(trajectory, catalogs, skipped),
        (None, Some(reference)) => {
            let read = catalogs.with_entry(reference, skipped, |trajectory, skipped| {
                points(trajectory, catalogs, skipped)
            })?;
            if read.is_none() {
                skipped.add(reference, "the catalog of its trajectory was not found");
            }
            Ok(read.flatten())
        }
        (None, None) => {
            skipped.add(holder, "it has no trajectory");
            Ok(None)
        }
    }
}

fn points(
    trajectory: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<TimedPoints>, DecodeError> {
    let shape = trajectory.first("Shape").unwrap_or(trajectory);
    let Some(line) = shape.first("Polyline") else {
        let read = curves::read(shape, catalogs, skipped)?;
        if read.is_none() {
            skipped.add(shape, "its shape is not read");
        }
        return Ok(read);
    };
    let mut times_s = Vec::new();
    for vertex in line.all("Vertex") {
        let time_s = match vertex.attribute("time")? {
            Some(_) => Some(vertex.number("time")?),
            None => None,
        };
        times_s.push(time_s);
    }
    let places = line
        .all("Vertex")
        .filter_map(|vertex| vertex.first("Position"));
    let Some(read) = all(places, catalogs, skipped)? else {
        return Ok(None);
    };
    if read.is_empty() || read.len() != times_s.len() {
        skipped.add(line, "it has no positions that are read");
        return Ok(None);
    }
    Ok(Some(read.into_iter().zip(times_s).collect()))
}

/// All of `places`; `None` if one of them cannot be read.
fn all<'a>(
    places: impl Iterator<Item = Node<'a>>,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Vec<Position>>, DecodeError> {
    let mut read = Vec::new();
    for place in places {
        if !skipped.counts_points(1, POINTS_MAX) {
            return Err(place.fault(format!(
                "routes and trajectories have more than {POINTS_MAX} points together"
            )));
        }
        match positions::read(place, catalogs, skipped)? {
            Some(position) => read.push(position),
            None => return Ok(None),
        }
    }
    Ok(Some(read))
}
