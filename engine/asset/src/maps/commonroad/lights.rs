//! Traffic lights of a scenario, with their cycles, their directions and the stop lines of
//! lanelets.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, LightColor, LightPhase, TrafficLight};
use glam::DVec3;

use super::super::light_direction::{self, Directions};
use super::super::polyline::{foot_m, plan_length_m};
use crate::DecodeError;
use crate::traffic_light_form;
use crate::xml::{Element, excerpt};

/// Time step of a scenario that has none, seconds.
const STEP_S: f64 = 0.1;

/// The lights that are active, in the order of the file. Vehicles stop at the end of a lanelet
/// without a stop line. Red and yellow together count as red.
pub(super) fn lights(
    root: Element,
    lanelets: &[Element],
    lanes: &[Lane],
) -> Result<Vec<TrafficLight>, DecodeError> {
    let step_s = root.number_or("timeStepSize", STEP_S)?;
    let (mut lights, mut all_directions) = (Vec::new(), Vec::new());
    let mut indices = HashMap::new();
    for element in root.all("trafficLight") {
        if let Some(light) = light(element, step_s)? {
            indices.insert(element.needed_attribute("id")?, lights.len());
            lights.push(light);
            all_directions.push(directions(element)?);
        }
    }
    let driven = lanelets.iter().zip(lanes).enumerate();
    for (at, (lanelet, lane)) in driven.filter(|(_, (_, lane))| lane.kind == LaneKind::Driving) {
        let line = lanelet.first("stopLine");
        let of_line = line
            .into_iter()
            .flat_map(|line| line.all("trafficLightRef"));
        let mut named: Vec<usize> = lanelet
            .all("trafficLightRef")
            .chain(of_line)
            .filter_map(|light| indices.get(light.attribute("ref")?).copied())
            .collect();
        named.sort_unstable();
        named.dedup();
        if named.is_empty() {
            continue;
        }
        let at_m = stop_at_m(*lanelet, lane)?;
        for light in named {
            let line = light_direction::stop_line(lanes, at, at_m, all_directions[light]);
            lights[light].stop_lines.extend(line);
        }
    }
    traffic_light_form::checked(lights)
}

/// Place of the stop line of a lanelet, meters along its lane; its end without one.
pub(super) fn stop_at_m(lanelet: Element, lane: &Lane) -> Result<f64, DecodeError> {
    let line = lanelet.first("stopLine");
    let ends = line.into_iter().flat_map(|line| line.all("point"));
    let ends = ends.map(|point| {
        let (x, y) = (point.needed("x")?, point.needed("y")?);
        Ok(DVec3::new(x.text_number()?, y.text_number()?, 0.0))
    });
    let ends: Vec<DVec3> = ends.collect::<Result<_, DecodeError>>()?;
    Ok(match ends.len() {
        0 => plan_length_m(&lane.centerline),
        count => foot_m(&lane.centerline, ends.iter().sum::<DVec3>() / count as f64),
    })
}

/// Directions that a light is for: all of them where the file tells none.
fn directions(light: Element) -> Result<Directions, DecodeError> {
    let Some(direction) = light.first("direction") else {
        return Ok(Directions::ALL);
    };
    let (left, straight, right) = (Directions::LEFT, Directions::STRAIGHT, Directions::RIGHT);
    Ok(match direction.text() {
        "left" => left,
        "straight" => straight,
        "right" => right,
        "leftStraight" => left.and(straight),
        "straightRight" => straight.and(right),
        "leftRight" => left.and(right),
        "all" => Directions::ALL,
        other => {
            return Err(direction.fault(format!(
                "the direction '{}'; expected left, straight, right, leftStraight, \
                 straightRight, leftRight or all",
                excerpt(other)
            )));
        }
    })
}

/// A light, `None` where it is out of order.
fn light(element: Element, step_s: f64) -> Result<Option<TrafficLight>, DecodeError> {
    let mut light = TrafficLight {
        name: element.needed_attribute("id")?.to_owned(),
        ..TrafficLight::default()
    };
    if element
        .first("active")
        .is_some_and(|active| active.text() == "false")
    {
        return Ok(None);
    }
    let Some(cycle) = element.first("cycle") else {
        return Ok(Some(light));
    };
    for part in cycle.all("cycleElement") {
        let color = part.needed("color")?;
        let color = match color.text() {
            "red" | "redYellow" => LightColor::Red,
            "yellow" => LightColor::Yellow,
            "green" => LightColor::Green,
            "inactive" => return Ok(None),
            other => {
                return Err(color.fault(format!(
                    "the color '{}'; expected red, redYellow, yellow, green or inactive",
                    excerpt(other)
                )));
            }
        };
        let duration_s = step_s * part.needed("duration")?.text_number()?;
        light.phases.push(LightPhase { color, duration_s });
    }
    if let Some(offset) = cycle.first("timeOffset") {
        light.offset_s = -step_s * offset.text_number()?;
    }
    Ok(Some(light))
}
