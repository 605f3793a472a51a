//! ASAM OpenDRIVE (`.xodr`, versions 1.4 to 1.8): roads along reference lines, with lanes to both
//! sides.
//!
//! Read are the plan view (line, arc, spiral, poly3, paramPoly3), elevation, lane offset, lane
//! sections, widths or borders, types, directions, speed limits, and the links of lanes, roads and
//! junctions. Lanes are sampled at 2 m or less, so that no border leaves its line by 2 cm. A lane's
//! id is `road/section/lane`, sections counted from 0; each section of a road has lanes of its own.
//! The speed limit is the lane's or, where it has none, the road's. Where it changes within a
//! section, the section is divided: its parts are `3`, `3.1`, `3.2`.
//! Links are believed where the ends of lanes meet within 2 m (`junctions`).
//! Coordinates are those of the file: `geoReference` and the header's `offset` are not applied.
//!
//! Lanes that taper to nothing beside the lane that follows are bent onto it (`tapers`).
//!
//! Not read: superelevation and the lateral shape (a bank of 5% lifts the outer border of a lane by
//! some 20 cm, its middle by half of it), kerb heights, objects, signals other than traffic lights
//! (`signals`), railways.

mod beside;
mod cubic;
mod junctions;
mod lanes;
mod plan_view;
mod road_positions;
mod sampling;
mod signals;
mod tapers;
mod write;

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneMap};
use glam::{DVec2, DVec3};

use self::cubic::Profile;
use self::junctions::{Network, RoadLanes};
use self::lanes::{Section, SectionLane};
use self::plan_view::Geometry;
pub use self::road_positions::{RoadPlace, RoadPositions};
pub use self::write::encode;
use super::budget::Budget;
use crate::DecodeError;
use crate::xml::{Element, excerpt, parse};

/// An end of a road or lane, along the reference line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Contact {
    Start,
    End,
}

impl Contact {
    fn other(self) -> Self {
        match self {
            Self::Start => Self::End,
            Self::End => Self::Start,
        }
    }

    fn read(text: Option<&str>) -> Self {
        if text == Some("end") {
            Self::End
        } else {
            Self::Start
        }
    }
}

/// Target of the link of a road's end.
enum LinkTarget {
    /// The end of a road, by its id.
    Road(String, Contact),
    /// A junction, by its id.
    Junction(String),
}

/// A road of the file.
struct Road {
    id: String,
    plan_view: Vec<Geometry>,
    elevation: Profile,
    has_height: bool,
    lane_offset: Profile,
    sections: Vec<Section>,
    predecessor: Option<LinkTarget>,
    successor: Option<LinkTarget>,
    drives_on_the_left: bool,
    /// Limits from a position along the road on, in order.
    speed_limits: Vec<(f64, Option<f64>)>,
}

/// Reads the lanes of an OpenDRIVE file.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    Ok(decode_with_positions(bytes)?.0)
}

/// Reads the lanes of an OpenDRIVE file, and what finds positions on its roads.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode_with_positions(bytes: &[u8]) -> Result<(LaneMap, RoadPositions), DecodeError> {
    let document = parse(bytes)?;
    let root = Element::root(&document, "OpenDRIVE")?;
    let mut by_id = HashMap::new();
    let mut roads = Vec::new();
    let mut signals = Vec::new();
    for element in root.all("road") {
        let road = Road::read(element)?;
        if by_id.insert(road.id.clone(), roads.len()).is_some() {
            return Err(element.fault(format!(
                "a second road with the id {}; expected one",
                excerpt(&road.id)
            )));
        }
        roads.push(road);
        signals.push(signals::read(element)?);
    }
    warn_of_late_profiles(&roads);
    let mut lanes: Vec<Lane> = Vec::new();
    let mut indices = Vec::with_capacity(roads.len());
    let mut budget = Budget::whole();
    for road in &roads {
        indices.push(road.add_lanes(&mut lanes, &mut budget)?);
    }
    let mut network = Network {
        roads: &roads,
        indices: &indices,
        by_id: &by_id,
        lanes: &mut lanes,
        dropped: Vec::new(),
    };
    network.join_lanes();
    for junction in root.all("junction") {
        network.join_junction(junction)?;
    }
    network.report();
    tapers::join_smoothly(&mut lanes);
    let lights = signals::lights(&signals, &roads, &indices, &lanes)?;
    let map = LaneMap {
        lights,
        ..super::finished(lanes, DVec3::ZERO)?
    };
    Ok((map, RoadPositions::new(roads, indices, by_id)))
}

/// Warns of profiles without a polynomial where they begin. By the letter they are zero there; like
/// other readers, this one continues the first polynomial backwards.
fn warn_of_late_profiles(roads: &[Road]) {
    let is_late = |road: &&Road| {
        let of_section = |section: &Section| {
            let mut lanes = section.left.iter().chain(&section.right);
            lanes.any(|lane| lane.widths.begins_after(section.start_m))
        };
        // Parts of a divided section begin later than the widths of the whole.
        road.elevation.begins_after(0.0)
            || road.lane_offset.begins_after(0.0)
            || road.sections.iter().any(of_section)
    };
    let mut late = roads.iter().filter(is_late);
    if let Some(first) = late.next() {
        log::warn!(
            "{} roads, of which the first is {}, have an elevation, lane offset or width that begins after its road or \
             section: it is continued backwards",
            1 + late.count(),
            excerpt(&first.id)
        );
    }
}

impl Road {
    fn read(element: Element) -> Result<Self, DecodeError> {
        let plan_view = plan_view::read(element)?;
        let length_m = plan_view
            .last()
            .map_or(0.0, |last| last.start_m + last.length_m);
        let link = element.first("link");
        let target = |name: &str| link.and_then(|link| link.first(name)).and_then(link_target);
        let mut speed_limits = Vec::new();
        for kind in element.all("type") {
            let limit = kind.first("speed").and_then(lanes::speed_mps);
            speed_limits.push((kind.number_or("s", 0.0)?, limit));
        }
        speed_limits.sort_by(|a, b| a.0.total_cmp(&b.0));
        let elevation = Profile::read(element.first("elevationProfile"), "elevation", "s", 0.0)?;
        Ok(Self {
            id: element.needed_attribute("id")?.to_owned(),
            sections: lanes::divided(lanes::read(element, length_m)?, &speed_limits),
            lane_offset: Profile::read(element.first("lanes"), "laneOffset", "s", 0.0)?,
            has_height: !elevation.is_empty(),
            elevation,
            plan_view,
            predecessor: target("predecessor"),
            successor: target("successor"),
            drives_on_the_left: element.attribute("rule") == Some("LHT"),
            speed_limits,
        })
    }

    /// True if traffic on `lane` runs along the reference line.
    fn is_forward(&self, lane: &SectionLane) -> bool {
        (lane.id < 0) ^ self.drives_on_the_left ^ lane.is_reversed
    }

    fn link(&self, contact: Contact) -> Option<&LinkTarget> {
        match contact {
            Contact::Start => self.predecessor.as_ref(),
            Contact::End => self.successor.as_ref(),
        }
    }

    /// Position of the start or end of the reference line.
    fn end_position(&self, contact: Contact) -> DVec2 {
        let piece = match contact {
            Contact::Start => self.plan_view.first(),
            Contact::End => self.plan_view.last(),
        };
        piece.map_or(DVec2::ZERO, |piece| {
            piece
                .at(if contact == Contact::Start {
                    piece.start_m
                } else {
                    piece.start_m + piece.length_m
                })
                .position
        })
    }

    /// Index of the section at `s_m`, and the share of it that is before `s_m`, 0 to 1.
    fn section_at(&self, s_m: f64) -> (usize, f64) {
        let after = self
            .sections
            .partition_point(|section| section.start_m <= s_m);
        let index = after.saturating_sub(1);
        let share = self.sections.get(index).map_or(0.0, |section| {
            (s_m - section.start_m) / (section.end_m - section.start_m)
        });
        (index, share.clamp(0.0, 1.0))
    }

    fn speed_limit_mps(&self, s_m: f64) -> Option<f64> {
        lanes::limit_at(&self.speed_limits, s_m)
    }

    /// Adds its lanes to `all`, with their neighbors.
    fn add_lanes(
        &self,
        all: &mut Vec<Lane>,
        budget: &mut Budget,
    ) -> Result<RoadLanes, DecodeError> {
        let mut indices = RoadLanes::default();
        for section in &self.sections {
            let prefix = format!("{}/{}", self.id, section.label);
            let sampled = sampling::lanes(self, section, &prefix, budget)?;
            let listed = section.left.iter().chain(&section.right);
            let mut by_id = HashMap::new();
            for (lane, listed) in sampled.into_iter().zip(listed) {
                // A section of no length has no lanes to speak of.
                if lane.centerline.len() >= 2 {
                    by_id.insert(listed.id, (all.len(), self.is_forward(listed)));
                    all.push(lane);
                }
            }
            for side in [&section.left, &section.right] {
                for pair in side.windows(2) {
                    make_neighbors(&pair[0], &pair[1], &by_id, all);
                }
            }
            indices.sections.push(by_id);
        }
        Ok(indices)
    }
}

/// Makes a lane and the next one outwards neighbors where their traffic runs the same way.
fn make_neighbors(
    inner: &SectionLane,
    outer: &SectionLane,
    indices: &HashMap<i64, (usize, bool)>,
    lanes: &mut [Lane],
) {
    let (Some(inner_place), Some(outer_place)) = (indices.get(&inner.id), indices.get(&outer.id))
    else {
        return;
    };
    let ((inner_at, is_forward), (outer_at, outer_is_forward)) = (*inner_place, *outer_place);
    if is_forward != outer_is_forward {
        return;
    }
    let (left, right) = if (outer.id > 0) == is_forward {
        (outer_at, inner_at)
    } else {
        (inner_at, outer_at)
    };
    lanes[left].right_neighbor = Some(right);
    lanes[right].left_neighbor = Some(left);
}

fn link_target(element: Element) -> Option<LinkTarget> {
    let id = element.attribute("elementId")?.to_owned();
    match element.attribute("elementType") {
        Some("junction") => Some(LinkTarget::Junction(id)),
        _ => Some(LinkTarget::Road(
            id,
            Contact::read(element.attribute("contactPoint")),
        )),
    }
}
