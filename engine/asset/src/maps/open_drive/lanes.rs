//! Lanes as a road lists them: sections, each with lanes to the left and to the right of the
//! reference line.

use decouplegs_scene::LaneKind;

use super::cubic::Profile;
use crate::DecodeError;
use crate::maps::speed;
use crate::xml::{Element, excerpt, finite};

/// A stretch of a road with the same lanes and the same speed limits.
#[derive(Clone)]
pub(super) struct Section {
    /// Number of the section in the file, and of the part of it where limits divide it: `3`, `3.1`,
    /// `3.2`.
    pub(super) label: String,
    /// Start along the road, meters.
    pub(super) start_m: f64,
    pub(super) end_m: f64,
    /// Lanes to the left, from the reference line outwards.
    pub(super) left: Vec<SectionLane>,
    /// Lanes to the right, from the reference line outwards.
    pub(super) right: Vec<SectionLane>,
}

/// A lane of a section.
#[derive(Clone)]
pub(super) struct SectionLane {
    /// Id of the lane: above zero to the left, below to the right.
    pub(super) id: i64,
    pub(super) kind: LaneKind,
    /// Width along the road, meters.
    pub(super) widths: Profile,
    /// Outer border from the reference line, to the left, meters, for lanes without widths.
    pub(super) borders: Profile,
    /// The lanes that touch its start along the road, on the section or road before.
    pub(super) predecessors: Vec<i64>,
    /// The lanes that touch its end.
    pub(super) successors: Vec<i64>,
    /// Limits from a position along the road on, in order.
    speed_limits: Vec<(f64, Option<f64>)>,
    /// True if traffic goes against the rule of its side.
    pub(super) is_reversed: bool,
}

impl SectionLane {
    /// The limit that the lane itself has at `s_m` along the road.
    pub(super) fn speed_limit_mps(&self, s_m: f64) -> Option<f64> {
        limit_at(&self.speed_limits, s_m)
    }
}

/// The limit that holds at `s_m`, of limits from positions on.
pub(super) fn limit_at(limits: &[(f64, Option<f64>)], s_m: f64) -> Option<f64> {
    let started = limits.partition_point(|(start_m, _)| *start_m <= s_m);
    limits[..started].last().and_then(|(_, limit)| *limit)
}

/// Parts of a section are not shorter than this, meters.
const PART_M_MIN: f64 = 1.0;
/// Most parts of a section.
const PARTS_MAX: usize = 1000;

/// `sections`, divided where the limit of one of their driving lanes changes: `road_limits` are
/// those of the road from positions on.
pub(super) fn divided(sections: Vec<Section>, road_limits: &[(f64, Option<f64>)]) -> Vec<Section> {
    let mut parts = Vec::with_capacity(sections.len());
    for section in sections {
        let driving = || {
            let lanes = section.left.iter().chain(&section.right);
            lanes.filter(|lane| lane.kind == LaneKind::Driving)
        };
        let starts = driving().flat_map(|lane| &lane.speed_limits);
        let mut starts: Vec<f64> = starts
            .chain(road_limits)
            .map(|(start_m, _)| *start_m)
            .filter(|start_m| {
                *start_m >= section.start_m + PART_M_MIN && *start_m <= section.end_m - PART_M_MIN
            })
            .collect();
        starts.sort_by(f64::total_cmp);
        let limits = |s_m: f64| -> Vec<Option<f64>> {
            let of = |lane: &SectionLane| {
                lane.speed_limit_mps(s_m)
                    .or_else(|| limit_at(road_limits, s_m))
            };
            driving().map(of).collect()
        };
        let mut cuts: Vec<f64> = Vec::new();
        let mut before = limits(section.start_m);
        for start_m in starts {
            let after = limits(start_m);
            let from_m = cuts.last().copied().unwrap_or(section.start_m);
            if after != before && start_m >= from_m + PART_M_MIN && cuts.len() < PARTS_MAX {
                cuts.push(start_m);
                before = after;
            }
        }
        let last = cuts.len();
        for number in 0..=last {
            let mut part = section.clone();
            if number > 0 {
                part.start_m = cuts[number - 1];
                part.label = format!("{}.{number}", section.label);
            }
            if number < last {
                part.end_m = cuts[number];
            }
            for lane in part.left.iter_mut().chain(&mut part.right) {
                if number > 0 {
                    lane.predecessors = vec![lane.id];
                }
                if number < last {
                    lane.successors = vec![lane.id];
                }
            }
            parts.push(part);
        }
    }
    parts
}

/// Sections of a road of `length_m`, in order; those beyond its end are left out.
pub(super) fn read(road: Element, length_m: f64) -> Result<Vec<Section>, DecodeError> {
    let lanes = road.needed("lanes")?;
    let mut starts = Vec::new();
    for element in lanes.all("laneSection") {
        starts.push((element.number("s")?, element));
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let ends: Vec<f64> = starts
        .iter()
        .skip(1)
        .map(|(start_m, _)| *start_m)
        .chain([length_m])
        .collect();
    let sections = starts
        .into_iter()
        .zip(ends)
        .filter(|((start_m, _), _)| *start_m >= 0.0 && *start_m < length_m);
    let mut read: Vec<Section> = Vec::new();
    for ((start_m, element), end_m) in sections {
        let mut section = read_section(element, start_m, end_m.min(length_m))?;
        section.label = read.len().to_string();
        // A section of one side leaves the other as it was.
        if element.attribute("singleSide") == Some("true")
            && let Some(before) = read.last_mut()
        {
            let sides = [
                (&mut before.left, &mut section.left),
                (&mut before.right, &mut section.right),
            ];
            for (before, side) in sides.into_iter().filter(|(_, side)| side.is_empty()) {
                side.clone_from(before);
                for (lane, earlier) in side.iter_mut().zip(before) {
                    lane.predecessors = vec![lane.id];
                    earlier.successors = vec![earlier.id];
                }
            }
        }
        read.push(section);
    }
    Ok(read)
}

fn read_section(element: Element, start_m: f64, end_m: f64) -> Result<Section, DecodeError> {
    let side = |name: &str, sign: i64| -> Result<Vec<SectionLane>, DecodeError> {
        let elements = element.all(name).flat_map(|side| side.all("lane"));
        let mut lanes = elements
            .map(|lane| read_lane(lane, start_m, sign))
            .collect::<Result<Vec<_>, _>>()?;
        lanes.sort_by_key(|lane| lane.id.unsigned_abs());
        match lanes.windows(2).find(|pair| pair[0].id == pair[1].id) {
            Some(pair) => Err(element.fault(format!("two lanes have the id {}", pair[0].id))),
            None => Ok(lanes),
        }
    };
    Ok(Section {
        label: String::new(),
        start_m,
        end_m,
        left: side("left", 1)?,
        right: side("right", -1)?,
    })
}

fn read_lane(element: Element, start_m: f64, sign: i64) -> Result<SectionLane, DecodeError> {
    let id = whole(element, "id")?;
    if id.signum() != sign {
        return Err(element.fault(format!(
            "the id {id}; expected one above zero on the left, below on the right"
        )));
    }
    let link = element.first("link");
    let linked = |name| -> Result<Vec<i64>, DecodeError> {
        let links = link.iter().flat_map(|link| link.all(name));
        links.map(|linked| whole(linked, "id")).collect()
    };
    let mut speed_limits = Vec::new();
    for speed in element.all("speed") {
        speed_limits.push((start_m + speed.number_or("sOffset", 0.0)?, speed_mps(speed)));
    }
    speed_limits.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(SectionLane {
        id,
        kind: kind(element.attribute("type").unwrap_or_default()),
        widths: Profile::read(Some(element), "width", "sOffset", start_m)?,
        borders: Profile::read(Some(element), "border", "sOffset", start_m)?,
        predecessors: linked("predecessor")?,
        successors: linked("successor")?,
        speed_limits,
        is_reversed: element.attribute("direction") == Some("reversed"),
    })
}

/// The whole number in an attribute.
pub(super) fn whole(element: Element, name: &str) -> Result<i64, DecodeError> {
    let text = element.needed_attribute(name)?;
    let number = text
        .parse()
        .ok()
        .filter(|number: &i64| number.unsigned_abs() <= 1 << 31);
    number.ok_or_else(|| {
        element.fault(format!(
            "{name}=\"{}\" is no whole number of lanes",
            excerpt(text)
        ))
    })
}

/// The limit in a `speed` element; none where it says that there is none. What is no speed is no
/// limit either, and is warned of.
pub(super) fn speed_mps(element: Element) -> Option<f64> {
    let text = element.attribute("max").unwrap_or_default();
    if matches!(text, "no limit" | "undefined") {
        return None;
    }
    let unit = element.attribute("unit").unwrap_or_default();
    match (finite(text), speed::factor(unit)) {
        (Some(number), Some(factor)) => {
            Some(number * factor.unwrap_or(1.0)).filter(|limit_mps| *limit_mps > 0.0)
        }
        _ => {
            log::warn!(
                "line {}: the speed limit max=\"{}\" unit=\"{}\" is none; expected a number in m/s, km/h or mph",
                element.line(),
                excerpt(text),
                excerpt(unit)
            );
            None
        }
    }
}

fn kind(name: &str) -> LaneKind {
    match name {
        "driving" | "entry" | "exit" | "onRamp" | "offRamp" | "connectingRamp" | "slipLane"
        | "mwyEntry" | "mwyExit" | "bidirectional" | "bus" | "taxi" | "HOV" => LaneKind::Driving,
        "biking" => LaneKind::Bicycle,
        "sidewalk" | "walking" => LaneKind::Walking,
        "parking" => LaneKind::Parking,
        _ => LaneKind::Other,
    }
}
