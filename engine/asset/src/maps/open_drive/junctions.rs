//! Contacts of lanes of sections, roads and junctions, from which successors follow.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneKind};
use glam::{DVec2, DVec3};

use super::lanes::whole;
use super::{Contact, LinkTarget, Road};
use crate::DecodeError;
use crate::maps::links::join;
use crate::xml::Element;

/// Indices of a road's lanes in the list of all lanes.
#[derive(Default)]
pub(super) struct RoadLanes {
    /// For each section, indices by lane id, each with whether traffic runs along the road.
    pub(super) sections: Vec<HashMap<i64, (usize, bool)>>,
}

/// A lane's end along its road.
#[derive(Clone, Copy)]
struct LaneEnd {
    lane: usize,
    contact: Contact,
    /// True if traffic runs along the road.
    is_forward: bool,
}

/// All roads, what touches what among their lanes, and the lanes themselves.
pub(super) struct Network<'a> {
    pub(super) roads: &'a [Road],
    pub(super) indices: &'a [RoadLanes],
    /// Positions of roads by id.
    pub(super) by_id: &'a HashMap<String, usize>,
    pub(super) lanes: &'a mut [Lane],
    /// Links that were dropped because the ends of their lanes are apart: the two lanes.
    pub(super) dropped: Vec<[usize; 2]>,
}

/// Ends of lanes that are farther apart do not meet, meters.
const GAP_M_MAX: f64 = 2.0;
/// Ends that touch without a link, for a report: distance, meters, and difference of directions,
/// radians.
const TOUCHING_M: f64 = 0.25;
const TOUCHING_RAD: f64 = 0.5;

impl Network<'_> {
    /// Joins what the lanes of sections and of roads say that they touch.
    pub(super) fn join_lanes(&mut self) {
        let roads = self.roads;
        for (road_at, road) in roads.iter().enumerate() {
            for (section_at, section) in road.sections.iter().enumerate() {
                for lane in section.left.iter().chain(&section.right) {
                    let links = [
                        (Contact::Start, &lane.predecessors),
                        (Contact::End, &lane.successors),
                    ];
                    for (contact, linked) in links {
                        for &linked in linked {
                            self.join_lane([road_at, section_at], lane.id, contact, linked);
                        }
                    }
                }
            }
        }
    }

    /// Joins the end of a lane with the lane `linked` across it. A road may give the wrong end of
    /// the one that it touches: then the other is tried.
    fn join_lane(&mut self, at: [usize; 2], id: i64, contact: Contact, linked: i64) {
        let [road_at, section_at] = at;
        let Some(from) = self.end(road_at, section_at, id, contact) else {
            return;
        };
        let Some((road, section, given)) = self.across(road_at, section_at, contact) else {
            return;
        };
        let given_end = self.end(road, section, linked, given);
        let other_end = if road == road_at {
            None
        } else {
            let section = self.outer_section(road, given.other());
            section.and_then(|section| self.end(road, section, linked, given.other()))
        };
        self.touch_one_of(from, [given_end, other_end].into_iter().flatten().collect());
    }

    /// Joins `from` with the first of `ends` that it meets. None of them: the link is dropped.
    fn touch_one_of(&mut self, from: LaneEnd, ends: Vec<LaneEnd>) {
        match ends.iter().find(|end| self.gap_m(from, **end) <= GAP_M_MAX) {
            Some(end) => self.touch(from, *end),
            None => {
                if let Some(end) = ends.first() {
                    self.dropped.push([from.lane, end.lane]);
                }
            }
        }
    }

    /// Distance between two ends of lanes: between the lines from border to border there.
    fn gap_m(&self, a: LaneEnd, b: LaneEnd) -> f64 {
        let across = |end: LaneEnd| {
            let lane = &self.lanes[end.lane];
            let at = |line: &[DVec3]| {
                let point = if (end.contact == Contact::Start) == end.is_forward {
                    line.first()
                } else {
                    line.last()
                };
                point.map_or(DVec2::ZERO, |point| point.truncate())
            };
            [at(&lane.left), at(&lane.right)]
        };
        let (a, b) = (across(a), across(b));
        let to_segment_m = |point: DVec2, [from, to]: [DVec2; 2]| {
            let along = to - from;
            let share = (point - from).dot(along) / along.length_squared().max(1e-12);
            point.distance(from + share.clamp(0.0, 1.0) * along)
        };
        let distances_m = a
            .into_iter()
            .map(|point| to_segment_m(point, b))
            .chain(b.into_iter().map(|point| to_segment_m(point, a)));
        distances_m.fold(f64::INFINITY, f64::min)
    }

    /// Warns of links that were dropped, and of driving lanes whose ends touch without a link.
    pub(super) fn report(&self) {
        let named = |pairs: &[[usize; 2]]| {
            const NAMED_MAX: usize = 3;
            let pairs = pairs.iter().take(NAMED_MAX);
            let named = pairs
                .map(|[from, to]| format!("{} to {}", self.lanes[*from].id, self.lanes[*to].id));
            named.collect::<Vec<_>>().join(", ")
        };
        let mut dropped = self.dropped.clone();
        for pair in &mut dropped {
            pair.sort_unstable();
        }
        dropped.sort_unstable();
        dropped.dedup();
        if !dropped.is_empty() {
            log::warn!(
                "{} links of lanes are dropped, because their ends are more than {GAP_M_MAX} m apart: {}",
                dropped.len(),
                named(&dropped)
            );
        }
        let touching = self.touching();
        if !touching.is_empty() {
            log::warn!(
                "{} driving lanes end where others begin without a link: {}",
                touching.len(),
                named(&touching)
            );
        }
    }

    /// Driving lanes without a successor, each with one without a predecessor that begins at its
    /// end and leads on.
    fn touching(&self) -> Vec<[usize; 2]> {
        let cell = |point: DVec3| {
            let cell = (point.truncate() / TOUCHING_M).floor();
            [cell.x as i64, cell.y as i64]
        };
        let turn = |line: &[DVec3], at: usize| (line[at + 1] - line[at]).truncate();
        let is_driving = |lane: &Lane| lane.kind == LaneKind::Driving && lane.centerline.len() > 1;
        let mut starts: HashMap<[i64; 2], usize> = HashMap::new();
        for (at, lane) in self.lanes.iter().enumerate() {
            if is_driving(lane) && lane.predecessors.is_empty() {
                starts.insert(cell(lane.centerline[0]), at);
            }
        }
        let mut touching = Vec::new();
        for (at, lane) in self.lanes.iter().enumerate() {
            if !is_driving(lane) || !lane.successors.is_empty() {
                continue;
            }
            let line = &lane.centerline;
            let end = line[line.len() - 1];
            let [x, y] = cell(end);
            let near = (-1..=1).flat_map(|dx| {
                (-1..=1).map(move |dy| [x.saturating_add(dx), y.saturating_add(dy)])
            });
            let next = near
                .filter_map(|cell| starts.get(&cell).copied())
                .find(|&next| {
                    let onward = &self.lanes[next].centerline;
                    let angle_rad = turn(line, line.len() - 2).angle_to(turn(onward, 0));
                    next != at
                        && onward[0].truncate().distance(end.truncate()) <= TOUCHING_M
                        && angle_rad.abs() < TOUCHING_RAD
                });
            touching.extend(next.map(|next| [at, next]));
        }
        touching
    }

    /// The section that touches an end of a section, and with which of its ends; none where a
    /// junction decides.
    fn across(
        &self,
        road_at: usize,
        section_at: usize,
        contact: Contact,
    ) -> Option<(usize, usize, Contact)> {
        let road = &self.roads[road_at];
        match contact {
            Contact::Start if section_at > 0 => Some((road_at, section_at - 1, Contact::End)),
            Contact::End if section_at + 1 < road.sections.len() => {
                Some((road_at, section_at + 1, Contact::Start))
            }
            _ => match road.link(contact)? {
                LinkTarget::Road(id, contact) => {
                    let linked = *self.by_id.get(id)?;
                    Some((linked, self.outer_section(linked, *contact)?, *contact))
                }
                LinkTarget::Junction(_) => None,
            },
        }
    }

    /// The section at an end of a road.
    fn outer_section(&self, road: usize, contact: Contact) -> Option<usize> {
        match contact {
            Contact::Start => (!self.roads[road].sections.is_empty()).then_some(0),
            Contact::End => self.roads[road].sections.len().checked_sub(1),
        }
    }

    fn end(&self, road: usize, section: usize, id: i64, contact: Contact) -> Option<LaneEnd> {
        let (lane, is_forward) = *self.indices[road].sections[section].get(&id)?;
        Some(LaneEnd {
            lane,
            contact,
            is_forward,
        })
    }

    /// Joins two lanes whose ends touch, in the direction in which traffic passes; not at all where
    /// it runs head-on.
    fn touch(&mut self, a: LaneEnd, b: LaneEnd) {
        let leaves = |end: LaneEnd| (end.contact == Contact::End) == end.is_forward;
        match (leaves(a), leaves(b)) {
            (true, false) => join(self.lanes, a.lane, b.lane),
            (false, true) => join(self.lanes, b.lane, a.lane),
            _ => {}
        }
    }

    /// Joins what the connections of a junction say.
    pub(super) fn join_junction(&mut self, junction: Element) -> Result<(), DecodeError> {
        let junction_id = junction.needed_attribute("id")?;
        for connection in junction.all("connection") {
            let road = |name: &str| {
                connection
                    .attribute(name)
                    .and_then(|id| self.by_id.get(id))
                    .copied()
            };
            let connecting = road("connectingRoad").or_else(|| road("linkedRoad"));
            let (Some(incoming), Some(connecting)) = (road("incomingRoad"), connecting) else {
                continue;
            };
            let contact = Contact::read(connection.attribute("contactPoint"));
            let incoming_contact = self.end_at_junction(incoming, junction_id, connecting, contact);
            let Some(incoming_section) = self.outer_section(incoming, incoming_contact) else {
                continue;
            };
            for lane_link in connection.all("laneLink") {
                let from = whole(lane_link, "from")?;
                let to = whole(lane_link, "to")?;
                let Some(from) = self.end(incoming, incoming_section, from, incoming_contact)
                else {
                    continue;
                };
                // The end that the connection gives, else the other one.
                let ends = [contact, contact.other()]
                    .into_iter()
                    .filter_map(|contact| {
                        let section = self.outer_section(connecting, contact)?;
                        self.end(connecting, section, to, contact)
                    });
                let ends = ends.collect();
                self.touch_one_of(from, ends);
            }
        }
        Ok(())
    }

    /// End of `incoming` that lies at the junction. If both do, or none says so, the one nearer to
    /// the connecting road.
    fn end_at_junction(
        &self,
        incoming: usize,
        junction: &str,
        connecting: usize,
        contact: Contact,
    ) -> Contact {
        let road = &self.roads[incoming];
        let lies_there = |end: &Contact| matches!(road.link(*end), Some(LinkTarget::Junction(id)) if id == junction);
        let meeting = self.roads[connecting].end_position(contact);
        let distance_m = |end: &Contact| road.end_position(*end).distance(meeting);
        let nearer = |a: &Contact, b: &Contact| distance_m(a).total_cmp(&distance_m(b));
        let ends = [Contact::Start, Contact::End];
        ends.into_iter()
            .filter(lies_there)
            .min_by(nearer)
            .or_else(|| ends.into_iter().min_by(nearer))
            .unwrap_or(Contact::Start)
    }
}
