//! Traffic lights: dynamic signals of roads, and references to them from other roads. The file
//! tells no phases.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, StopLine, TrafficLight};

use super::super::light_direction::{self, Directions};
use super::Road;
use super::junctions::RoadLanes;
use super::road_positions::along_m;
use crate::DecodeError;
use crate::traffic_light_form;
use crate::xml::Element;

/// Types of signals that are traffic lights (ASAM OpenDRIVE 1.8, signal types of no country): with
/// three lamps, with two, with one, and with arrows.
const LIGHT_TYPES: [&str; 6] = [
    "1000001", "1000009", "1000010", "1000011", "1000012", "1000020",
];

/// Types of them whose subtypes tell the direction of the arrows.
const ARROW_TYPES: [&str; 3] = ["1000010", "1000011", "1000012"];

/// Directions of the arrows of a light: all of them where it has none.
fn directions(kind: Option<&str>, subtype: Option<&str>) -> Directions {
    let (left, straight, right) = (Directions::LEFT, Directions::STRAIGHT, Directions::RIGHT);
    if !kind.is_some_and(|kind| ARROW_TYPES.contains(&kind)) {
        return Directions::ALL;
    }
    match subtype {
        Some("10") => left,
        Some("20") => right,
        Some("30") => straight,
        Some("40") => left.and(straight),
        Some("50") => straight.and(right),
        _ => Directions::ALL,
    }
}

/// Place on a road at which a light stops vehicles.
pub(super) struct RoadSignal {
    light: String,
    s_m: f64,
    /// Direction that it is for: along the reference line, against it, or both.
    is_forward: Option<bool>,
    /// Ranges of lane ids, none: all.
    validity: Vec<(f64, f64)>,
    directions: Directions,
    is_reference: bool,
}

/// Lights of a road, and references to lights.
pub(super) fn read(road: Element) -> Result<Vec<RoadSignal>, DecodeError> {
    let mut found = Vec::new();
    let Some(signals) = road.first("signals") else {
        return Ok(found);
    };
    for element in signals.elements() {
        let is_reference = element.name() == "signalReference";
        let is_light = element.attribute("dynamic") == Some("yes")
            && element
                .attribute("type")
                .is_some_and(|kind| LIGHT_TYPES.contains(&kind));
        if !(is_reference || element.name() == "signal" && is_light) {
            continue;
        }
        let ranges = element.all("validity").map(|range| {
            let ends = (range.number("fromLane")?, range.number("toLane")?);
            Ok((ends.0.min(ends.1), ends.0.max(ends.1)))
        });
        found.push(RoadSignal {
            light: element.needed_attribute("id")?.to_owned(),
            s_m: element.number("s")?,
            is_forward: match element.attribute("orientation") {
                Some("+") => Some(true),
                Some("-") => Some(false),
                _ => None,
            },
            validity: ranges.collect::<Result<_, DecodeError>>()?,
            directions: directions(element.attribute("type"), element.attribute("subtype")),
            is_reference,
        });
    }
    Ok(found)
}

/// The lights of all roads, with a stop line on each driving lane that they are for.
pub(super) fn lights(
    signals: &[Vec<RoadSignal>],
    roads: &[Road],
    indices: &[RoadLanes],
    lanes: &[Lane],
) -> Result<Vec<TrafficLight>, DecodeError> {
    let mut by_id = HashMap::new();
    let (mut lights, mut directions) = (Vec::<TrafficLight>::new(), Vec::new());
    for signal in signals
        .iter()
        .flatten()
        .filter(|signal| !signal.is_reference)
    {
        by_id.entry(signal.light.as_str()).or_insert_with(|| {
            lights.push(TrafficLight {
                name: signal.light.clone(),
                ..TrafficLight::default()
            });
            directions.push(signal.directions);
            lights.len() - 1
        });
    }
    for ((signals, road), indices) in signals.iter().zip(roads).zip(indices) {
        for signal in signals {
            if let Some(&light) = by_id.get(signal.light.as_str()) {
                lights[light].stop_lines.extend(signal.lines(
                    road,
                    indices,
                    lanes,
                    directions[light],
                ));
            }
        }
    }
    traffic_light_form::checked(lights)
}

impl RoadSignal {
    fn lines(
        &self,
        road: &Road,
        indices: &RoadLanes,
        lanes: &[Lane],
        directions: Directions,
    ) -> Vec<StopLine> {
        let (section, share) = road.section_at(self.s_m);
        let Some(by_id) = indices.sections.get(section) else {
            return Vec::new();
        };
        let is_for = |id: i64, is_forward: bool| {
            let id = id as f64;
            self.is_forward.is_none_or(|forward| forward == is_forward)
                && (self.validity.is_empty()
                    || self
                        .validity
                        .iter()
                        .any(|(from, to)| (*from..=*to).contains(&id)))
        };
        let mut lines: Vec<(usize, f64)> = by_id
            .iter()
            .filter(|(id, (lane, is_forward))| {
                is_for(**id, *is_forward) && lanes[*lane].kind == LaneKind::Driving
            })
            .map(|(_, &(lane, is_forward))| (lane, along_m(&lanes[lane], share, is_forward)))
            .collect();
        lines.sort_by_key(|(lane, _)| *lane);
        let line = |(lane, at_m)| light_direction::stop_line(lanes, lane, at_m, directions);
        lines.into_iter().filter_map(line).collect()
    }
}
