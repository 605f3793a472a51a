//! Lanes of a section as lines of points.

use decouplegs_scene::Lane;
use glam::{DVec2, DVec3};

use super::Road;
use super::cubic::Cubic;
use super::lanes::{Section, SectionLane};
use super::plan_view::Geometry;
use crate::DecodeError;
use crate::maps::budget::Budget;
use crate::maps::polyline::cleaned;

/// Points stand no farther apart along the road, meters.
const STEP_MAX_M: f64 = 2.0;
/// Largest distance of a border from the line through its points, meters; a bend is examined in its
/// middle, where it is farthest.
const CHORD_ERROR_MAX_M: f64 = 0.015;
/// Steps are not halved below, whatever the chord's error, meters.
const STEP_MIN_M: f64 = 0.05;
/// Profile of a lane between two positions at which a polynomial or piece of the road begins.
struct Strip<'a> {
    geometry: &'a Geometry,
    elevation: Cubic,
    offset: Cubic,
    left: Vec<Edge>,
    right: Vec<Edge>,
}

/// The outer border of a lane.
enum Edge {
    /// Distance from the inner border.
    Width(Cubic),
    /// Distance to the left of the reference line.
    Border(Cubic),
}

/// The lanes of `section`, left ones first, each from the inside out. Ids are `prefix`, a slash and
/// the lane's own.
pub(super) fn lanes(
    road: &Road,
    section: &Section,
    prefix: &str,
    budget: &mut Budget,
) -> Result<Vec<Lane>, DecodeError> {
    if section.left.is_empty() && section.right.is_empty() {
        return Ok(Vec::new());
    }
    let stations = stations(road, section, budget)?;
    let border = |at: usize| stations.iter().map(move |borders| borders[at]);
    let left_count = section.left.len();
    let left = section
        .left
        .iter()
        .enumerate()
        .map(|(at, lane)| (lane, at, at + 1));
    let right = section.right.iter().enumerate().map(|(at, lane)| {
        let inner = if at == 0 { 0 } else { left_count + at };
        (lane, inner, left_count + at + 1)
    });
    let lane_of = |(lane, inner, outer): (&SectionLane, usize, usize)| {
        let middle = border(inner).zip(border(outer)).map(|(a, b)| 0.5 * (a + b));
        let mut lines = [
            cleaned(middle),
            cleaned(border(inner)),
            cleaned(border(outer)),
        ];
        let is_forward = road.is_forward(lane);
        if !is_forward {
            lines.iter_mut().for_each(|line| line.reverse());
        }
        let [centerline, inner, outer] = lines;
        // Along the road, what is outside of a lane on the left is its left border.
        let (left, right) = if (lane.id > 0) == is_forward {
            (outer, inner)
        } else {
            (inner, outer)
        };
        Lane {
            id: format!("{prefix}/{}", lane.id),
            kind: lane.kind,
            centerline,
            left,
            right,
            has_height: road.has_height,
            speed_limit_mps: lane
                .speed_limit_mps(section.start_m)
                .or_else(|| road.speed_limit_mps(section.start_m)),
            ..Lane::default()
        }
    };
    Ok(left.chain(right).map(lane_of).collect())
}

/// The borders along a section: for each position the inner one, those of the lanes on the left and
/// of those on the right.
fn stations(
    road: &Road,
    section: &Section,
    budget: &mut Budget,
) -> Result<Vec<Vec<DVec3>>, DecodeError> {
    let points_each = 3 * (section.left.len() + section.right.len());
    let mut stations = Vec::new();
    for ends in breaks(road, section).windows(2) {
        let strip = Strip::at(road, section, 0.5 * (ends[0] + ends[1]));
        let steps = ((ends[1] - ends[0]) / STEP_MAX_M).ceil().max(1.0);
        budget.spend(points_each * (steps as usize + 1))?;
        let position = |step: f64| ends[0] + (ends[1] - ends[0]) * step / steps;
        let mut from = (ends[0], strip.borders(ends[0]));
        stations.push(from.1.clone());
        for step in 1..=steps as usize {
            let to_m = position(step as f64);
            let to = (to_m, strip.borders(to_m));
            refine(&strip, &from, &to, &mut stations, budget)?;
            stations.push(to.1.clone());
            from = to;
        }
    }
    Ok(stations)
}

/// Adds stations between two until the lines through them follow the borders.
fn refine(
    strip: &Strip,
    from: &(f64, Vec<DVec3>),
    to: &(f64, Vec<DVec3>),
    stations: &mut Vec<Vec<DVec3>>,
    budget: &mut Budget,
) -> Result<(), DecodeError> {
    if to.0 - from.0 < 2.0 * STEP_MIN_M {
        return Ok(());
    }
    let middle_m = 0.5 * (from.0 + to.0);
    let middle = (middle_m, strip.borders(middle_m));
    let chords = from.1.iter().zip(&to.1).map(|(a, b)| 0.5 * (*a + *b));
    if !chords
        .zip(&middle.1)
        .any(|(chord, border)| chord.distance(*border) > CHORD_ERROR_MAX_M)
    {
        return Ok(());
    }
    budget.spend(3 * (middle.1.len() - 1))?;
    refine(strip, from, &middle, stations, budget)?;
    stations.push(middle.1.clone());
    refine(strip, &middle, to, stations, budget)
}

/// Positions within a section at which something begins, and its ends.
fn breaks(road: &Road, section: &Section) -> Vec<f64> {
    let (start_m, end_m) = (section.start_m, section.end_m);
    let first = road
        .plan_view
        .partition_point(|geometry| geometry.start_m <= start_m);
    let pieces = road.plan_view[first..]
        .iter()
        .map(|geometry| geometry.start_m)
        .take_while(|at_m| *at_m < end_m);
    let profiles = [&road.elevation, &road.lane_offset].into_iter();
    let lanes = section
        .left
        .iter()
        .chain(&section.right)
        .flat_map(|lane| [&lane.widths, &lane.borders]);
    let within = profiles
        .chain(lanes)
        .flat_map(|profile| profile.starts_within(start_m, end_m));
    let mut breaks: Vec<f64> = pieces.chain(within).chain([start_m, end_m]).collect();
    breaks.sort_by(f64::total_cmp);
    breaks.dedup();
    breaks
}

impl<'a> Strip<'a> {
    /// Profile around `s_m`.
    fn at(road: &'a Road, section: &Section, s_m: f64) -> Self {
        let after = road
            .plan_view
            .partition_point(|geometry| geometry.start_m <= s_m);
        let edge = |lane: &SectionLane| match lane.widths.is_empty() && !lane.borders.is_empty() {
            true => Edge::Border(lane.borders.piece(s_m)),
            false => Edge::Width(lane.widths.piece(s_m)),
        };
        Self {
            geometry: &road.plan_view[after.saturating_sub(1)],
            elevation: road.elevation.piece(s_m),
            offset: road.lane_offset.piece(s_m),
            left: section.left.iter().map(edge).collect(),
            right: section.right.iter().map(edge).collect(),
        }
    }

    /// The borders at a position: the one between the sides, those of the left, those of the right.
    fn borders(&self, s_m: f64) -> Vec<DVec3> {
        let on_line = self.geometry.at(s_m);
        let to_left = DVec2::from_angle(on_line.heading_rad).perp();
        let height_m = self.elevation.at(s_m);
        let point = |offset_m: f64| (on_line.position + to_left * offset_m).extend(height_m);
        let inner_m = self.offset.at(s_m);
        let mut borders = Vec::with_capacity(1 + self.left.len() + self.right.len());
        borders.push(point(inner_m));
        for (edges, sign) in [(&self.left, 1.0), (&self.right, -1.0)] {
            let mut outer_m = inner_m;
            for edge in edges {
                outer_m = match edge {
                    // A polynomial may dip below zero where a lane ends; a lane does not.
                    Edge::Width(width) => outer_m + sign * width.at(s_m).max(0.0),
                    Edge::Border(border) => border.at(s_m),
                };
                borders.push(point(outer_m));
            }
        }
        borders
    }
}
