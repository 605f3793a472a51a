//! Lanes as a road lists them: sections, each with lanes to the left and to the right of the
//! reference line.

use decouplegs_scene::LaneKind;

use super::cubic::Profile;
use crate::DecodeError;
use crate::xml::{Element, excerpt};

/// A stretch of a road with the same lanes.
pub(super) struct Section {
    /// Start along the road, meters.
    pub(super) start_m: f64,
    pub(super) end_m: f64,
    /// Lanes to the left, from the reference line outwards.
    pub(super) left: Vec<SectionLane>,
    /// Lanes to the right, from the reference line outwards.
    pub(super) right: Vec<SectionLane>,
}

/// A lane of a section.
pub(super) struct SectionLane {
    /// Id of the lane: above zero to the left, below to the right.
    pub(super) id: i64,
    pub(super) kind: LaneKind,
    /// Width along the road, meters.
    pub(super) widths: Profile,
    /// Outer border from the reference line, to the left, meters, for lanes without widths.
    pub(super) borders: Profile,
    /// The lane that touches its start along the road, on the section or road before.
    pub(super) predecessor: Option<i64>,
    /// The lane that touches its end.
    pub(super) successor: Option<i64>,
    pub(super) speed_limit_mps: Option<f64>,
    /// True if traffic goes against the rule of its side.
    pub(super) is_reversed: bool,
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
    sections
        .map(|((start_m, element), end_m)| read_section(element, start_m, end_m.min(length_m)))
        .collect()
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
    let linked = |name| {
        link.and_then(|link| link.first(name))
            .map(|linked| whole(linked, "id"))
            .transpose()
    };
    Ok(SectionLane {
        id,
        kind: kind(element.attribute("type").unwrap_or_default()),
        widths: Profile::read(Some(element), "width", "sOffset", start_m)?,
        borders: Profile::read(Some(element), "border", "sOffset", start_m)?,
        predecessor: linked("predecessor")?,
        successor: linked("successor")?,
        speed_limit_mps: element.first("speed").map(speed_mps).transpose()?.flatten(),
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

/// The limit in a `speed` element; none where it says that there is none.
pub(super) fn speed_mps(element: Element) -> Result<Option<f64>, DecodeError> {
    let unit = match element.attribute("unit") {
        None | Some("m/s") => 1.0,
        Some("km/h") => 1.0 / 3.6,
        Some("mph") => 0.447_04,
        Some(unit) => {
            return Err(element.fault(format!(
                "unit=\"{}\"; expected m/s, km/h or mph",
                excerpt(unit)
            )));
        }
    };
    if matches!(element.attribute("max"), Some("no limit" | "undefined")) {
        return Ok(None);
    }
    match element.number("max")? * unit {
        limit_mps if limit_mps > 0.0 => Ok(Some(limit_mps)),
        _ => Ok(None),
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
