//! Traffic lights: regulatory elements of subtype `traffic_light`, their stop lines on the lanelets
//! that name them. The file tells no phases.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, StopLine, TrafficLight};
use glam::DVec3;

use super::super::budget::Budget;
use super::super::polyline::{foot_m, plan_length_m};
use super::{File, Lanelet, Plane, tag};
use crate::DecodeError;
use crate::traffic_light_form;
use crate::xml::Element;

/// True if a relation is a traffic light.
pub(super) fn is_light(relation: Element) -> bool {
    tag(relation, "type") == Some("regulatory_element")
        && tag(relation, "subtype") == Some("traffic_light")
}

/// The lights of a file in its order, those of driving lanelets alone. Vehicles stop at the end of
/// a lanelet where the light has no stop line, or one whose points are not in the file.
pub(super) fn lights(
    file: &File,
    plane: Plane,
    lanes: &[Lane],
    budget: &mut Budget,
) -> Result<Vec<TrafficLight>, DecodeError> {
    let mut lights = Vec::with_capacity(file.lights.len());
    let mut indices = HashMap::new();
    for light in &file.lights {
        let name = light.needed_attribute("id")?;
        indices.insert(name, lights.len());
        lights.push(TrafficLight {
            name: name.to_owned(),
            ..TrafficLight::default()
        });
    }
    for (lanelet, lane) in file.lanelets.iter().zip(lanes) {
        let named = lanelet
            .element
            .all("member")
            .filter(|member| member.attribute("role") == Some("regulatory_element"))
            .filter_map(|member| indices.get(member.attribute("ref")?).copied());
        if lane.kind != LaneKind::Driving {
            continue;
        }
        for light in named {
            let at_m = line_at_m(file, file.lights[light], (lanelet, lane), plane, budget)?;
            lights[light].stop_lines.push(StopLine {
                lane: lane.id.clone(),
                at_m,
                ..StopLine::default()
            });
        }
    }
    traffic_light_form::checked(lights)
}

/// Place on a lanelet of the line of a regulatory element, meters along it: the end of the lanelet
/// where the element has no line.
pub(super) fn line_at_m<'a>(
    file: &File<'a>,
    relation: Element,
    (lanelet, lane): (&Lanelet<'a>, &Lane),
    plane: Plane,
    budget: &mut Budget,
) -> Result<f64, DecodeError> {
    let mut members = relation.all("member");
    let line = members.find(|member| {
        member.attribute("role") == Some("ref_line") && member.attribute("type") == Some("way")
    });
    let way = line.and_then(|member| member.attribute("ref"));
    budget.spend(lane.centerline.len())?;
    // Maps that were cut out of larger ones may lack the line.
    let points = way.and_then(|way| file.points(lanelet, way, plane, budget).ok());
    Ok(match points {
        None => plan_length_m(&lane.centerline),
        Some((points, _)) => {
            let middle = points.iter().sum::<DVec3>() / points.len() as f64;
            foot_m(&lane.centerline, middle)
        }
    })
}
