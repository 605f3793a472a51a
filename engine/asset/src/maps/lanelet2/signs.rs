//! Stop and yield signs: regulatory elements of subtype `right_of_way`, for the lanelets with the
//! role `yield`. The sign is a stop sign where the element refers to one.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind, SignKind, StopLine, TrafficSign};

use super::super::budget::Budget;
use super::lights::line_at_m;
use super::{File, Plane, tag};
use crate::DecodeError;
use crate::traffic_sign_form::{SIGNS_MAX, check};
use crate::xml::{Element, excerpt};

/// Codes of stop signs, in Germany and in the United States.
const STOP_SIGNS: [&str; 2] = ["de206", "usR1-1"];

/// True if a relation says who goes first.
pub(super) fn is_right_of_way(relation: Element) -> bool {
    tag(relation, "type") == Some("regulatory_element")
        && tag(relation, "subtype") == Some("right_of_way")
}

/// True if a way is a stop sign.
pub(super) fn is_stop_sign(way: Element) -> bool {
    tag(way, "type") == Some("traffic_sign")
        && tag(way, "subtype").is_some_and(|code| STOP_SIGNS.contains(&code))
}

/// The signs of a file in its order, those of driving lanelets alone.
pub(super) fn signs(
    file: &File,
    plane: Plane,
    lanes: &[Lane],
    budget: &mut Budget,
) -> Result<Vec<TrafficSign>, DecodeError> {
    let ids = file.lanelets.iter().enumerate();
    let by_id: HashMap<&str, usize> = ids.map(|(at, lanelet)| (lanelet.id, at)).collect();
    let mut signs: Vec<TrafficSign> = Vec::new();
    // Files name a lanelet in several elements, one for each road that goes first.
    let mut sign_of: HashMap<usize, usize> = HashMap::new();
    for &relation in &file.rights {
        let members = |role: &'static str| {
            let members = relation.all("member");
            members
                .filter(move |member| member.attribute("role") == Some(role))
                .filter_map(|member| member.attribute("ref"))
        };
        let is_stop = members("refers").any(|way| file.stop_signs.contains(way));
        let kind = match is_stop {
            true => SignKind::Stop,
            false => SignKind::Yield,
        };
        for at in members("yield").filter_map(|id| by_id.get(id).copied()) {
            if lanes[at].kind != LaneKind::Driving {
                continue;
            }
            let at_m = line_at_m(
                file,
                relation,
                (&file.lanelets[at], &lanes[at]),
                plane,
                budget,
            )?;
            let lane = lanes[at].id.clone();
            let line = StopLine {
                lane,
                at_m,
                ..StopLine::default()
            };
            let sign = TrafficSign { kind, line };
            match sign_of.get(&at) {
                Some(&known) if kind == SignKind::Stop => signs[known] = sign,
                Some(_) => {}
                None => {
                    sign_of.insert(at, signs.len());
                    signs.push(sign);
                }
            }
        }
    }
    if signs.len() > SIGNS_MAX {
        return Err(DecodeError::Malformed(format!(
            "{} signs; expected at most {SIGNS_MAX}",
            signs.len()
        )));
    }
    for sign in &signs {
        check(sign).map_err(|fault| {
            let lane = excerpt(&sign.line.lane);
            DecodeError::Malformed(format!("sign on lanelet {lane}: {}", fault.reason))
        })?;
    }
    Ok(signs)
}
