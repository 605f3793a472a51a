//! Positions along a chain of lanes, each the successor of the one before.

use glam::DVec2;

use super::RoadLane;
use crate::polyline::wrapped;

/// A vehicle's heading is that of a chord of its path between the axles of a family car, meters to
/// each side of its middle. One length for all vehicles, so that the corridor of the longest holds
/// all others.
pub(super) const HALF_AXLES_M: f64 = 1.35;

/// Position of a vehicle on its path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub position_m: DVec2,
    pub yaw_rad: f64,
}

/// Meters of a driving lane; 0 of any other.
pub(crate) fn length_of(lanes: &[Option<RoadLane>], lane: usize) -> f64 {
    lanes[lane]
        .as_ref()
        .map_or(0.0, |lane| lane.line.length_m())
}

/// The position `arc_m` from the start of `path[here]`, before or beyond it as the path leads;
/// straight on beyond the path's ends.
fn point_on(lanes: &[Option<RoadLane>], path: &[usize], here: usize, arc_m: f64) -> DVec2 {
    let (mut here, mut arc_m) = (here, arc_m);
    while arc_m < 0.0 && here > 0 {
        here -= 1;
        arc_m += length_of(lanes, path[here]);
    }
    loop {
        let length_m = length_of(lanes, path[here]);
        if arc_m <= length_m || here + 1 == path.len() {
            break;
        }
        arc_m -= length_m;
        here += 1;
    }
    let Some(lane) = &lanes[path[here]] else {
        return DVec2::ZERO;
    };
    let within_m = arc_m.clamp(0.0, lane.line.length_m());
    let point = lane.line.at(within_m).truncate();
    let beyond_m = arc_m - within_m;
    if beyond_m == 0.0 {
        point
    } else {
        point + DVec2::from_angle(lane.line.heading_at(within_m)) * beyond_m
    }
}

/// Position and heading of a vehicle whose middle is `arc_m` from the start of `path[here]`.
pub(crate) fn position_on(
    lanes: &[Option<RoadLane>],
    path: &[usize],
    here: usize,
    arc_m: f64,
) -> Place {
    let at = |arc_m: f64| point_on(lanes, path, here, arc_m);
    let chord = at(arc_m + HALF_AXLES_M) - at(arc_m - HALF_AXLES_M);
    let straight = || {
        lanes[path[here]]
            .as_ref()
            .map_or(0.0, |lane| lane.line.heading_at(arc_m))
    };
    // Where the path turns back within the chord, its own heading says more.
    let yaw_rad = if chord.length() < HALF_AXLES_M {
        straight()
    } else {
        chord.to_angle()
    };
    Place {
        position_m: at(arc_m),
        yaw_rad: wrapped(yaw_rad),
    }
}
