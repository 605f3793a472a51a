//! The way that the ego is expected to take: its lane as it is believed to run, and the turn that
//! the navigation system announced.

use std::f64::consts::{FRAC_PI_2, PI};

use decouplegs_drive::polyline::wrapped;
use glam::DVec2;

use super::lane::LaneBelief;
use crate::planner::{Navigation, Turn};

/// Distance between points, meters.
pub(super) const STEP_M: f64 = 0.25;
/// Length of the path, meters.
pub(super) const VIEW_M: f64 = 60.0;
/// Navigation counts a turn from where the road begins to bend a little until it no longer does:
/// its arc is shorter on each side, by 2 m where it is tight and by 1 m where its radius is 20 m
/// (measured on arcs between straight lines). Meters, and meters per meter of radius.
const EASING: (f64, f64) = (2.6, 0.07);
/// The least and the most easing, meters.
const EASING_M: (f64, f64) = (0.5, 2.0);
/// The most of a turn's length that is easing, on each side.
const EASING_SHARE: f64 = 0.2;
/// Turns that are farther or longer than this are no news, meters.
const TURN_M_MAX: f64 = 10_000.0;
/// Largest change of heading of a turn, radians: a full circle.
const TURN_RAD_MAX: f64 = 2.0 * PI;
/// Largest curvature of a turn, 1/m: no car follows a radius below 5 m.
const CURVATURE_MAX: f64 = 0.2;

/// The arc of a turn on the way, meters ahead of the ego.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arc {
    pub begin_m: f64,
    pub end_m: f64,
    /// Curvature, 1/m, positive to the left.
    pub curvature: f64,
}

impl Arc {
    /// The arc that `guidance` describes; `None` where it announces no turn.
    pub(super) fn announced(guidance: &Navigation) -> Option<Self> {
        let &Navigation {
            turn,
            distance_m,
            angle_rad,
            length_m,
            ..
        } = guidance;
        let message = distance_m.abs() <= TURN_M_MAX
            && angle_rad.abs() <= TURN_RAD_MAX
            && (0.1..=TURN_M_MAX).contains(&length_m);
        if turn == Turn::Straight || !message {
            return None;
        }
        let radius_m = length_m / angle_rad.abs().max(1e-3);
        let easing_m = (EASING.0 - EASING.1 * radius_m)
            .clamp(EASING_M.0, EASING_M.1)
            .min(EASING_SHARE * length_m);
        let (begin_m, end_m) = (distance_m + easing_m, distance_m + length_m - easing_m);
        let curvature = (angle_rad / (end_m - begin_m)).clamp(-CURVATURE_MAX, CURVATURE_MAX);
        (end_m > 0.0).then_some(Self {
            begin_m,
            end_m,
            curvature,
        })
    }
}

/// A position on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WayPoint {
    /// Position in the ego's frame, meters.
    pub position_m: DVec2,
    pub heading_rad: f64,
    /// Curvature, 1/m, positive to the left.
    pub curvature: f64,
}

impl WayPoint {
    /// Position at `left_m` to the left of this one, meters.
    pub(super) fn beside(&self, left_m: f64) -> DVec2 {
        self.position_m + self.left() * left_m
    }

    /// Unit vector to the left.
    pub(super) fn left(&self) -> DVec2 {
        DVec2::from_angle(self.heading_rad + FRAC_PI_2)
    }
}

/// The way as a line in the ego's frame, from the position beside the ego onwards.
pub(super) struct RoadPath {
    points: Vec<WayPoint>,
}

impl RoadPath {
    /// The middle of the lane `lane`, and the turn `arc` where there is one.
    pub(super) fn expected(lane: &LaneBelief, arc: Option<&Arc>) -> Self {
        let mut heading_rad = lane.heading_rad;
        let mut position_m = DVec2::from_angle(heading_rad + FRAC_PI_2) * lane.offset_m;
        let count = (VIEW_M / STEP_M) as usize;
        let mut points = Vec::with_capacity(count + 1);
        for step in 0..=count {
            let middle_m = (step as f64 + 0.5) * STEP_M;
            let curvature = match arc {
                Some(arc) if middle_m >= arc.end_m => 0.0,
                Some(arc) if middle_m >= arc.begin_m => arc.curvature,
                _ => lane.curvature,
            };
            points.push(WayPoint {
                position_m,
                heading_rad,
                curvature,
            });
            position_m += DVec2::from_angle(heading_rad + 0.5 * curvature * STEP_M) * STEP_M;
            heading_rad += curvature * STEP_M;
        }
        Self { points }
    }

    /// The position `arc_m` along it, its ends beyond them.
    pub(super) fn at(&self, arc_m: f64) -> WayPoint {
        let at = (arc_m / STEP_M).clamp(0.0, (self.points.len() - 1) as f64);
        let before = (at as usize).min(self.points.len() - 2);
        let (a, b, share) = (
            self.points[before],
            self.points[before + 1],
            at - before as f64,
        );
        WayPoint {
            position_m: a.position_m.lerp(b.position_m, share),
            heading_rad: a.heading_rad + (b.heading_rad - a.heading_rad) * share,
            curvature: a.curvature,
        }
    }

    /// The position on it nearest to `at_m`, of those at most `within_m` along it.
    pub(super) fn nearest(&self, at_m: DVec2, within_m: f64) -> WayPoint {
        let count = ((within_m / STEP_M).ceil().max(0.0) as usize)
            .saturating_add(1)
            .min(self.points.len());
        let distance = |point: &WayPoint| point.position_m.distance_squared(at_m);
        let nearest = self.points[..count]
            .iter()
            .enumerate()
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        let index = nearest.map_or(0, |(index, _)| index);
        let point = self.points[index];
        let ahead_m = DVec2::from_angle(point.heading_rad)
            .dot(at_m - point.position_m)
            .clamp(-STEP_M, STEP_M);
        self.at((index as f64 * STEP_M + ahead_m).max(0.0))
    }
}

/// Path as seen from a vehicle at `at_m` with heading `heading_rad` beside `point`: its offset to
/// the left, meters, and its heading.
pub(super) fn seen_from(at_m: DVec2, heading_rad: f64, point: &WayPoint) -> (f64, f64) {
    (
        (point.position_m - at_m).dot(point.left()),
        wrapped(point.heading_rad - heading_rad),
    )
}
