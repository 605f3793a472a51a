//! Choice of the line that is painted on the border of a lane.

use decouplegs_scene::LaneKind;
use glam::{Vec2, Vec3};

use super::strip_index::{Hit, StripIndex};
use super::strips::Section;

/// Width of a line, meters.
pub(super) const LINE_M: f32 = 0.14;

/// Length of a dash; the gap behind it is twice as long.
pub(super) const DASH_M: f32 = 3.0;

/// A border so deep in another lane is no edge of the road, meters.
const INSIDE_M: f32 = 0.35;

/// Distance beyond the border at which the neighbor lane is looked up, meters.
const BEYOND_M: f32 = 0.4;

/// Marking of a border.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Line {
    /// No line: other lanes run across the border, or nobody drives there.
    None,
    /// The lane on the other side paints it.
    OfNeighbor,
    /// Lanes in the same direction on both sides.
    Dashed,
    /// The edge of the road, or traffic against it on the other side.
    Solid,
}

/// The line on the left (`true`) or right border of lane `strip` where it is cut by `section`.
pub(super) fn line(
    index: &StripIndex,
    strip: usize,
    section: &Section,
    ahead: Vec2,
    on_left: bool,
) -> Line {
    let (border, other) = if on_left {
        (section.left, section.right)
    } else {
        (section.right, section.left)
    };
    let drives =
        |hit: &Hit| hit.strip != strip && index.strips[hit.strip].kind == LaneKind::Driving;
    if index
        .at(border)
        .any(|hit| drives(&hit) && hit.depth_m > INSIDE_M)
    {
        return Line::None;
    }
    let outward = (border - other).normalize_or(Vec3::Y);
    let beyond: Vec<Hit> = index
        .at(border + outward * BEYOND_M)
        .filter(drives)
        .collect();
    let is_driven = index.strips[strip].kind == LaneKind::Driving;
    let Some(neighbor) = beyond.iter().map(|hit| hit.strip).min() else {
        return if is_driven { Line::Solid } else { Line::None };
    };
    // Of two lanes that share a border the first paints it; sidewalks leave it free.
    if neighbor < strip || !is_driven {
        return Line::OfNeighbor;
    }
    let same_way = beyond
        .iter()
        .any(|hit| hit.strip == neighbor && hit.ahead.dot(ahead) > 0.0);
    if same_way { Line::Dashed } else { Line::Solid }
}
