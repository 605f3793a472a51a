//! Road users of a CommonRoad scenario (`.xml`, versions 2018b and 2020a).
//!
//! Read are dynamic obstacles: the initial state and, where it has one, the trajectory. Values that
//! are intervals count with their middle, positions that are areas with the area's center; moments
//! are steps times the scenario's `timeStepSize`. Static and environment obstacles, predicted
//! occupancies and positions that only name a lanelet are not read. The format has no height, see
//! [`super::nominal_height_m`].

use std::collections::HashSet;

use decouplegs_scene::{Track, TrackPoint};
use glam::DVec2;

use super::{finished, nominal_height_m};
use crate::DecodeError;
use crate::maps::commonroad::scenario;
use crate::xml::{Element, excerpt, parse};

/// Reads the dynamic obstacles of a scenario.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode(bytes: &[u8]) -> Result<Vec<Track>, DecodeError> {
    let document = parse(bytes)?;
    let root = scenario(&document)?;
    let step_s = root.number("timeStepSize")?;
    if step_s <= 0.0 {
        return Err(root.fault(format!(
            "timeStepSize=\"{step_s}\"; expected seconds above zero"
        )));
    }
    let is_dynamic = |element: &Element| match element.name() {
        "dynamicObstacle" => true,
        "obstacle" => element
            .first("role")
            .is_some_and(|role| role.text() == "dynamic"),
        _ => false,
    };
    let mut ids = HashSet::new();
    let mut tracks = Vec::new();
    for element in root.elements().filter(is_dynamic) {
        let track = track(element, step_s)?;
        if !ids.insert(track.id.clone()) {
            return Err(element.fault(format!(
                "a second obstacle with the id {}; expected one",
                excerpt(&track.id)
            )));
        }
        tracks.push(track);
    }
    finished(tracks)
}

fn track(element: Element, step_s: f64) -> Result<Track, DecodeError> {
    let class = element.needed("type")?.text().to_lowercase();
    let trajectory = element.first("trajectory");
    let states = element
        .first("initialState")
        .into_iter()
        .chain(trajectory.into_iter().flat_map(|all| all.all("state")));
    let mut points = Vec::new();
    for state in states {
        let orientation = state.first("orientation").map(scalar).transpose()?;
        points.push(TrackPoint {
            time_s: scalar(state.needed("time")?)? * step_s,
            position_m: position(state.needed("position")?)?,
            z_m: None,
            yaw_rad: orientation,
        });
    }
    let shape = element
        .first("shape")
        .and_then(|shape| shape.elements().next());
    let footprint = shape.map(footprint_m).transpose()?.flatten();
    let dims_m = footprint.map(|(length_m, width_m)| [length_m, width_m, nominal_height_m(&class)]);
    Ok(Track {
        id: element.needed_attribute("id")?.to_owned(),
        class,
        dims_m,
        points,
    })
}

/// A value that is exact or, of an interval, its middle.
fn scalar(element: Element) -> Result<f64, DecodeError> {
    if let Some(exact) = element.first("exact") {
        return exact.text_number();
    }
    let [start, end] = [
        element.needed("intervalStart")?,
        element.needed("intervalEnd")?,
    ]
    .map(Element::text_number);
    Ok(0.5 * start? + 0.5 * end?)
}

/// The point that a position element names, or the center of its area.
fn position(element: Element) -> Result<DVec2, DecodeError> {
    let Some(position) = element.elements().next() else {
        return Err(element.fault("it is empty"));
    };
    match position.name() {
        "point" => xy(position),
        "rectangle" | "circle" => xy(position.needed("center")?),
        "polygon" => {
            let (min, max) = extent(position)?;
            Ok(0.5 * min + 0.5 * max)
        }
        _ => Err(position.fault("expected a point, rectangle, circle or polygon")),
    }
}

fn xy(element: Element) -> Result<DVec2, DecodeError> {
    Ok(DVec2::new(
        element.needed("x")?.text_number()?,
        element.needed("y")?.text_number()?,
    ))
}

/// Least and largest coordinates of a polygon.
fn extent(polygon: Element) -> Result<(DVec2, DVec2), DecodeError> {
    let mut extent: Option<(DVec2, DVec2)> = None;
    for point in polygon.all("point") {
        let position = xy(point)?;
        extent = Some(extent.map_or((position, position), |(min, max)| {
            (min.min(position), max.max(position))
        }));
    }
    extent.ok_or_else(|| polygon.fault("it has no points"))
}

/// Length and width of a shape, in the road user's own frame.
fn footprint_m(shape: Element) -> Result<Option<(f64, f64)>, DecodeError> {
    let (length_m, width_m) = match shape.name() {
        "rectangle" => (
            shape.needed("length")?.text_number()?,
            shape.needed("width")?.text_number()?,
        ),
        "circle" => {
            let radius_m = shape.needed("radius")?.text_number()?;
            (2.0 * radius_m, 2.0 * radius_m)
        }
        "polygon" => {
            let (min, max) = extent(shape)?;
            (max - min).into()
        }
        _ => return Ok(None),
    };
    if length_m > 0.0 && width_m > 0.0 && length_m.is_finite() && width_m.is_finite() {
        return Ok(Some((length_m, width_m)));
    }
    Err(shape.fault(format!(
        "{length_m} by {width_m} m; expected a size above zero"
    )))
}
