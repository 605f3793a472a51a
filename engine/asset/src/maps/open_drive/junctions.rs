//! Contacts of lanes of sections, roads and junctions, from which successors follow.

use std::collections::HashMap;

use decouplegs_scene::Lane;

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
}

impl Network<'_> {
    /// Joins what the lanes of sections and of roads say that they touch.
    pub(super) fn join_lanes(&mut self) {
        let roads = self.roads;
        for (road_at, road) in roads.iter().enumerate() {
            for (section_at, section) in road.sections.iter().enumerate() {
                for lane in section.left.iter().chain(&section.right) {
                    for (contact, linked) in [
                        (Contact::Start, lane.predecessor),
                        (Contact::End, lane.successor),
                    ] {
                        let Some(linked) = linked else { continue };
                        let from = self.end(road_at, section_at, lane.id, contact);
                        let to = self.across(road_at, section_at, contact).and_then(
                            |(road, section, contact)| self.end(road, section, linked, contact),
                        );
                        self.touch(from, to);
                    }
                }
            }
        }
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
    fn touch(&mut self, a: Option<LaneEnd>, b: Option<LaneEnd>) {
        let (Some(a), Some(b)) = (a, b) else { return };
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
            let Some(section) = self.outer_section(connecting, contact) else {
                continue;
            };
            let Some(incoming_contact) =
                self.end_at_junction(incoming, junction_id, connecting, contact)
            else {
                continue;
            };
            let Some(incoming_section) = self.outer_section(incoming, incoming_contact) else {
                continue;
            };
            for lane_link in connection.all("laneLink") {
                let from = self.end(
                    incoming,
                    incoming_section,
                    whole(lane_link, "from")?,
                    incoming_contact,
                );
                let to = self.end(connecting, section, whole(lane_link, "to")?, contact);
                self.touch(from, to);
            }
        }
        Ok(())
    }

    /// End of `incoming` that lies at the junction. If both do, the one nearer to the connecting
    /// road.
    fn end_at_junction(
        &self,
        incoming: usize,
        junction: &str,
        connecting: usize,
        contact: Contact,
    ) -> Option<Contact> {
        let road = &self.roads[incoming];
        let lies_there = |end: &Contact| matches!(road.link(*end), Some(LinkTarget::Junction(id)) if id == junction);
        let meeting = self.roads[connecting].end_position(contact);
        let ends = [Contact::Start, Contact::End]
            .into_iter()
            .filter(lies_there);
        ends.min_by(|a, b| {
            let distance_m = |end: &Contact| road.end_position(*end).distance(meeting);
            distance_m(a).total_cmp(&distance_m(b))
        })
    }
}
